//! What is known about one segment of a store.

use std::io;

use mcap::records::op;

use crate::bytes::Bytes;
use crate::digest::Digest;
use crate::fields::Fields;
use crate::name::Name;
use crate::records::{self, MAGIC_LEN};

/// At most this many records are visited in a segment without an index; 256 MiB in chunks of one second hold a few thousand.
const MAX_RECORDS: usize = 20_000;

/// How a segment ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// With its index.
    Closed,
    /// With its footer but without an index, because the disk was full.
    Unindexed,
    /// In the middle of the data, because the program or the power failed. [`recover`](crate::recover()) repairs it.
    Cut,
    /// A recorder still writes to it.
    Open,
}

impl State {
    /// The state in a table for operators.
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

/// The times of the first and the last message, on the run's monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Times {
    pub first_ns: u64,
    pub last_ns: u64,
}

/// Whether a workstation has a copy of a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pulled {
    /// There is no `.pulled` marker.
    No,
    /// There is a marker, but it describes other contents: the segment has changed since.
    Stale,
    /// The marker matches the segment and contains this digest.
    Yes(Digest),
}

impl Pulled {
    /// The contents of the marker of a segment that has `bytes` bytes and was last modified at `modified_ns`.
    #[must_use]
    pub fn text(digest: &Digest, bytes: u64, modified_ns: u64) -> String {
        format!("{digest} {bytes} {modified_ns}\n")
    }

    /// Compares the contents of a marker with the present size and modification time of the segment.
    #[must_use]
    pub fn parse(text: &str, bytes: u64, modified_ns: u64) -> Self {
        let mut words = text.split_ascii_whitespace();
        let digest = words.next().and_then(|word| word.parse().ok());
        let marked_bytes = words.next().and_then(|word| word.parse::<u64>().ok());
        let marked_ns = words.next().and_then(|word| word.parse::<u64>().ok());
        match digest {
            Some(digest) if (marked_bytes, marked_ns) == (Some(bytes), Some(modified_ns)) => {
                Self::Yes(digest)
            }
            _ => Self::Stale,
        }
    }
}

/// One segment of a store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    pub name: Name,
    /// The size of the file.
    pub bytes: u64,
    /// The time of the last modification, since 1970.
    pub modified_ns: u64,
    pub state: State,
    /// The time span of the segment, from its index or from the heads of its chunks.
    pub times: Option<Times>,
    /// The number of ticks of the control loop; known only with an index.
    pub ticks: Option<u64>,
    /// The number of events (stops, refusals, choices); known only with an index.
    pub events: Option<u64>,
    /// There is a `.keep` marker: an operator or an event protects the segment from the quota.
    pub keep: bool,
    pub pulled: Pulled,
}

impl Entry {
    /// An entry before the file has been inspected: only its name, size and modification time are known.
    #[must_use]
    pub fn new(name: Name, bytes: u64, modified_ns: u64) -> Self {
        Self {
            name,
            bytes,
            modified_ns,
            state: State::Cut,
            times: None,
            ticks: None,
            events: None,
            keep: false,
            pulled: Pulled::No,
        }
    }

    /// Reads state, times and counts from the end of the file or, without an index, the times from the heads of its chunks.
    ///
    /// # Errors
    /// When the file cannot be read. The state is valid nevertheless: a file without an end is [cut](State::Cut).
    pub fn inspect<B: Bytes + ?Sized>(&mut self, file: &B) -> io::Result<()> {
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
                self.ticks = Some(summary.messages_on("/robot/tick"));
                self.events = Some(summary.messages_on("/events"));
            }
            None => self.times = chunk_times(file, self.bytes)?,
        }
        Ok(())
    }

    /// The digest of the workstation's copy, if that copy is current.
    #[must_use]
    pub fn pulled_digest(&self) -> Option<Digest> {
        match self.pulled {
            Pulled::Yes(digest) => Some(digest),
            Pulled::No | Pulled::Stale => None,
        }
    }
}

/// The time span of all complete chunks. The first sixteen bytes of a chunk hold the times of its first and last message (MCAP
/// specification, "Chunk").
fn chunk_times<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<Option<Times>> {
    let mut at = MAGIC_LEN;
    let mut times = None::<Times>;
    for _ in 0..MAX_RECORDS {
        let Some(record) = records::record_at(file, at, length)? else { break };
        if record.opcode == op::CHUNK && record.body >= 16 {
            let mut head = [0; 16];
            file.read_exact_at(record.body_start(), &mut head)?;
            let mut fields = Fields(&head);
            if let (Some(first_ns), Some(last_ns)) = (fields.u64(), fields.u64()) {
                let first_ns = times.map_or(first_ns, |times| times.first_ns.min(first_ns));
                let last_ns = times.map_or(last_ns, |times| times.last_ns.max(last_ns));
                times = Some(Times { first_ns, last_ns });
            }
        }
        at = record.end();
    }
    Ok(times)
}
