//! Sending of one file, starting where the receiver's copy ends.

use std::fs::File;
use std::io::{self, Seek, SeekFrom};
use std::os::unix::fs::FileExt;

use crate::digest::{Digest, Hasher, PIECE};
use crate::root::file_modified_ns;
use crate::transfer::{FileSink, LocalCopy};

/// The file as it was when it had been sent completely.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sent {
    pub digest: Digest,
    pub bytes: u64,
    pub modified_ns: u64,
}

/// Why a file was not sent completely.
pub(crate) enum SendError<E> {
    /// The file cannot be read.
    Read(io::Error),
    /// The file was written to while it was sent.
    Changed,
    /// The receiver returned an error.
    Sink(E),
}

/// While comparing, the sender reports progress after this many bytes, which a slow SD card reads in 3 s.
const COMPARE_REPORT_BYTES: u64 = 64 << 20;

/// Sends the bytes of `file` that the receiver does not have yet, or all of them when its copy is not the beginning of `file`.
pub(crate) fn send<E>(
    file: &mut File,
    local: LocalCopy,
    to: &mut dyn FileSink<E>,
) -> Result<Sent, SendError<E>> {
    let before = file.metadata().map_err(SendError::Read)?;
    let length = before.len();
    let mut hasher = hash_common_prefix(file, local, length, to)?;
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
    let modified_ns = file_modified_ns(&before);
    if (after.len(), file_modified_ns(&after)) != (length, modified_ns) {
        return Err(SendError::Changed);
    }
    Ok(Sent { digest: hasher.digest(), bytes: length, modified_ns })
}

/// Hashes the beginning of the file that the receiver has. When its digest differs, returns a hasher without any bytes.
fn hash_common_prefix<E>(
    file: &mut File,
    local: LocalCopy,
    length: u64,
    to: &mut dyn FileSink<E>,
) -> Result<Hasher, SendError<E>> {
    let mut hasher = Hasher::default();
    if local.bytes == 0 || local.bytes > length {
        return Ok(hasher);
    }
    file.seek(SeekFrom::Start(0)).map_err(SendError::Read)?;
    while hasher.bytes() < local.bytes {
        let before = hasher.bytes();
        hasher
            .update_from(file, COMPARE_REPORT_BYTES.min(local.bytes - before))
            .map_err(SendError::Read)?;
        if hasher.bytes() == before {
            return Err(SendError::Changed);
        }
        to.comparing().map_err(SendError::Sink)?;
    }
    Ok(if hasher.digest() == local.digest { hasher } else { Hasher::default() })
}
