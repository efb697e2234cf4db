//! A file that is being received: `NAME.part`, beside the final name.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::disk::{Disk, PartFile};
use super::progress::Progress;
use super::rate_limiter::RateLimiter;
use crate::digest::Hasher;
use crate::error::StoreError;
use crate::name::Name;
use crate::private;
use crate::transfer::{FileSink, LocalCopy};

/// The temporary and the final path of a file.
pub(super) struct Paths {
    pub name: Name,
    pub part: PathBuf,
    pub whole: PathBuf,
}

impl Paths {
    /// Computes the paths and creates the directory of the run, for this account only.
    pub(super) fn create(dir: &Path, name: &Name) -> Result<Self, StoreError> {
        let whole = dir.join(name.as_str());
        let folder = dir.join(name.run());
        private::create_folder(&folder).map_err(StoreError::write(folder))?;
        let part = whole.with_file_name(format!("{}.part", name.file()));
        Ok(Self { name: name.clone(), part, whole })
    }
}

/// Receives the bytes of one file, appends them to the local copy and hashes them.
pub(super) struct PartReceiver<'a, 'b, 'c> {
    paths: &'a Paths,
    disk: &'a dyn Disk,
    progress: &'a mut dyn Progress,
    limiter: &'b mut RateLimiter<'c>,
    /// The hash of the local copy, continued with the bytes that are received.
    hasher: Hasher,
    /// The local copy: the part, or a complete file that is not in the index.
    local_path: Option<&'a Path>,
    open: Option<Box<dyn PartFile>>,
    pub received: u64,
}

/// A file that was received completely but not yet renamed.
pub(super) struct Received {
    /// The open part; `None` when the complete file was already here.
    pub part: Option<Box<dyn PartFile>>,
    pub hasher: Hasher,
    pub bytes: u64,
}

fn is_non_empty_file(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file() && metadata.len() > 0)
}

impl<'a, 'b, 'c> PartReceiver<'a, 'b, 'c> {
    /// Finds and hashes the local copy.
    pub(super) fn new(
        paths: &'a Paths,
        disk: &'a dyn Disk,
        progress: &'a mut dyn Progress,
        limiter: &'b mut RateLimiter<'c>,
    ) -> Result<Self, StoreError> {
        let candidates = [paths.part.as_path(), paths.whole.as_path()];
        let local_path = candidates.into_iter().find(|path| is_non_empty_file(path));
        let mut hasher = Hasher::default();
        if let Some(path) = local_path {
            File::open(path)
                .and_then(|mut file| hasher.update_from(&mut file, u64::MAX))
                .map_err(StoreError::write(path))?;
        }
        Ok(Self { paths, disk, progress, limiter, hasher, local_path, open: None, received: 0 })
    }

    pub(super) fn local_copy(&self) -> LocalCopy {
        LocalCopy { bytes: self.hasher.bytes(), digest: self.hasher.digest() }
    }

    pub(super) fn finish(self) -> Received {
        Received { bytes: self.hasher.bytes(), part: self.open, hasher: self.hasher }
    }

    /// Opens the part for writing at offset `from`. If the local copy is a complete file, its first `from` bytes are copied into
    /// the part, so that the complete file stays until the new one replaces it.
    fn open_at(&self, from: u64) -> io::Result<Box<dyn PartFile>> {
        let mut part = self.disk.open_part(&self.paths.part)?;
        match self.local_path {
            Some(path) if path == self.paths.whole && from > 0 => {
                part.truncate(0)?;
                let mut whole = io::Read::take(File::open(path)?, from);
                io::copy(&mut whole, &mut part)?;
            }
            _ => part.truncate(from)?,
        }
        Ok(part)
    }
}

impl FileSink<StoreError> for PartReceiver<'_, '_, '_> {
    fn start(&mut self, from: u64, length: u64) -> Result<(), StoreError> {
        self.progress.file_started(&self.paths.name, length, from);
        // The complete file is already here and only missing from the index.
        if from == length && from > 0 && self.local_path == Some(&self.paths.whole) {
            return Ok(());
        }
        if from == 0 {
            self.hasher = Hasher::default();
        }
        self.open = Some(self.open_at(from).map_err(StoreError::write(&self.paths.part))?);
        Ok(())
    }

    fn data(&mut self, _at: u64, bytes: &[u8]) -> Result<(), StoreError> {
        if let Some(part) = &mut self.open {
            part.write_all(bytes).map_err(StoreError::write(&self.paths.part))?;
        }
        self.hasher.update(bytes);
        self.received += bytes.len() as u64;
        self.progress.received(bytes.len() as u64);
        self.limiter.wait_after(bytes.len());
        Ok(())
    }

    fn comparing(&mut self) -> Result<(), StoreError> {
        Ok(())
    }
}
