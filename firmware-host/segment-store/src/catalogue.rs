//! What is in a buffer, from names, sizes, marks and the ends of files: never from the data.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::Path;
use std::time::SystemTime;

use mcap::records::op;
use rustix::fs::FileType;

use crate::bytes::Bytes;
use crate::digest::Digest;
use crate::error::BufferError;
use crate::marks::{self, Pulled};
use crate::name::Name;
use crate::records::{self, Fields, MAGIC_LEN};
use crate::root::{Listed, Root, list, open_regular};

/// A segment without an end that is the last of its run and was written this short ago is still being written: the
/// recorder closes a chunk every second.
pub const OPEN_FOR_NS: u64 = 30_000_000_000;

/// Records of a segment without an index that are looked at: 256 MiB in chunks of a second hold some thousands.
const MAX_WALK: usize = 20_000;

/// How a segment ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// With its index.
    Closed,
    /// Properly, but without an index: the disk was full.
    Unindexed,
    /// Somewhere: the program or the power was cut off. [`recover`](crate::recover) makes it whole.
    Cut,
    /// Not yet: it is being written.
    Open,
}

impl State {
    /// One word for people.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Closed => "whole",
            Self::Unindexed => "no index",
            Self::Cut => "cut",
            Self::Open => "open",
        }
    }
}

/// First and last message, on the run's own monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Times {
    /// Nanoseconds.
    pub first_ns: u64,
    /// Nanoseconds.
    pub last_ns: u64,
}

/// A file of a buffer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Where.
    pub name: Name,
    /// Size.
    pub bytes: u64,
    /// Last change, since 1970.
    pub modified_ns: u64,
    /// How it ends.
    pub state: State,
    /// What span of the run it holds, where its end or its chunks tell.
    pub times: Option<Times>,
    /// Turns of the loop, where its index tells.
    pub turns: Option<u64>,
    /// Stops, refusals, choices, where its index tells.
    pub events: Option<u64>,
    /// Never deleted by the robot.
    pub keep: bool,
    /// Whether a workstation has it.
    pub pulled: Pulled,
}

impl Entry {
    /// A file of which only name, size and time are known.
    #[must_use]
    pub fn new(name: Name, bytes: u64, modified_ns: u64) -> Self {
        let (state, pulled) = (State::Cut, Pulled::No);
        Self {
            name,
            bytes,
            modified_ns,
            state,
            times: None,
            turns: None,
            events: None,
            keep: false,
            pulled,
        }
    }

    /// Fills in what the end of the file tells, and where there is none the heads of its records.
    ///
    /// # Errors
    /// When it cannot be read. A file without an end is a [cut](State::Cut) one also then.
    pub fn look_into<B: Bytes + ?Sized>(&mut self, file: &B) -> io::Result<()> {
        let Some(footer) = records::footer(file, self.bytes)? else {
            self.state = State::Cut;
            self.times = chunk_times(file, self.bytes)?;
            return Ok(());
        };
        self.state = State::Unindexed;
        match records::summary(file, &footer)? {
            Some(summary) => {
                self.state = State::Closed;
                self.times = Some(Times { first_ns: summary.first_ns, last_ns: summary.last_ns });
                self.turns = Some(summary.messages_on("/robot/tick"));
                self.events = Some(summary.messages_on("/events"));
            }
            None => self.times = chunk_times(file, self.bytes)?,
        }
        Ok(())
    }

    /// The digest under which a workstation has it.
    #[must_use]
    pub fn pulled_digest(&self) -> Option<Digest> {
        match self.pulled {
            Pulled::Yes(digest) => Some(digest),
            Pulled::No | Pulled::Stale => None,
        }
    }
}

/// Everything in a buffer, in the order of [`Name`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Catalogue {
    /// Segments.
    pub entries: Vec<Entry>,
}

impl Catalogue {
    /// Looks through a buffer.
    ///
    /// # Errors
    /// When its directory cannot be read. Files that cannot be read are left out.
    pub fn read(root: &Root) -> Result<Self, BufferError> {
        let now_ns = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos() as u64);
        Self::read_at(root, now_ns)
    }

    /// As [`read`](Self::read), at the time `now_ns` since 1970.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_at(root: &Root, now_ns: u64) -> Result<Self, BufferError> {
        let mut entries = Vec::new();
        let top = root
            .folder("")
            .and_then(|top| list(top.as_fd()))
            .map_err(BufferError::read(root.path()))?;
        read_run(root, "", &top, &mut entries);
        for run in top.iter().filter(|listed| listed.kind == FileType::Directory) {
            // A directory that nobody may read holds no run of ours.
            let Ok(listed) = root.folder(&run.name).and_then(|folder| list(folder.as_fd())) else {
                continue;
            };
            read_run(root, &run.name, &listed, &mut entries);
        }
        Ok(Self::new(entries, now_ns))
    }

    /// Sorts entries, and tells which of those without an end are still being written at `now_ns`.
    #[must_use]
    pub fn new(mut entries: Vec<Entry>, now_ns: u64) -> Self {
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        tell_open_from_cut(&mut entries, now_ns);
        Self { entries }
    }

    /// The segments of one run after the other.
    #[must_use]
    pub fn runs(&self) -> BTreeMap<&str, Vec<&Entry>> {
        let mut runs: BTreeMap<&str, Vec<&Entry>> = BTreeMap::new();
        for entry in &self.entries {
            runs.entry(entry.name.run()).or_default().push(entry);
        }
        runs
    }

    /// Whether there is a segment at `path` or in it.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(path: &Path) -> Result<(Root, Self), BufferError> {
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
        let has = |suffix: &str| {
            listed.iter().any(|other| other.name.strip_suffix(suffix) == Some(&file.name))
        };
        let pulled = match has(marks::PULLED) {
            true => marks::read_pulled(folder.as_fd(), &file.name, file.bytes, file.modified_ns),
            false => Pulled::No,
        };
        entries.extend(read_entry(folder.as_fd(), name, file, has(marks::KEEP), pulled).ok());
    }
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
    entry.look_into(&file)?;
    Ok(entry)
}

/// Span of the chunks that are there as a whole, from the first sixteen bytes of each.
fn chunk_times<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<Option<Times>> {
    let (mut at, mut times) = (MAGIC_LEN, None::<Times>);
    for _ in 0..MAX_WALK {
        let Some(record) = records::record_at(file, at, length)? else { break };
        if record.opcode == op::CHUNK && record.body >= 16 {
            let mut head = [0; 16];
            file.read_exact_at(record.body_start(), &mut head)?;
            let mut fields = Fields(&head);
            if let (Some(first_ns), Some(last_ns)) = (fields.u64(), fields.u64()) {
                let first_ns = times.map_or(first_ns, |times| times.first_ns.min(first_ns));
                times = Some(Times {
                    first_ns,
                    last_ns: times.map_or(last_ns, |times| times.last_ns.max(last_ns)),
                });
            }
        }
        at = record.end();
    }
    Ok(times)
}

fn tell_open_from_cut(entries: &mut [Entry], now_ns: u64) {
    let last: BTreeMap<String, Name> =
        entries.iter().map(|entry| (entry.name.run().to_owned(), entry.name.clone())).collect();
    for entry in entries.iter_mut().filter(|entry| entry.state == State::Cut) {
        // Younger than now by more than that, it was written before the clock was set back: whoever still writes it changes
        // its time within a second, and else it would be open for ever.
        let fresh = now_ns.abs_diff(entry.modified_ns) < OPEN_FOR_NS;
        if fresh && last.get(entry.name.run()) == Some(&entry.name) {
            entry.state = State::Open;
        }
    }
}
