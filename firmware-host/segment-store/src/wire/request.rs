//! The requests of a workstation.

use super::frame::WireError;
use crate::digest::Digest;
use crate::fields::Fields;
use crate::name::Name;
use crate::transfer::LocalCopy;

/// The first bytes of `Hello` and `Welcome`, which identify the protocol.
pub(super) const MAGIC: &[u8; 8] = b"edbuffer";

/// A message from the workstation to the robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// The first request of every session.
    Hello {
        /// The lowest and the highest protocol version that the workstation supports.
        versions: (u16, u16),
    },
    /// Asks for all segments of the store.
    List,
    /// Asks for the bytes of a segment that follow the workstation's copy.
    Fetch { name: Name, local: LocalCopy },
    /// Reports that the workstation has the segment with this digest on its disk.
    Mark { name: Name, digest: Digest },
    /// Asks for the features of the robot's processor; supported from version 2 on.
    CpuFeatures,
}

impl Request {
    /// Appends the body to `body` and returns the kind.
    pub fn encode(&self, body: &mut Vec<u8>) -> u8 {
        match self {
            Self::Hello { versions } => {
                body.extend_from_slice(MAGIC);
                body.extend_from_slice(&versions.0.to_le_bytes());
                body.extend_from_slice(&versions.1.to_le_bytes());
                1
            }
            Self::List => 2,
            Self::Fetch { name, local } => {
                body.extend_from_slice(&local.bytes.to_le_bytes());
                body.extend_from_slice(local.digest.as_bytes());
                body.extend_from_slice(name.as_str().as_bytes());
                3
            }
            Self::Mark { name, digest } => {
                body.extend_from_slice(digest.as_bytes());
                body.extend_from_slice(name.as_str().as_bytes());
                4
            }
            Self::CpuFeatures => 5,
        }
    }

    /// Decodes the body of a frame of the given kind.
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
                    local: LocalCopy { bytes, digest: Digest::from_bytes(digest) },
                },
            ),
            4 => fields
                .array()
                .zip(rest_as_name(&mut fields)?)
                .map(|(digest, name)| Self::Mark { name, digest: Digest::from_bytes(digest) }),
            5 => Some(Self::CpuFeatures),
            _ => return Err(WireError::Malformed("a request of unknown kind")),
        };
        request
            .filter(|_| fields.0.is_empty())
            .ok_or(WireError::Malformed("a request of the wrong length"))
    }
}

/// The remaining bytes as a name.
fn rest_as_name(fields: &mut Fields<'_>) -> Result<Option<Name>, WireError> {
    let text = std::str::from_utf8(fields.0)
        .map_err(|_| WireError::Malformed("a name that is not UTF-8"))?;
    fields.0 = &[];
    Name::parse(text).map(Some).map_err(|_| WireError::Malformed("a name that is not a segment's"))
}
