//! `pulled.json`: what is complete here, so that it need not be read again.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::disk::Disk;
use crate::catalogue::Entry;
use crate::digest::Digest;
use crate::error::BufferError;
use crate::root::file_modified_ns;

/// Its name in the destination.
pub const INDEX_FILE: &str = "pulled.json";

/// Goes up when an old program would misread a new file.
const FORMAT: u32 = 1;

/// A file that is complete here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Indexed {
    /// Size.
    pub bytes: u64,
    /// BLAKE3.
    pub digest: Digest,
    /// Last change on the robot, since 1970.
    pub source_modified_ns: u64,
    /// Last change here.
    pub modified_ns: u64,
    /// Whether it had no end when it was pulled: another version may replace it.
    pub cut: bool,
    /// Whether the robot knows that it is here.
    pub marked: bool,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Contents {
    format: u32,
    files: BTreeMap<String, Indexed>,
}

/// The index of one destination.
#[derive(Debug)]
pub(super) struct Index {
    dir: PathBuf,
    files: BTreeMap<String, Indexed>,
    changed: bool,
}

impl Index {
    /// Reads it. One that is missing or broken is empty: everything in it can be found out again.
    pub(super) fn open(dir: &Path) -> Self {
        let contents = std::fs::read(dir.join(INDEX_FILE)).ok();
        let contents = contents.and_then(|bytes| serde_json::from_slice::<Contents>(&bytes).ok());
        let files = contents.filter(|contents| contents.format == FORMAT).unwrap_or_default().files;
        Self { dir: dir.to_owned(), files, changed: false }
    }

    /// What is known of a file that is still here as it was written down.
    pub(super) fn get(&self, name: &str) -> Option<&Indexed> {
        let indexed = self.files.get(name)?;
        let here = std::fs::symlink_metadata(self.dir.join(name))
            .ok()
            .filter(std::fs::Metadata::is_file)?;
        ((here.len(), file_modified_ns(&here)) == (indexed.bytes, indexed.modified_ns))
            .then_some(indexed)
    }

    /// Whether the robot's file is here.
    pub(super) fn has(&self, entry: &Entry) -> Option<&Indexed> {
        self.get(entry.name.as_str()).filter(|here| {
            (here.bytes, here.source_modified_ns) == (entry.bytes, entry.modified_ns)
        })
    }

    pub(super) fn insert(&mut self, name: &str, indexed: Indexed) {
        self.files.insert(name.to_owned(), indexed);
        self.changed = true;
    }

    pub(super) fn set_marked(&mut self, name: &str) {
        if let Some(indexed) = self.files.get_mut(name) {
            indexed.marked = true;
            self.changed = true;
        }
    }

    /// Writes it, whole or not at all.
    pub(super) fn save(&mut self, disk: &dyn Disk) -> Result<(), BufferError> {
        if !self.changed {
            return Ok(());
        }
        let path = self.dir.join(INDEX_FILE);
        let partial = self.dir.join(".pulled.json.partial");
        let contents = Contents { format: FORMAT, files: std::mem::take(&mut self.files) };
        let bytes = serde_json::to_vec_pretty(&contents).map_err(std::io::Error::other);
        self.files = contents.files;
        let written = bytes.and_then(|bytes| {
            let mut file = disk.open_part(&partial)?;
            file.cut(0)?;
            file.write_all(&bytes)?;
            file.sync()?;
            disk.rename(&partial, &path)
        });
        written.map_err(BufferError::write(path))?;
        self.changed = false;
        Ok(())
    }
}
