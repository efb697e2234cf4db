//! Recordings show the inside of homes: only the account that writes them may read them, whatever its umask is.
//!
//! The group gets no right either, because a robot's service and a person's account have groups with other members. A pull
//! runs as the robot's account ([docs/pull-buffer.md](../../../docs/pull-buffer.md)).

use std::fs::{DirBuilder, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

/// Mode of a folder of recordings.
const FOLDER_MODE: u32 = 0o700;
/// Mode of a recording.
const FILE_MODE: u32 = 0o600;

/// Creates a folder that only this account may open, with the folders above it that are missing. A folder that exists keeps
/// its mode, because an operator may have chosen it.
///
/// # Errors
/// When it cannot be created.
pub fn create_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(FOLDER_MODE).create(path)
}

/// Options to create a file for writing that only this account may open. A file that exists keeps its mode.
#[must_use]
pub fn file_options() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.write(true).mode(FILE_MODE);
    options
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn mode(path: &Path) -> u32 {
        path.metadata().unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn a_folder_and_a_file_are_for_their_account_only() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("runs/monday");
        create_folder(&run).unwrap();
        let file = run.join("recording_0000.mcap");
        file_options().create_new(true).open(&file).unwrap();
        assert_eq!(
            (mode(&dir.path().join("runs")), mode(&run), mode(&file)),
            (0o700, 0o700, 0o600)
        );
    }

    #[test]
    fn a_folder_that_exists_keeps_its_mode() {
        let dir = tempfile::tempdir().unwrap();
        let shared = dir.path().join("shared");
        std::fs::create_dir(&shared).unwrap();
        std::fs::set_permissions(&shared, std::fs::Permissions::from_mode(0o750)).unwrap();
        create_folder(&shared).unwrap();
        assert_eq!(mode(&shared), 0o750);
    }
}
