//! Frames.

use std::io::{self, Read, Write};

use crate::digest::PIECE;

/// Length and kind.
pub const HEAD: usize = 5;
/// Longest body of a request: a name and a digest.
pub const MAX_REQUEST: usize = 4 << 10;
/// Longest body of a reply: a piece of data and its offset.
pub const MAX_REPLY: usize = PIECE + 8;

/// Why bytes are no message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WireError {
    /// The first bytes are something else.
    #[error(
        "what answers is not `firmware-host buffer serve`: it began with {0:?}; a shell that prints something when it \
         starts must not do so for commands (see: ssh HOST true)"
    )]
    Foreign(String),
    /// A frame larger than any.
    #[error(
        "a message of {length} bytes where {limit} are the limit: the connection is broken or the other side is hostile; pull again"
    )]
    TooLong {
        /// What it says.
        length: u32,
        /// What may be.
        limit: usize,
    },
    /// A kind that is not known, or a body that does not fit.
    #[error(
        "a broken message ({0}): the connection is broken or the other side is hostile; pull again"
    )]
    Malformed(&'static str),
    /// A message that does not answer what was asked.
    #[error("{0}, out of turn: the connection is broken or the other side is hostile; pull again")]
    Unexpected(&'static str),
}

impl WireError {
    /// Whether the other side is no robot at all.
    #[must_use]
    pub fn is_foreign(&self) -> bool {
        matches!(self, Self::Foreign(_))
    }
}

/// Splits a frame's head into kind and the body's length.
///
/// # Errors
/// [`WireError::TooLong`].
fn parse_head(head: [u8; HEAD], limit: usize) -> Result<(u8, usize), WireError> {
    let [a, b, c, d, kind] = head;
    let length = u32::from_le_bytes([a, b, c, d]);
    match usize::try_from(length) {
        Ok(bytes) if bytes <= limit => Ok((kind, bytes)),
        _ => Err(WireError::TooLong { length, limit }),
    }
}

/// Reads a frame's body into `body` and gives its kind; `None` at the stream's end between two frames.
///
/// # Errors
/// The outer when the stream fails or ends within a frame, the inner when the frame is too long; `body` then holds its head.
pub fn read_frame(
    source: &mut (impl Read + ?Sized),
    body: &mut Vec<u8>,
    limit: usize,
) -> io::Result<Result<Option<u8>, WireError>> {
    let mut head = [0; HEAD];
    let mut filled = 0;
    while filled < HEAD {
        match source.read(head.get_mut(filled..).unwrap_or_default()) {
            Ok(0) if filled == 0 => return Ok(Ok(None)),
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(read) => filled += read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    match parse_head(head, limit) {
        Ok((kind, length)) => {
            body.resize(length, 0);
            source.read_exact(body)?;
            Ok(Ok(Some(kind)))
        }
        Err(error) => {
            body.clear();
            body.extend_from_slice(&head);
            Ok(Err(error))
        }
    }
}

/// Writes a frame in one piece. `buffer` is scratch.
///
/// # Errors
/// When the stream fails.
pub fn write_frame(
    sink: &mut (impl Write + ?Sized),
    buffer: &mut Vec<u8>,
    encode: impl FnOnce(&mut Vec<u8>) -> u8,
) -> io::Result<()> {
    buffer.clear();
    buffer.extend_from_slice(&[0; HEAD]);
    let kind = encode(buffer);
    let length = u32::try_from(buffer.len() - HEAD).map_err(|_| io::ErrorKind::InvalidInput)?;
    if let Some(head) = buffer.first_chunk_mut::<HEAD>() {
        let [a, b, c, d] = length.to_le_bytes();
        *head = [a, b, c, d, kind];
    }
    sink.write_all(buffer)
}
