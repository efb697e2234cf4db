//! A folder in memory for the files of tests.
//!
//! The tests of the model store, of recordings and of downloads wait for the disk at each of thousands of writes: on a disk that
//! others use as well, one of them took 102 s instead of 2.5 s.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::command;

/// The file system in memory that Linux offers.
const MEMORY: &str = "/dev/shm";
/// The tests write less than 2 GiB at a time. A container's default has 64 MiB.
const NEEDED_BYTES: u64 = 4 << 30;

/// A new folder in memory, which is removed in the end.
pub struct MemoryFolder {
    path: PathBuf,
}

impl MemoryFolder {
    /// `None` where memory has no room for the files, or may not hold programs; the files are then written to the disk.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn new() -> Result<Option<Self>> {
        if free_bytes(Path::new(MEMORY)).is_none_or(|bytes| bytes < NEEDED_BYTES) {
            return Ok(None);
        }
        // Short, because the paths of ssh's sockets below it may have 90 bytes.
        let path = Path::new(MEMORY).join(format!("ed-{}", std::process::id()));
        fs::create_dir(&path).with_context(|| path.display().to_string())?;
        let folder = Self { path };
        Ok(runs_programs(&folder.path).then_some(folder))
    }

    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for MemoryFolder {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_dir_all(&self.path) {
            eprintln!("{}: {error}", self.path.display());
        }
    }
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
