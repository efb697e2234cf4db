//! `pulled.json`: the list of complete files, which need not be read again.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::disk::Disk;
use crate::digest::Digest;
use crate::entry::Entry;
use crate::error::StoreError;
use crate::root::file_modified_ns;

/// The name of the index in the destination.
pub const INDEX_FILE: &str = "pulled.json";

/// Incremented when an older program would misinterpret a newer file.
const FORMAT: u32 = 1;

/// A complete file of the destination.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Indexed {
    pub bytes: u64,
    pub digest: Digest,
    /// The modification time on the robot, since 1970.
    pub source_modified_ns: u64,
    /// The modification time of the local file, since 1970.
    pub modified_ns: u64,
    /// The segment had no end when it was pulled, so a newer version may replace it.
    pub cut: bool,
    /// The robot has written its `.pulled` marker.
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
    /// Reads the index. A missing or malformed index counts as empty, because its contents can be computed again.
    pub(super) fn open(dir: &Path) -> Self {
        let contents = std::fs::read(dir.join(INDEX_FILE)).ok();
        let contents = contents.and_then(|bytes| serde_json::from_slice::<Contents>(&bytes).ok());
        let files = contents.filter(|contents| contents.format == FORMAT).unwrap_or_default().files;
        Self { dir: dir.to_owned(), files, changed: false }
    }

    /// The entry of a file whose size and modification time still match the index.
    pub(super) fn get(&self, name: &str) -> Option<&Indexed> {
        let indexed = self.files.get(name)?;
        let here = std::fs::symlink_metadata(self.dir.join(name))
            .ok()
            .filter(std::fs::Metadata::is_file)?;
        ((here.len(), file_modified_ns(&here)) == (indexed.bytes, indexed.modified_ns))
            .then_some(indexed)
    }

    /// The entry of a file that is a copy of the robot's `entry`, by size and modification time.
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

    /// Replaces the index file atomically.
    pub(super) fn save(&mut self, disk: &dyn Disk) -> Result<(), StoreError> {
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
            file.truncate(0)?;
            file.write_all(&bytes)?;
            file.sync()?;
            disk.rename(&partial, &path)
        });
        written.map_err(StoreError::write(path))?;
        self.changed = false;
        Ok(())
    }
}
