//! The file operations of the model store, behind a trait so that tests can let each one fail.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// File operations that the store needs. All errors are those of the operating system.
pub trait StoreDisk: Send {
    /// Creates or overwrites a file.
    ///
    /// # Errors
    /// The error of the operating system.
    fn write(&mut self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Flushes the content of a file to the disk (`fsync`).
    ///
    /// # Errors
    /// The error of the operating system.
    fn sync(&mut self, path: &Path) -> io::Result<()>;

    /// Renames a file, replacing an existing file of that name atomically.
    ///
    /// # Errors
    /// The error of the operating system.
    fn rename(&mut self, from: &Path, to: &Path) -> io::Result<()>;

    /// Flushes the entries of a folder to the disk (`fsync`).
    ///
    /// # Errors
    /// The error of the operating system.
    fn sync_dir(&mut self, dir: &Path) -> io::Result<()>;

    /// Removes a file.
    ///
    /// # Errors
    /// The error of the operating system.
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

/// Replaces `path` by `bytes` atomically: every reader, also after a crash or a power cut, finds
/// either the complete old file or the complete new one. After an error the old file is valid.
pub(super) fn replace(disk: &mut dyn StoreDisk, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(PARTIAL);
    let partial = path.with_file_name(name);
    let renamed = disk
        .write(&partial, bytes)
        .and_then(|()| disk.sync(&partial))
        .and_then(|()| disk.rename(&partial, path));
    if let Err(error) = renamed {
        // Best effort: the first error is the one to report.
        let _ = disk.remove(&partial);
        return Err(error);
    }
    path.parent().map_or(Ok(()), |dir| disk.sync_dir(dir))
}

/// Suffix of the names of incomplete files.
pub(super) const PARTIAL: &str = ".partial";
