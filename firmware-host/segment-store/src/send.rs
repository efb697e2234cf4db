//! One file on its way: from where the receiver's part ends, with the digest of the whole.

use std::fs::File;
use std::io::{self, Seek, SeekFrom};
use std::os::unix::fs::FileExt;

use crate::digest::{Digest, Hasher, PIECE};
use crate::root::file_modified_ns;

/// What the receiver has of a file already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Have {
    /// Its length.
    pub bytes: u64,
    /// Its digest.
    pub digest: Digest,
}

impl Have {
    /// Nothing.
    #[must_use]
    pub fn nothing() -> Self {
        Self { bytes: 0, digest: Digest::of(b"") }
    }
}

/// A file that was sent to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sent {
    pub digest: Digest,
    pub bytes: u64,
    pub modified_ns: u64,
}

/// Why a file was not sent to its end.
pub(crate) enum SendError<E> {
    /// It cannot be read.
    Read(io::Error),
    /// It was written meanwhile.
    Changed,
    /// The receiver does not take it.
    Sink(E),
}

/// Where a file goes, as a sender sees it.
pub trait Receive<E> {
    /// The bytes from `from` on follow, up to `length`. `from` is 0 when what the receiver has is not the beginning.
    fn start(&mut self, from: u64, length: u64) -> Result<(), E>;
    /// The next bytes.
    fn data(&mut self, at: u64, bytes: &[u8]) -> Result<(), E>;
    /// A long beginning is being compared.
    fn working(&mut self) -> Result<(), E>;
}

/// Bytes after which a sender that compares says that it is still there: 3 s of a slow SD card.
const SIGN_OF_LIFE: u64 = 64 << 20;

/// Sends the rest of `file` behind what the receiver has.
pub(crate) fn send<E>(
    file: &mut File,
    have: Have,
    to: &mut dyn Receive<E>,
) -> Result<Sent, SendError<E>> {
    let before = file.metadata().map_err(SendError::Read)?;
    let length = before.len();
    let mut hasher = prefix(file, have, length, to)?;
    let mut at = hasher.bytes();
    to.start(at, length).map_err(SendError::Sink)?;
    let mut buffer = vec![0; PIECE];
    while at < length {
        let left = usize::try_from(length - at).unwrap_or(PIECE).min(PIECE);
        let piece = buffer.get_mut(..left).unwrap_or_default();
        match file.read_exact_at(piece, at) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                return Err(SendError::Changed);
            }
            read => read.map_err(SendError::Read)?,
        }
        hasher.update(piece);
        to.data(at, piece).map_err(SendError::Sink)?;
        at += left as u64;
    }
    let after = file.metadata().map_err(SendError::Read)?;
    let (modified_ns, still) = (file_modified_ns(&before), file_modified_ns(&after));
    if (after.len(), still) != (length, modified_ns) {
        return Err(SendError::Changed);
    }
    Ok(Sent { digest: hasher.digest(), bytes: length, modified_ns })
}

/// The hasher behind the beginning that both have, or a new one.
fn prefix<E>(
    file: &mut File,
    have: Have,
    length: u64,
    to: &mut dyn Receive<E>,
) -> Result<Hasher, SendError<E>> {
    let mut hasher = Hasher::default();
    if have.bytes == 0 || have.bytes > length {
        return Ok(hasher);
    }
    file.seek(SeekFrom::Start(0)).map_err(SendError::Read)?;
    while hasher.bytes() < have.bytes {
        let before = hasher.bytes();
        hasher.update_from(file, SIGN_OF_LIFE.min(have.bytes - before)).map_err(SendError::Read)?;
        if hasher.bytes() == before {
            return Err(SendError::Changed);
        }
        to.working().map_err(SendError::Sink)?;
    }
    Ok(if hasher.digest() == have.digest { hasher } else { Hasher::default() })
}
