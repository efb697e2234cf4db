//! Signatures of segments: which robot recorded a segment, and that it has not been changed since.
//!
//! The last record of a signed segment's data, directly before the end of the data, is an MCAP metadata record with the name
//! `signature` and these entries:
//!
//! | entry | text |
//! |---|---|
//! | `robot` | the robot's public key (Ed25519, RFC 8032), 64 hexadecimal digits |
//! | `run` | identity of the run, 32 digits |
//! | `segment` | number of the segment in its run, decimal |
//! | `previous` | `digest` of the signed segment before it in the run; empty if there is none |
//! | `digest` | SHA-256 of all bytes of the file before this record, 64 digits |
//! | `signature` | signature of [`Statement::text`], 128 digits |
//!
//! The index behind the data is not signed, because a reader can do without it: a reader that relies on the signature reads the
//! file in order. No chunk or message may follow the signature, so that nothing can be appended
//! ([`check_signature`](crate::check_signature())). A segment that was cut by a power failure, or was recovered, has no signature.

use std::collections::BTreeMap;

use data_encoding::HEXLOWER;
use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};

/// Name of the metadata record.
pub const SIGNATURE: &str = "signature";
/// Number of entries of the metadata record.
const ENTRIES: usize = 6;

/// Whether a text has the form of a public key.
pub(crate) fn is_key(text: &str) -> bool {
    bytes::<32>(text).is_some()
}

/// The bytes of exactly `2 * N` lower-case digits.
fn bytes<const N: usize>(digits: &str) -> Option<[u8; N]> {
    HEXLOWER.decode(digits.as_bytes()).ok()?.try_into().ok()
}

/// The secret key with which a robot signs its segments.
#[derive(Clone, PartialEq, Eq)]
pub struct RobotKey(SigningKey);

impl RobotKey {
    /// The key of 32 random bytes.
    #[must_use]
    pub fn new(seed: &[u8; 32]) -> Self {
        Self(SigningKey::from_bytes(seed))
    }

    /// The key whose secret half is written as 64 hexadecimal digits.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        bytes(text).map(|seed| Self::new(&seed))
    }

    /// The secret half, 64 hexadecimal digits.
    #[must_use]
    pub fn secret(&self) -> String {
        HEXLOWER.encode(&self.0.to_bytes())
    }

    /// The public half, 64 hexadecimal digits: the robot's identity.
    #[must_use]
    pub fn public(&self) -> String {
        HEXLOWER.encode(self.0.verifying_key().as_bytes())
    }

    /// The entries of the metadata record that states `statement`. Its `robot` must be this key.
    #[must_use]
    pub fn sign(&self, statement: &Statement) -> BTreeMap<String, String> {
        let signature = self.0.sign(statement.text().as_bytes());
        let Statement { robot, run, segment, previous, digest } = statement;
        [
            ("robot", robot.clone()),
            ("run", run.clone()),
            ("segment", segment.to_string()),
            ("previous", previous.clone()),
            ("digest", digest.clone()),
            ("signature", HEXLOWER.encode(&signature.to_bytes())),
        ]
        .map(|(name, text)| (name.to_owned(), text))
        .into()
    }
}

impl std::fmt::Debug for RobotKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Without the secret half, which must not get into a log.
        write!(f, "RobotKey({})", self.public())
    }
}

/// What a robot states of a segment by signing it. The texts are those of the [metadata record](self).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Statement {
    pub robot: String,
    pub run: String,
    pub segment: u32,
    pub previous: String,
    pub digest: String,
}

impl Statement {
    /// The text that is signed.
    #[must_use]
    pub fn text(&self) -> String {
        let Self { robot, run, segment, previous, digest } = self;
        format!(
            "embodied-depth segment 1\nrobot {robot}\nrun {run}\nsegment {segment}\nprevious {previous}\ndigest {digest}\n"
        )
    }

    /// The statement of a metadata record, if its signature is right.
    pub(crate) fn checked(entries: &BTreeMap<&str, &str>) -> Option<Self> {
        if entries.len() != ENTRIES {
            return None;
        }
        let statement = Self {
            robot: text_of(entries, "robot")?,
            run: text_of(entries, "run")?,
            segment: text_of(entries, "segment")?.parse().ok()?,
            previous: text_of(entries, "previous")?,
            digest: text_of(entries, "digest")?,
        };
        let robot = VerifyingKey::from_bytes(&bytes(&statement.robot)?).ok()?;
        let signature = Signature::from_bytes(&bytes(entries.get("signature")?)?);
        robot.verify_strict(statement.text().as_bytes(), &signature).ok()?;
        Some(statement)
    }
}

fn text_of(entries: &BTreeMap<&str, &str>, name: &str) -> Option<String> {
    entries.get(name).map(|text| (*text).to_owned())
}
