//! Where files go. A trait, so that tests can fill the disk.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// A file that grows.
pub trait PartFile: Read + Write + Send {
    /// Cuts it and goes on writing there.
    ///
    /// # Errors
    /// When the disk refuses.
    fn cut(&mut self, len: u64) -> io::Result<()>;

    /// Returns when the disk has everything.
    ///
    /// # Errors
    /// When the disk says that it has not.
    fn sync(&mut self) -> io::Result<()>;
}

/// Changes to the destination.
pub trait Disk: Send + Sync {
    /// Opens a file for reading and appending, made if it is not there. Never through a symbolic link.
    ///
    /// # Errors
    /// When the disk refuses.
    fn open_part(&self, path: &Path) -> io::Result<Box<dyn PartFile>>;

    /// Renames a file over another, and returns when the disk has the new name.
    ///
    /// # Errors
    /// When the disk refuses.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
}

/// The computer's file system.
#[derive(Debug, Clone, Copy, Default)]
pub struct FileSystem;

impl Disk for FileSystem {
    fn open_part(&self, path: &Path) -> io::Result<Box<dyn PartFile>> {
        let nofollow = rustix::fs::OFlags::NOFOLLOW.bits().cast_signed();
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .custom_flags(nofollow)
            .open(path)?;
        Ok(Box::new(file))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        std::fs::rename(from, to)?;
        // The new name, too, must survive a power cut.
        to.parent().map_or(Ok(()), |dir| File::open(dir)?.sync_all())
    }
}

impl PartFile for File {
    fn cut(&mut self, len: u64) -> io::Result<()> {
        self.set_len(len)?;
        io::Seek::seek(self, io::SeekFrom::Start(len)).map(drop)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}
