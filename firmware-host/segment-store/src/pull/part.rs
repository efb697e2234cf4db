//! A file that is on its way here: `NAME.part` beside where it will be.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::Watch;
use super::disk::{Disk, PartFile};
use super::pace::Pace;
use crate::digest::Hasher;
use crate::error::BufferError;
use crate::name::Name;
use crate::send::{Have, Receive};

/// Where a file is and will be.
pub(super) struct Paths {
    pub name: Name,
    pub part: PathBuf,
    pub whole: PathBuf,
}

impl Paths {
    /// Makes the directories.
    pub(super) fn new(dir: &Path, name: &Name) -> Result<Self, BufferError> {
        let whole = dir.join(name.as_str());
        let folder = dir.join(name.run());
        std::fs::create_dir_all(&folder).map_err(BufferError::write(folder))?;
        let part = whole.with_file_name(format!("{}.part", name.file()));
        Ok(Self { name: name.clone(), part, whole })
    }
}

/// Takes a file's bytes.
pub(super) struct Part<'a, 'b, 'c> {
    paths: &'a Paths,
    disk: &'a dyn Disk,
    watch: &'a mut dyn Watch,
    pace: &'b mut Pace<'c>,
    /// Of what is in `have_path`.
    hasher: Hasher,
    /// The part, or a complete file of which nothing is written down.
    have_path: Option<&'a Path>,
    open: Option<Box<dyn PartFile>>,
    pub arrived: u64,
}

/// A file that has arrived.
pub(super) struct Arrived {
    /// The open part; `None` when the complete file was here already.
    pub part: Option<Box<dyn PartFile>>,
    pub hasher: Hasher,
    pub bytes: u64,
}

impl<'a, 'b, 'c> Part<'a, 'b, 'c> {
    /// Looks for what is here and reads it.
    pub(super) fn find(
        paths: &'a Paths,
        disk: &'a dyn Disk,
        watch: &'a mut dyn Watch,
        pace: &'b mut Pace<'c>,
    ) -> Result<Self, BufferError> {
        let is_file = |path: &&Path| {
            std::fs::symlink_metadata(path).is_ok_and(|m| m.is_file() && m.len() > 0)
        };
        let have_path = [paths.part.as_path(), paths.whole.as_path()].into_iter().find(is_file);
        let mut hasher = Hasher::default();
        if let Some(path) = have_path {
            let read =
                File::open(path).and_then(|mut file| hasher.update_from(&mut file, u64::MAX));
            read.map_err(BufferError::write(path))?;
        }
        Ok(Self { paths, disk, watch, pace, hasher, have_path, open: None, arrived: 0 })
    }

    pub(super) fn have(&self) -> Have {
        Have { bytes: self.hasher.bytes(), digest: self.hasher.digest() }
    }

    pub(super) fn finish(self) -> Arrived {
        Arrived { bytes: self.hasher.bytes(), part: self.open, hasher: self.hasher }
    }

    /// Opens the part at byte `from`; what is in a complete file is copied first, so that it stays until the new one is
    /// whole.
    fn open_at(&self, from: u64) -> io::Result<Box<dyn PartFile>> {
        let mut part = self.disk.open_part(&self.paths.part)?;
        match self.have_path {
            Some(path) if path == self.paths.whole && from > 0 => {
                part.cut(0)?;
                let mut whole = io::Read::take(File::open(path)?, from);
                io::copy(&mut whole, &mut part)?;
            }
            _ => part.cut(from)?,
        }
        Ok(part)
    }
}

impl Receive<BufferError> for Part<'_, '_, '_> {
    fn start(&mut self, from: u64, length: u64) -> Result<(), BufferError> {
        self.watch.begins(&self.paths.name, length, from);
        // Complete, and only not written down.
        if from == length && from > 0 && self.have_path == Some(&self.paths.whole) {
            return Ok(());
        }
        if from == 0 {
            self.hasher = Hasher::default();
        }
        self.open = Some(self.open_at(from).map_err(BufferError::write(&self.paths.part))?);
        Ok(())
    }

    fn data(&mut self, _at: u64, bytes: &[u8]) -> Result<(), BufferError> {
        if let Some(part) = &mut self.open {
            part.write_all(bytes).map_err(BufferError::write(&self.paths.part))?;
        }
        self.hasher.update(bytes);
        self.arrived += bytes.len() as u64;
        self.watch.arrived(bytes.len() as u64);
        self.pace.came(bytes.len());
        Ok(())
    }

    fn working(&mut self) -> Result<(), BufferError> {
        Ok(())
    }
}
