//! The list of all segments of a store, from names, sizes, markers and the ends of files; the data are not read.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::Path;
use std::time::SystemTime;

use rustix::fs::FileType;

use crate::entry::{Entry, Pulled, State};
use crate::error::StoreError;
use crate::marks;
use crate::name::Name;
use crate::root::{Listed, Root, list, open_regular};

/// A segment without an end counts as still being written when it is the last of its run and was modified more recently than
/// this. The recorder closes a chunk every second.
pub const OPEN_FOR_NS: u64 = 30_000_000_000;

/// All segments of a store, in the order of [`Name`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Catalogue {
    pub entries: Vec<Entry>,
}

impl Catalogue {
    /// Lists the segments of a store. Files that cannot be read are left out.
    ///
    /// # Errors
    /// When the directory of the store cannot be read.
    pub fn read(root: &Root) -> Result<Self, StoreError> {
        let now_ns = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos() as u64);
        Self::read_at(root, now_ns)
    }

    /// Like [`read`](Self::read), with `now_ns` since 1970 as the present time.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_at(root: &Root, now_ns: u64) -> Result<Self, StoreError> {
        let mut entries = Vec::new();
        let top = root
            .folder("")
            .and_then(|top| list(top.as_fd()))
            .map_err(StoreError::read(root.path()))?;
        read_run(root, "", &top, &mut entries);
        for run in top.iter().filter(|listed| listed.kind == FileType::Directory) {
            // A directory that cannot be read holds no run of this robot.
            let Ok(listed) = root.folder(&run.name).and_then(|folder| list(folder.as_fd())) else {
                continue;
            };
            read_run(root, &run.name, &listed, &mut entries);
        }
        Ok(Self::new(entries, now_ns))
    }

    /// Sorts the entries and decides which of those without an end are still being written at `now_ns`.
    #[must_use]
    pub fn new(mut entries: Vec<Entry>, now_ns: u64) -> Self {
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        mark_open_segments(&mut entries, now_ns);
        Self { entries }
    }

    /// The segments by run.
    #[must_use]
    pub fn runs(&self) -> BTreeMap<&str, Vec<&Entry>> {
        let mut runs: BTreeMap<&str, Vec<&Entry>> = BTreeMap::new();
        for entry in &self.entries {
            runs.entry(entry.name.run()).or_default().push(entry);
        }
        runs
    }

    /// Opens the store at `path` and lists its segments.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(path: &Path) -> Result<(Root, Self), StoreError> {
        let root = Root::open(path)?;
        let catalogue = Self::read(&root)?;
        Ok((root, catalogue))
    }
}

fn read_run(root: &Root, run: &str, listed: &[Listed], entries: &mut Vec<Entry>) {
    let Ok(folder) = root.folder(run) else { return };
    let prefix = if run.is_empty() { String::new() } else { format!("{run}/") };
    for file in listed.iter().filter(|file| file.kind == FileType::RegularFile) {
        let Ok(name) = Name::parse(&format!("{prefix}{}", file.name)) else { continue };
        let pulled = if has_marker(listed, &file.name, marks::PULLED) {
            marks::read_pulled(folder.as_fd(), &file.name, file.bytes, file.modified_ns)
        } else {
            Pulled::No
        };
        let keep = has_marker(listed, &file.name, marks::KEEP);
        entries.extend(read_entry(folder.as_fd(), name, file, keep, pulled).ok());
    }
}

fn has_marker(listed: &[Listed], file: &str, suffix: &str) -> bool {
    listed.iter().any(|other| other.name.strip_suffix(suffix) == Some(file))
}

fn read_entry(
    folder: BorrowedFd<'_>,
    name: Name,
    listed: &Listed,
    keep: bool,
    pulled: Pulled,
) -> io::Result<Entry> {
    let file = open_regular(folder, name.file())?;
    let mut entry = Entry { keep, pulled, ..Entry::new(name, listed.bytes, listed.modified_ns) };
    entry.inspect(&file)?;
    Ok(entry)
}

fn mark_open_segments(entries: &mut [Entry], now_ns: u64) {
    let last: BTreeMap<String, Name> =
        entries.iter().map(|entry| (entry.name.run().to_owned(), entry.name.clone())).collect();
    for entry in entries.iter_mut().filter(|entry| entry.state == State::Cut) {
        // The absolute difference, because a modification time far in the future was written before the clock was set back.
        // A recorder that still writes to the segment updates the time within a second; without this rule such a segment
        // would count as open for ever.
        let is_fresh = now_ns.abs_diff(entry.modified_ns) < OPEN_FOR_NS;
        if is_fresh && last.get(entry.name.run()) == Some(&entry.name) {
            entry.state = State::Open;
        }
    }
}
