//! The replies of a robot.

use std::fmt;

use super::frame::WireError;
use super::request::MAGIC;
use crate::cpu_features::CpuFeatures;
use crate::digest::Digest;
use crate::entry::{Entry, Pulled, State, Times};
use crate::fields::Fields;
use crate::name::Name;

/// At most this many bytes of a text are sent, and this many characters of it shown.
const MAX_TEXT: usize = 2000;

/// Why a robot refuses a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RefusalKind {
    /// There is no common protocol version.
    Version,
    /// The request cannot be decoded.
    Malformed,
    /// The file does not exist or is not a regular file.
    NotThere,
    /// The file was written to while it was sent.
    Changed,
    /// The robot cannot read or write its disk.
    Disk,
}

/// The reason why a robot refuses a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    pub kind: RefusalKind,
    /// An error message for the operator.
    pub text: String,
}

impl Refusal {
    /// Whether the same request may succeed later.
    #[must_use]
    pub fn is_temporary(&self) -> bool {
        self.kind == RefusalKind::Changed
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&printable(&self.text))
    }
}

/// The text of a peer without control characters, which must not reach the terminal.
fn printable(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(MAX_TEXT).collect()
}

/// A message from the robot to the workstation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply<'a> {
    /// Accepts the session and selects its protocol version.
    Welcome {
        version: u16,
    },
    Refused(Refusal),
    /// One segment of the store.
    Entry(Entry),
    /// Why a segment or a directory of the store is not in the list; from version 3 on.
    Unread(String),
    /// The end of the list of segments.
    ListEnd,
    /// The robot is still comparing the workstation's copy with its file.
    Comparing,
    /// Announces the bytes of a file.
    Start {
        /// The offset of the first byte; 0 when the workstation's copy is not the beginning of the file.
        from: u64,
        /// The length of the whole file.
        length: u64,
    },
    /// Bytes of a file, beginning at offset `at`.
    Data {
        at: u64,
        bytes: &'a [u8],
    },
    /// The file was sent completely.
    End {
        /// The digest of the whole file.
        digest: Digest,
    },
    /// The `.pulled` marker is on the robot's disk.
    Marked,
    /// The features of the robot's processor.
    CpuFeatures(CpuFeatures),
}

impl<'a> Reply<'a> {
    /// Appends the body to `body` and returns the kind.
    pub fn encode(&self, body: &mut Vec<u8>) -> u8 {
        match self {
            Self::Welcome { version } => {
                body.extend_from_slice(MAGIC);
                body.extend_from_slice(&version.to_le_bytes());
                128
            }
            Self::Refused(refusal) => {
                body.push(refusal.kind as u8);
                encode_text(&refusal.text, body);
                129
            }
            Self::Entry(entry) => {
                encode_entry(entry, body);
                130
            }
            Self::ListEnd => 131,
            Self::Comparing => 132,
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
            Self::CpuFeatures(cpu) => {
                body.push(u8::from(cpu.aes));
                137
            }
            Self::Unread(why) => {
                encode_text(why, body);
                138
            }
        }
    }

    /// Decodes the body of a frame of the given kind.
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
            132 => Some(Self::Comparing),
            133 => {
                fields.u64().zip(fields.u64()).map(|(from, length)| Self::Start { from, length })
            }
            134 => fields.u64().map(|at| Self::Data { at, bytes: fields.rest() }),
            135 => fields.array().map(|digest| Self::End { digest: Digest::from_bytes(digest) }),
            136 => Some(Self::Marked),
            137 => fields
                .u8()
                .filter(|aes| *aes <= 1)
                .map(|aes| Self::CpuFeatures(CpuFeatures { aes: aes == 1 })),
            138 => decode_text(&mut fields).map(|why| Self::Unread(printable(why))),
            _ => return Err(WireError::Malformed("a reply of unknown kind")),
        };
        reply
            .filter(|_| fields.0.is_empty())
            .ok_or(WireError::Malformed("a reply with invalid contents"))
    }

    /// The kind of message, for error messages.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Welcome { .. } => "a greeting",
            Self::Refused(_) => "a refusal",
            Self::Entry(_) | Self::Unread(_) | Self::ListEnd => "a list",
            Self::Comparing | Self::Start { .. } => "the start of a file",
            Self::Data { .. } => "data",
            Self::End { .. } => "the end of a file",
            Self::Marked => "a confirmation of a mark",
            Self::CpuFeatures(_) => "processor features",
        }
    }
}

fn decode_refusal(fields: &mut Fields<'_>) -> Option<Refusal> {
    use RefusalKind::{Changed, Disk, Malformed, NotThere, Version};
    let number = fields.u8()?;
    let kind = [Version, Malformed, NotThere, Changed, Disk]
        .into_iter()
        .find(|kind| *kind as u8 == number)?;
    let text = decode_text(fields)?.to_owned();
    Some(Refusal { kind, text })
}

/// Appends the beginning of a text that has at most [`MAX_TEXT`] bytes.
fn encode_text(text: &str, body: &mut Vec<u8>) {
    let mut end = text.len().min(MAX_TEXT);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    body.extend_from_slice(text.get(..end).unwrap_or_default().as_bytes());
}

/// The remaining bytes as a text.
fn decode_text<'a>(fields: &mut Fields<'a>) -> Option<&'a str> {
    std::str::from_utf8(fields.rest()).ok()
}

const HAS_TIMES: u8 = 1;
const HAS_TICKS: u8 = 2;
const HAS_EVENTS: u8 = 4;
const KEEP: u8 = 8;
const STALE: u8 = 16;
const PULLED: u8 = 32;

/// Layout: size, modification time, state, flags, the optional fields that the flags announce, and the name.
fn encode_entry(entry: &Entry, body: &mut Vec<u8>) {
    body.extend_from_slice(&entry.bytes.to_le_bytes());
    body.extend_from_slice(&entry.modified_ns.to_le_bytes());
    body.push(entry.state as u8);
    body.push(
        flag(entry.times.is_some(), HAS_TIMES)
            | flag(entry.ticks.is_some(), HAS_TICKS)
            | flag(entry.events.is_some(), HAS_EVENTS)
            | flag(entry.keep, KEEP)
            | flag(entry.pulled == Pulled::Stale, STALE)
            | flag(entry.pulled_digest().is_some(), PULLED),
    );
    if let Some(times) = entry.times {
        body.extend_from_slice(&times.first_ns.to_le_bytes());
        body.extend_from_slice(&times.last_ns.to_le_bytes());
    }
    for number in [entry.ticks, entry.events].into_iter().flatten() {
        body.extend_from_slice(&number.to_le_bytes());
    }
    if let Some(digest) = entry.pulled_digest() {
        body.extend_from_slice(digest.as_bytes());
    }
    body.extend_from_slice(entry.name.as_str().as_bytes());
}

fn flag(is_set: bool, flag: u8) -> u8 {
    if is_set { flag } else { 0 }
}

fn has(flags: u8, flag: u8) -> bool {
    flags & flag != 0
}

fn decode_entry(fields: &mut Fields<'_>) -> Option<Entry> {
    use State::{Closed, Cut, Open, Unindexed};
    let bytes = fields.u64()?;
    let modified_ns = fields.u64()?;
    let number = fields.u8()?;
    let state = [Closed, Unindexed, Cut, Open].into_iter().find(|state| *state as u8 == number)?;
    let flags = fields.u8()?;
    let times = match has(flags, HAS_TIMES) {
        true => Some(Times { first_ns: fields.u64()?, last_ns: fields.u64()? }),
        false => None,
    };
    let ticks = if has(flags, HAS_TICKS) { Some(fields.u64()?) } else { None };
    let events = if has(flags, HAS_EVENTS) { Some(fields.u64()?) } else { None };
    let pulled = match (has(flags, PULLED), has(flags, STALE)) {
        (false, false) => Pulled::No,
        (false, true) => Pulled::Stale,
        (true, false) => Pulled::Yes(Digest::from_bytes(fields.array()?)),
        (true, true) => return None,
    };
    let known = HAS_TIMES | HAS_TICKS | HAS_EVENTS | KEEP | STALE | PULLED;
    let name = Name::parse(std::str::from_utf8(fields.rest()).ok()?).ok()?;
    (flags & !known == 0).then_some(Entry {
        name,
        bytes,
        modified_ns,
        state,
        times,
        ticks,
        events,
        keep: has(flags, KEEP),
        pulled,
    })
}
