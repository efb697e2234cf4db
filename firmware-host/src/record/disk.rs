//! The disk that segments are written to, as a trait, so that tests can simulate a full or failing one.

use std::cell::{Cell, RefCell};
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use std::rc::Rc;

use data_encoding::HEXLOWER;
use runtime::recording::END_WITHOUT_SUMMARY;
use segment_store::private;
use sha2::{Digest, Sha256};

/// Creates and removes segments.
pub trait Disk: Send {
    /// Creates a new file, for this account only.
    ///
    /// # Errors
    /// When the file exists or cannot be created.
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>>;

    /// Removes a file.
    ///
    /// # Errors
    /// When it cannot be removed.
    fn remove(&mut self, path: &Path) -> io::Result<()>;

    /// Size and free space of the disk that holds `path`.
    ///
    /// # Errors
    /// When they cannot be determined.
    fn space(&self, path: &Path) -> io::Result<Space>;
}

/// Size and free space of a disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space {
    /// Free space for this process, bytes.
    pub free_bytes: u64,
    /// Size of the disk, bytes.
    pub total_bytes: u64,
}

/// A segment that is being written.
pub trait SegmentFile: Write + Send {
    /// Removes everything from byte `len` on. The next write continues there.
    ///
    /// # Errors
    /// When the file cannot be cut.
    fn truncate(&mut self, len: u64) -> io::Result<()>;

    /// Returns when all bytes are on the disk.
    ///
    /// # Errors
    /// When the disk reports an error.
    fn sync(&mut self) -> io::Result<()>;
}

/// The computer's file system.
#[derive(Debug, Clone, Copy, Default)]
pub struct FileSystem;

impl Disk for FileSystem {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>> {
        let file = private::file_options().create_new(true).open(path)?;
        // `buffer verify` and `recover` see by this lock that the file is still being written. On file systems without locks
        // they decide by the file's age.
        let _ = file.try_lock();
        // The directory entry must survive a power cut too.
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
        Ok(Space {
            free_bytes: disk.f_bavail.saturating_mul(disk.f_frsize),
            total_bytes: disk.f_blocks.saturating_mul(disk.f_frsize),
        })
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

/// What has been written to a segment so far. It is shared by the sink and the owner of the writer.
pub(super) struct Written {
    bytes: Cell<u64>,
    /// Of all bytes; `None` in a recording that is not signed.
    sha256: Option<RefCell<Sha256>>,
}

impl Written {
    pub(super) fn new(signed: bool) -> Rc<Self> {
        Rc::new(Self { bytes: Cell::new(0), sha256: signed.then(RefCell::default) })
    }

    /// Size of the file.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes.get()
    }

    /// SHA-256 of all bytes so far, 64 hexadecimal digits; `None` in a recording that is not signed.
    pub(super) fn digest(&self) -> Option<String> {
        Some(HEXLOWER.encode(&self.sha256.as_ref()?.borrow().clone().finalize()))
    }

    fn add(&self, data: &[u8]) {
        self.bytes.set(self.bytes.get() + data.len() as u64);
        if let Some(sha256) = &self.sha256 {
            sha256.borrow_mut().update(data);
        }
    }
}

/// The sink of the MCAP writer, which flushes it after every complete chunk.
pub(super) struct Sink {
    file: BufWriter<Box<dyn SegmentFile>>,
    written: Rc<Written>,
    /// Length up to the last flush: complete chunks only.
    good: u64,
    /// Length up to the flush before it.
    good_before: u64,
    sync: bool,
}

impl Sink {
    pub(super) fn new(file: Box<dyn SegmentFile>, written: Rc<Written>, sync: bool) -> Self {
        Self { file: BufWriter::new(file), written, good: 0, good_before: 0, sync }
    }

    /// Whether a chunk with ticks was flushed after the header.
    pub(super) fn holds_ticks(&self) -> bool {
        self.good_before > 0
    }

    /// After a failed write: truncates the file to its complete chunks and ends it as a valid MCAP file.
    pub(super) fn salvage(self) -> io::Result<()> {
        // The bytes in the buffer belong to the incomplete chunk.
        let (mut file, _) = self.file.into_parts();
        end_at(file.as_mut(), self.good).or_else(|error| {
            // No space even for the end: the last chunk makes room for it. Without one, readers report a truncated file.
            if self.good_before > 0 { end_at(file.as_mut(), self.good_before) } else { Err(error) }
        })
    }
}

/// Ends a file as valid MCAP after this many of its bytes.
fn end_at(file: &mut dyn SegmentFile, len: u64) -> io::Result<()> {
    file.truncate(len)?;
    file.write_all(&END_WITHOUT_SUMMARY).and_then(|()| file.flush()).or_else(|error| {
        file.truncate(len)?;
        Err(error)
    })
}

impl Write for Sink {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let written = self.file.write(data)?;
        self.written.add(data.get(..written).unwrap_or_default());
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()?;
        if self.sync {
            self.file.get_mut().sync()?;
        }
        if self.good != self.written.bytes() {
            self.good_before = self.good;
        }
        self.good = self.written.bytes();
        Ok(())
    }
}
