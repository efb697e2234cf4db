//! Reading and writing of frames.

use std::io::{self, Read, Write};

use crate::digest::PIECE;

/// The size of a frame's header: the length of the body and the kind.
pub const HEAD: usize = 5;
/// Largest body of a request. The largest request is a name, a length and a digest.
pub const MAX_REQUEST: usize = 4 << 10;
/// Largest body of a reply: a piece of data and its offset.
pub const MAX_REPLY: usize = PIECE + 8;

/// Why received bytes are not a valid message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WireError {
    /// The first bytes do not belong to this protocol.
    #[error(
        "the answer is not from `firmware-host buffer serve`: it begins with {0:?}; a shell must not print anything when it \
         starts for a command (check with: ssh HOST true)"
    )]
    Foreign(String),
    /// The header of a frame announces a body that is too long.
    #[error(
        "a message of {length} bytes, more than the limit of {limit}: the connection is broken or the peer is hostile; pull again"
    )]
    TooLong { length: u32, limit: usize },
    /// The kind is unknown, or the body does not match the kind.
    #[error(
        "a malformed message ({0}): the connection is broken or the peer is hostile; pull again"
    )]
    Malformed(&'static str),
    /// A valid message that is not a reply to the request.
    #[error(
        "{0}, which is not an answer to the request: the connection is broken or the peer is hostile; pull again"
    )]
    Unexpected(&'static str),
}

impl WireError {
    /// Whether the peer does not speak this protocol at all.
    #[must_use]
    pub fn is_foreign(&self) -> bool {
        matches!(self, Self::Foreign(_))
    }
}

/// Parses the header of a frame into the kind and the length of the body.
fn parse_header(head: [u8; HEAD], limit: usize) -> Result<(u8, usize), WireError> {
    let [a, b, c, d, kind] = head;
    let length = u32::from_le_bytes([a, b, c, d]);
    match usize::try_from(length) {
        Ok(bytes) if bytes <= limit => Ok((kind, bytes)),
        _ => Err(WireError::TooLong { length, limit }),
    }
}

/// Reads one frame: its body into `body`, and returns its kind, or `None` when the stream ended between two frames.
///
/// # Errors
/// The outer error when the stream fails or ends within a frame; the inner error when the frame is too long. In the latter case
/// `body` holds its header.
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
    match parse_header(head, limit) {
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

/// Writes one frame with a single call of `write_all`. `encode` appends the body and returns the kind; `buffer` is reused
/// memory.
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
