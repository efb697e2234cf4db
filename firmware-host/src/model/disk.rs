//! What the store does to a disk, operation by operation. A trait, so that tests can let each of them fail.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// Operations of the store on its folder.
pub trait StoreDisk: Send {
    /// Creates or overwrites a file.
    ///
    /// # Errors
    /// What the system says.
    fn write(&mut self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Returns when the disk has the file's bytes.
    ///
    /// # Errors
    /// What the system says.
    fn sync(&mut self, path: &Path) -> io::Result<()>;

    /// Gives a file another name, in place of what had that name.
    ///
    /// # Errors
    /// What the system says.
    fn rename(&mut self, from: &Path, to: &Path) -> io::Result<()>;

    /// Returns when the disk has the folder's names.
    ///
    /// # Errors
    /// What the system says.
    fn sync_dir(&mut self, dir: &Path) -> io::Result<()>;

    /// Removes a file.
    ///
    /// # Errors
    /// What the system says.
    fn remove(&mut self, path: &Path) -> io::Result<()>;
}

/// The computer's file system.
#[derive(Debug, Clone, Copy, Default)]
pub struct RealDisk;

impl StoreDisk for RealDisk {
    fn write(&mut self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        File::create(path)?.write_all(bytes)
    }

    fn sync(&mut self, path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }

    fn rename(&mut self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn sync_dir(&mut self, dir: &Path) -> io::Result<()> {
        File::open(dir)?.sync_all()
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }
}

/// Puts `bytes` in place of `path` so that whoever looks, also after a crash or a power cut, finds the old file or the new one,
/// whole. On an error the old file is what counts.
pub(super) fn replace(disk: &mut dyn StoreDisk, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(PARTIAL);
    let partial = path.with_file_name(name);
    let renamed = disk
        .write(&partial, bytes)
        .and_then(|()| disk.sync(&partial))
        .and_then(|()| disk.rename(&partial, path));
    if let Err(error) = renamed {
        // Best effort: the first error is the one that says what is wrong.
        let _ = disk.remove(&partial);
        return Err(error);
    }
    path.parent().map_or(Ok(()), |dir| disk.sync_dir(dir))
}

/// Ends the names of files that are not whole.
pub(super) const PARTIAL: &str = ".partial";
