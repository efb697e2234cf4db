//! What a workstation asks.

use super::WireError;
use crate::digest::Digest;
use crate::name::Name;
use crate::records::Fields;
use crate::send::Have;

/// Tells our stream from any other.
pub(super) const MAGIC: &[u8; 8] = b"edbuffer";

/// A question.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// First of all: the protocol versions that the workstation speaks, lowest and highest.
    Hello {
        /// Lowest and highest.
        versions: (u16, u16),
    },
    /// What is there?
    List,
    /// The rest of a file behind what the workstation has.
    Fetch {
        /// Which.
        name: Name,
        /// What is there already.
        have: Have,
    },
    /// The workstation has this file safely on its disk.
    Mark {
        /// Which.
        name: Name,
        /// What it has.
        digest: Digest,
    },
    /// What computer are you? From version 2 on.
    Computer,
}

impl Request {
    /// Appends the body and gives the kind.
    pub fn encode(&self, body: &mut Vec<u8>) -> u8 {
        match self {
            Self::Hello { versions } => {
                body.extend_from_slice(MAGIC);
                body.extend_from_slice(&versions.0.to_le_bytes());
                body.extend_from_slice(&versions.1.to_le_bytes());
                1
            }
            Self::List => 2,
            Self::Fetch { name, have } => {
                body.extend_from_slice(&have.bytes.to_le_bytes());
                body.extend_from_slice(have.digest.as_bytes());
                body.extend_from_slice(name.as_str().as_bytes());
                3
            }
            Self::Mark { name, digest } => {
                body.extend_from_slice(digest.as_bytes());
                body.extend_from_slice(name.as_str().as_bytes());
                4
            }
            Self::Computer => 5,
        }
    }

    /// From a frame.
    ///
    /// # Errors
    /// [`WireError::Malformed`].
    pub fn decode(kind: u8, body: &[u8]) -> Result<Self, WireError> {
        let mut fields = Fields(body);
        let request = match kind {
            1 if fields.take(MAGIC.len()) == Some(MAGIC) => {
                fields.u16().zip(fields.u16()).map(|versions| Self::Hello { versions })
            }
            2 => Some(Self::List),
            3 => fields.u64().zip(fields.array()).zip(rest_as_name(&mut fields)?).map(
                |((bytes, digest), name)| Self::Fetch {
                    name,
                    have: Have { bytes, digest: Digest::from_bytes(digest) },
                },
            ),
            4 => fields
                .array()
                .zip(rest_as_name(&mut fields)?)
                .map(|(digest, name)| Self::Mark { name, digest: Digest::from_bytes(digest) }),
            5 => Some(Self::Computer),
            _ => return Err(WireError::Malformed("a request of unknown kind")),
        };
        request
            .filter(|_| fields.0.is_empty())
            .ok_or(WireError::Malformed("a request of the wrong length"))
    }
}

/// Everything that is left, as a name. A body that is too short gives `None`.
fn rest_as_name(fields: &mut Fields<'_>) -> Result<Option<Name>, WireError> {
    let text = std::str::from_utf8(fields.0)
        .map_err(|_| WireError::Malformed("a name that is no text"))?;
    fields.0 = &[];
    Name::parse(text).map(Some).map_err(|_| WireError::Malformed("a name that is none of a buffer"))
}
