//! A folder in memory for the files of tests.
//!
//! The tests of the model store, of recordings and of downloads wait for the disk at each of thousands of writes: on a disk that
//! others use as well, one of them took 102 s instead of 2.5 s.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use anyhow::{Context, Result};
use tempfile::TempDir;

use crate::command;

/// The file system in memory that Linux offers.
const MEMORY: &str = "/dev/shm";
/// A recording of 2,200 small frames, which tests share, has 55 MB. A container's default has room for 64 MiB.
const NEEDED_BYTES: u64 = 4 << 30;

/// A new folder in memory. `None` where memory has no room for the files, or may not hold programs: the tests then write to the
/// disk.
///
/// # Errors
/// The folder cannot be made.
pub fn new() -> Result<Option<TempDir>> {
    if free_bytes(Path::new(MEMORY)).is_none_or(|bytes| bytes < NEEDED_BYTES) {
        return Ok(None);
    }
    // A short name, because the paths of ssh's sockets below it may have 90 bytes.
    let folder = tempfile::Builder::new().prefix("ed-").tempdir_in(MEMORY).context(MEMORY)?;
    Ok(runs_programs(folder.path()).then_some(folder))
}

/// Whether programs can be started from this folder. Tests write small ones, and some systems mount `/dev/shm` with `noexec`.
fn runs_programs(folder: &Path) -> bool {
    let program = folder.join("program");
    let is_written = fs::write(&program, "#!/bin/sh\n").is_ok()
        && fs::set_permissions(&program, fs::Permissions::from_mode(0o700)).is_ok();
    let runs = is_written && command::works(&mut command::program(&program));
    // The folder is removed in the end if this fails.
    let _ = fs::remove_file(&program);
    runs
}

fn free_bytes(folder: &Path) -> Option<u64> {
    let mut df = command::program("df");
    let printed =
        command::output(df.args(["--block-size=1", "--output=avail"]).arg(folder)).ok()?;
    printed.lines().last()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_run_from_the_target_directory_and_not_from_a_folder_that_does_not_exist() {
        assert!(runs_programs(&crate::paths::target()));
        assert!(!runs_programs(Path::new("/does/not/exist")));
    }

    #[test]
    fn the_root_has_room_and_a_folder_that_does_not_exist_has_none() {
        assert!(free_bytes(Path::new("/")).is_some());
        assert!(free_bytes(Path::new("/does/not/exist")).is_none());
    }
}
