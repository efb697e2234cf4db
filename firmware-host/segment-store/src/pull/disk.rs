//! Writing to the destination's disk, behind traits so that tests can inject disk errors.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use crate::private;

/// A file that is being received.
pub trait PartFile: Read + Write + Send {
    /// Truncates the file to `len` bytes and continues writing there.
    ///
    /// # Errors
    /// When the disk returns an error.
    fn truncate(&mut self, len: u64) -> io::Result<()>;

    /// Returns when all data are on the disk.
    ///
    /// # Errors
    /// When the disk returns an error.
    fn sync(&mut self) -> io::Result<()>;
}

/// The operations that change the destination.
pub trait Disk: Send + Sync {
    /// Opens a file for reading and writing, and creates it if it does not exist. Symbolic links are not followed.
    /// Only this account may read a new file.
    ///
    /// # Errors
    /// When the disk returns an error.
    fn open_part(&self, path: &Path) -> io::Result<Box<dyn PartFile>>;

    /// Renames a file, replacing `to` if it exists, and returns when the new name is on the disk.
    ///
    /// # Errors
    /// When the disk returns an error.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
}

/// The file system of the operating system.
#[derive(Debug, Clone, Copy, Default)]
pub struct FileSystem;

impl Disk for FileSystem {
    fn open_part(&self, path: &Path) -> io::Result<Box<dyn PartFile>> {
        let nofollow = rustix::fs::OFlags::NOFOLLOW.bits().cast_signed();
        let file = private::file_options()
            .read(true)
            .create(true)
            .truncate(false)
            .custom_flags(nofollow)
            .open(path)?;
        Ok(Box::new(file))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        std::fs::rename(from, to)?;
        // The directory is synced so that the new name survives a power cut.
        to.parent().map_or(Ok(()), |dir| File::open(dir)?.sync_all())
    }
}

impl PartFile for File {
    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.set_len(len)?;
        io::Seek::seek(self, io::SeekFrom::Start(len)).map(drop)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}
