//! Where segments go. A trait, so that tests can fill the disk.

use std::cell::Cell;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use std::rc::Rc;

use runtime::recording::END_WITHOUT_SUMMARY;

/// Makes and removes segments.
pub trait Disk: Send {
    /// Creates a file that is not there yet.
    ///
    /// # Errors
    /// When it is there already or cannot be created.
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>>;

    /// Removes a file.
    ///
    /// # Errors
    /// When it cannot be removed.
    fn remove(&mut self, path: &Path) -> io::Result<()>;

    /// How large the disk is on which `path` lies, and how full.
    ///
    /// # Errors
    /// When the disk does not say.
    fn space(&self, path: &Path) -> io::Result<Space>;
}

/// How large a disk is, and how full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space {
    /// What still fits, bytes.
    pub free_bytes: u64,
    /// All of it, bytes.
    pub total_bytes: u64,
}

/// A file being written.
pub trait SegmentFile: Write + Send {
    /// Forgets everything from byte `len` on and goes on writing there.
    ///
    /// # Errors
    /// When the file cannot be cut.
    fn truncate(&mut self, len: u64) -> io::Result<()>;

    /// Returns when the disk has everything.
    ///
    /// # Errors
    /// When the disk says that it has not.
    fn sync(&mut self) -> io::Result<()>;
}

/// The computer's file system.
#[derive(Debug, Clone, Copy, Default)]
pub struct FileSystem;

impl Disk for FileSystem {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        // For `buffer verify` and `recover`: who finds it unlocked knows that nobody writes on. Where there are no locks they go by
        // the file's age.
        let _ = file.try_lock();
        // The file's name, too, must survive a power cut.
        if let Some(dir) = path.parent().filter(|dir| !dir.as_os_str().is_empty()) {
            File::open(dir)?.sync_all()?;
        }
        Ok(Box::new(file))
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        std::fs::remove_file(path)
    }

    fn space(&self, path: &Path) -> io::Result<Space> {
        let disk = rustix::fs::statvfs(path)?;
        let bytes = |blocks: u64| blocks.saturating_mul(disk.f_frsize);
        Ok(Space { free_bytes: bytes(disk.f_bavail), total_bytes: bytes(disk.f_blocks) })
    }
}

impl SegmentFile for File {
    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.set_len(len)?;
        self.seek(SeekFrom::Start(len)).map(drop)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

/// A segment's file behind the MCAP writer, which flushes after every complete chunk.
pub(super) struct Sink {
    file: BufWriter<Box<dyn SegmentFile>>,
    written: Rc<Cell<u64>>,
    /// Length up to the last flush: complete chunks only.
    good: u64,
    sync: bool,
}

impl Sink {
    /// `written` tells the owner of the writer how large the file has become.
    pub(super) fn new(file: Box<dyn SegmentFile>, written: Rc<Cell<u64>>, sync: bool) -> Self {
        Self { file: BufWriter::new(file), written, good: 0, sync }
    }

    /// Cuts a file that could not be written on back to its complete chunks and ends it as a valid MCAP file.
    pub(super) fn salvage(self) -> io::Result<()> {
        // What is still in the buffer belongs to the broken chunk.
        let (mut file, _) = self.file.into_parts();
        file.truncate(self.good)?;
        if let Err(error) = file.write_all(&END_WITHOUT_SUMMARY).and_then(|()| file.flush()) {
            // No room even for that: without its end the file still gives every turn, and says that it is cut.
            file.truncate(self.good)?;
            return Err(error);
        }
        Ok(())
    }
}

impl Write for Sink {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let written = self.file.write(data)?;
        self.written.set(self.written.get() + written as u64);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()?;
        if self.sync {
            self.file.get_mut().sync()?;
        }
        self.good = self.written.get();
        Ok(())
    }
}
