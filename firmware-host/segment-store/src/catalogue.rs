//! The list of all segments of a store, from names, sizes, markers and the ends of files; the data are not read.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::{Path, PathBuf};
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
    /// What cannot be read. Its segments are not among the entries.
    pub unread: Vec<Unread>,
}

/// A segment or a directory of a store that cannot be read. It is shown as a sentence that says why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unread {
    pub path: PathBuf,
    /// The name, if it is a segment.
    pub name: Option<Name>,
    why: String,
}

impl fmt::Display for Unread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.why)
    }
}

/// Segments that are missing between two segments of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gap {
    run: String,
    /// The numbers of the first and the last segment that is missing.
    numbers: (u32, u32),
}

impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (first, last) = self.numbers;
        if !self.run.is_empty() {
            write!(f, "{}/", self.run)?;
        }
        write!(f, "recording_{first:04}.mcap")?;
        if last > first { write!(f, " to recording_{last:04}.mcap") } else { Ok(()) }
    }
}

impl Catalogue {
    /// Lists the segments of a store, and what cannot be read.
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
        let mut found = Self::default();
        let top = root
            .folder("")
            .and_then(|top| list(top.as_fd()))
            .map_err(StoreError::read(root.path()))?;
        found.read_run(root, "", &top);
        // Every ext4 disk has the directory `lost+found`, which only root can read; it holds no run.
        let is_run =
            |listed: &&Listed| listed.kind == FileType::Directory && listed.name != "lost+found";
        for run in top.iter().filter(is_run) {
            match root.folder(&run.name).and_then(|folder| list(folder.as_fd())) {
                Ok(listed) => found.read_run(root, &run.name, &listed),
                Err(error) => found.leave_out(root, &run.name, None, error),
            }
        }
        Ok(Self { unread: found.unread, ..Self::new(found.entries, now_ns) })
    }

    /// Sorts the entries and decides which of those without an end are still being written at `now_ns`.
    #[must_use]
    pub fn new(mut entries: Vec<Entry>, now_ns: u64) -> Self {
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        mark_open_segments(&mut entries, now_ns);
        Self { entries, unread: Vec::new() }
    }

    /// The segments that are missing between others of their run: the robot deleted them for space, or they were not copied.
    /// Those before the first one of a run are not known.
    #[must_use]
    pub fn gaps(&self) -> Vec<Gap> {
        let listed = self.entries.iter().map(|entry| &entry.name);
        let unread = self.unread.iter().filter_map(|unread| unread.name.as_ref());
        let mut names: Vec<&Name> = listed.chain(unread).collect();
        names.sort();
        let pairs = names.iter().zip(names.iter().skip(1));
        pairs.filter_map(|(name, next)| gap(name, next)).collect()
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

    fn read_run(&mut self, root: &Root, run: &str, listed: &[Listed]) {
        let Ok(folder) = root.folder(run) else { return };
        let prefix = if run.is_empty() { String::new() } else { format!("{run}/") };
        for file in listed.iter().filter(|file| file.kind != FileType::Directory) {
            let Ok(name) = Name::parse(&format!("{prefix}{}", file.name)) else { continue };
            let pulled = if has_marker(listed, &file.name, marks::PULLED) {
                marks::read_pulled(folder.as_fd(), &file.name, file.bytes, file.modified_ns)
            } else {
                Pulled::No
            };
            let keep = has_marker(listed, &file.name, marks::KEEP);
            match read_entry(folder.as_fd(), name.clone(), file, keep, pulled) {
                Ok(entry) => self.entries.push(entry),
                Err(error) => {
                    let relative = name.as_str().to_owned();
                    self.leave_out(root, &relative, Some(name), error);
                }
            }
        }
    }

    /// Notes what cannot be read, unless it was deleted since its directory was listed.
    fn leave_out(&mut self, root: &Root, relative: &str, name: Option<Name>, error: io::Error) {
        if error.kind() != io::ErrorKind::NotFound {
            let path = root.path().join(relative);
            let why = StoreError::read(&path)(error).to_string();
            self.unread.push(Unread { path, name, why });
        }
    }
}

/// What is missing between two names that follow each other.
fn gap(name: &Name, next: &Name) -> Option<Gap> {
    let first = name.number()?.checked_add(1)?;
    let last = next.number()?.checked_sub(1)?;
    let is_gap = name.run() == next.run() && first <= last;
    is_gap.then(|| Gap { run: name.run().to_owned(), numbers: (first, last) })
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
    if listed.kind == FileType::Symlink {
        let text =
            "it is a symbolic link, which is not followed; give the directory that it points into";
        return Err(io::Error::other(text));
    }
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
