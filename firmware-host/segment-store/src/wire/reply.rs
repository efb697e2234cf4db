//! What a robot answers.

use std::fmt;

use super::WireError;
use super::request::MAGIC;
use crate::catalogue::{Entry, State, Times};
use crate::computer::Computer;
use crate::digest::Digest;
use crate::marks::Pulled;
use crate::name::Name;
use crate::records::Fields;

/// Longest reason that is sent and shown.
const MAX_TEXT: usize = 2000;

/// Why a robot says no.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RefusalKind {
    /// No common protocol version.
    Version,
    /// A request that cannot be understood.
    Malformed,
    /// The file is not there, or no regular file.
    NotThere,
    /// The file was written while it was sent.
    Changed,
    /// The robot's disk refuses.
    Disk,
}

/// A robot's no, with its reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub kind: RefusalKind,
    /// In words, with the way out.
    pub text: String,
}

impl Refusal {
    /// Whether another try may go well.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.kind == RefusalKind::Changed
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // From the other side: a terminal must not obey it.
        self.text
            .chars()
            .filter(|c| !c.is_control())
            .take(MAX_TEXT)
            .try_for_each(|c| write!(f, "{c}"))
    }
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply<'a> {
    /// Both speak this version from now on.
    Welcome {
        /// It.
        version: u16,
    },
    /// No.
    Refused(Refusal),
    /// A file that is there.
    Entry(Entry),
    /// That were all.
    ListEnd,
    /// The beginning is being compared; it takes a while.
    Working,
    /// The file's bytes from `from` up to `length` follow.
    Start {
        /// 0 when what the workstation has is not the file's beginning.
        from: u64,
        /// The file's length.
        length: u64,
    },
    /// The bytes from `at` on.
    Data {
        /// Offset in the file.
        at: u64,
        /// They.
        bytes: &'a [u8],
    },
    /// That was all of the file.
    End {
        /// Of the whole file.
        digest: Digest,
    },
    /// The mark is on the robot's disk.
    Marked,
    /// The robot's computer.
    Computer(Computer),
}

impl<'a> Reply<'a> {
    /// Appends the body and gives the kind.
    pub fn encode(&self, body: &mut Vec<u8>) -> u8 {
        match self {
            Self::Welcome { version } => {
                body.extend_from_slice(MAGIC);
                body.extend_from_slice(&version.to_le_bytes());
                128
            }
            Self::Refused(refusal) => {
                body.push(refusal.kind as u8);
                let mut end = refusal.text.len().min(MAX_TEXT);
                while !refusal.text.is_char_boundary(end) {
                    end -= 1;
                }
                body.extend_from_slice(refusal.text.get(..end).unwrap_or_default().as_bytes());
                129
            }
            Self::Entry(entry) => {
                encode_entry(entry, body);
                130
            }
            Self::ListEnd => 131,
            Self::Working => 132,
            Self::Start { from, length } => {
                body.extend_from_slice(&from.to_le_bytes());
                body.extend_from_slice(&length.to_le_bytes());
                133
            }
            Self::Data { at, bytes } => {
                body.extend_from_slice(&at.to_le_bytes());
                body.extend_from_slice(bytes);
                134
            }
            Self::End { digest } => {
                body.extend_from_slice(digest.as_bytes());
                135
            }
            Self::Marked => 136,
            Self::Computer(computer) => {
                body.push(u8::from(computer.aes));
                137
            }
        }
    }

    /// From a frame.
    ///
    /// # Errors
    /// [`WireError::Malformed`].
    pub fn decode(kind: u8, body: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = Fields(body);
        let reply = match kind {
            128 if fields.take(MAGIC.len()) == Some(MAGIC) => {
                fields.u16().map(|version| Self::Welcome { version })
            }
            129 => decode_refusal(&mut fields).map(Self::Refused),
            130 => decode_entry(&mut fields).map(Self::Entry),
            131 => Some(Self::ListEnd),
            132 => Some(Self::Working),
            133 => {
                fields.u64().zip(fields.u64()).map(|(from, length)| Self::Start { from, length })
            }
            134 => fields.u64().map(|at| Self::Data { at, bytes: std::mem::take(&mut fields.0) }),
            135 => fields.array().map(|digest| Self::End { digest: Digest::from_bytes(digest) }),
            136 => Some(Self::Marked),
            137 => fields
                .u8()
                .filter(|aes| *aes <= 1)
                .map(|aes| Self::Computer(Computer { aes: aes == 1 })),
            _ => return Err(WireError::Malformed("a reply of unknown kind")),
        };
        reply
            .filter(|_| fields.0.is_empty())
            .ok_or(WireError::Malformed("a reply whose contents cannot be"))
    }

    /// For messages about messages.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Welcome { .. } => "a greeting",
            Self::Refused(_) => "a refusal",
            Self::Entry(_) | Self::ListEnd => "a list",
            Self::Working | Self::Start { .. } => "the start of a file",
            Self::Data { .. } => "data",
            Self::End { .. } => "the end of a file",
            Self::Marked => "a mark",
            Self::Computer(_) => "what computer it is",
        }
    }
}

fn decode_refusal(fields: &mut Fields<'_>) -> Option<Refusal> {
    use RefusalKind::{Changed, Disk, Malformed, NotThere, Version};
    let number = fields.u8()?;
    let kind = [Version, Malformed, NotThere, Changed, Disk]
        .into_iter()
        .find(|kind| *kind as u8 == number)?;
    let text = std::str::from_utf8(std::mem::take(&mut fields.0)).ok()?.to_owned();
    Some(Refusal { kind, text })
}

const HAS_TIMES: u8 = 1;
const HAS_TURNS: u8 = 2;
const HAS_EVENTS: u8 = 4;
const KEEP: u8 = 8;
const STALE: u8 = 16;
const PULLED: u8 = 32;

/// Size, time, state, flags, what the flags say is there, and the name.
fn encode_entry(entry: &Entry, body: &mut Vec<u8>) {
    let flag = |set: bool, flag: u8| if set { flag } else { 0 };
    body.extend_from_slice(&entry.bytes.to_le_bytes());
    body.extend_from_slice(&entry.modified_ns.to_le_bytes());
    body.push(entry.state as u8);
    body.push(
        flag(entry.times.is_some(), HAS_TIMES)
            | flag(entry.turns.is_some(), HAS_TURNS)
            | flag(entry.events.is_some(), HAS_EVENTS)
            | flag(entry.keep, KEEP)
            | flag(entry.pulled == Pulled::Stale, STALE)
            | flag(entry.pulled_digest().is_some(), PULLED),
    );
    if let Some(times) = entry.times {
        body.extend_from_slice(&times.first_ns.to_le_bytes());
        body.extend_from_slice(&times.last_ns.to_le_bytes());
    }
    for number in [entry.turns, entry.events].into_iter().flatten() {
        body.extend_from_slice(&number.to_le_bytes());
    }
    if let Some(digest) = entry.pulled_digest() {
        body.extend_from_slice(digest.as_bytes());
    }
    body.extend_from_slice(entry.name.as_str().as_bytes());
}

fn decode_entry(fields: &mut Fields<'_>) -> Option<Entry> {
    use State::{Closed, Cut, Open, Unindexed};
    let (bytes, modified_ns) = (fields.u64()?, fields.u64()?);
    let number = fields.u8()?;
    let state = [Closed, Unindexed, Cut, Open].into_iter().find(|state| *state as u8 == number)?;
    let flags = fields.u8()?;
    let has = |flag: u8| flags & flag != 0;
    let times = match has(HAS_TIMES) {
        true => Some(Times { first_ns: fields.u64()?, last_ns: fields.u64()? }),
        false => None,
    };
    let mut number = |flag: u8| if has(flag) { fields.u64().map(Some) } else { Some(None) };
    let (turns, events) = (number(HAS_TURNS)?, number(HAS_EVENTS)?);
    let pulled = match (has(PULLED), has(STALE)) {
        (false, false) => Pulled::No,
        (false, true) => Pulled::Stale,
        (true, false) => Pulled::Yes(Digest::from_bytes(fields.array()?)),
        (true, true) => return None,
    };
    let known = HAS_TIMES | HAS_TURNS | HAS_EVENTS | KEEP | STALE | PULLED;
    let name = Name::parse(std::str::from_utf8(std::mem::take(&mut fields.0)).ok()?).ok()?;
    (flags & !known == 0).then_some(Entry {
        name,
        bytes,
        modified_ns,
        state,
        times,
        turns,
        events,
        keep: has(KEEP),
        pulled,
    })
}
