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
//! The index behind the data is not signed, because a reader can do without it: whoever trusts a signature reads the file in
//! order. No chunk or message may follow the signature, so that nothing can be appended. A segment that was cut by a power
//! failure, or was recovered, has no signature.

use std::collections::BTreeMap;
use std::io;

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use mcap::records::op;
use sha2::{Digest as _, Sha256};

use crate::bytes::Bytes;
use crate::digest::PIECE;
use crate::fields::Fields;
use crate::hex::{hex, unhex};
use crate::records::{self, MAGIC_LEN, RecordAt};

/// Name of the metadata record.
pub const SIGNATURE: &str = "signature";
/// Largest metadata record that is read. Ours has 500 bytes.
const MAX_METADATA: u64 = 64 << 10;

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
        unhex(text).map(|seed| Self::new(&seed))
    }

    /// The secret half, 64 hexadecimal digits.
    #[must_use]
    pub fn secret(&self) -> String {
        hex(&self.0.to_bytes())
    }

    /// The public half, 64 hexadecimal digits: the robot's identity.
    #[must_use]
    pub fn public(&self) -> String {
        hex(self.0.verifying_key().as_bytes())
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
            ("signature", hex(&signature.to_bytes())),
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
    fn checked(entries: &BTreeMap<&str, &str>) -> Option<Self> {
        let get = |name| entries.get(name).map(|text: &&str| (*text).to_owned());
        let statement = Self {
            robot: get("robot")?,
            run: get("run")?,
            segment: get("segment")?.parse().ok()?,
            previous: get("previous")?,
            digest: get("digest")?,
        };
        let robot = VerifyingKey::from_bytes(&unhex(&statement.robot)?).ok()?;
        let signature = Signature::from_bytes(&unhex(entries.get("signature")?)?);
        robot.verify_strict(statement.text().as_bytes(), &signature).ok()?;
        Some(statement)
    }
}

/// What is known of a segment's signature.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Signed {
    /// There is none.
    No,
    /// The robot of this key recorded the segment, and its data are as they were.
    By(Statement),
    /// There is one, and it does not hold; the text says why.
    Wrong(&'static str),
}

/// Reads a whole segment and checks its signature. Memory is bounded.
///
/// # Errors
/// When the file cannot be read.
pub fn check_signature<B: Bytes + ?Sized>(file: &B) -> io::Result<Signed> {
    let length = file.length()?;
    let mut sha256 = Sha256::new();
    let mut at = 0;
    hash(file, &mut at, MAGIC_LEN.min(length), &mut sha256)?;
    while let Some(record) = records::record_at(file, at, length)? {
        if record.opcode == op::DATA_END {
            return Ok(Signed::No);
        }
        if record.opcode == op::METADATA && record.body <= MAX_METADATA {
            let mut body = vec![0; usize::try_from(record.body).unwrap_or(0)];
            file.read_exact_at(record.body_start(), &mut body)?;
            if let Some((SIGNATURE, entries)) = metadata(&body) {
                let digest = hex(&sha256.finalize());
                return Ok(match Statement::checked(&entries) {
                    None => Signed::Wrong("the signature is not that of its text"),
                    Some(statement) if statement.digest != digest => {
                        Signed::Wrong("the data were changed since they were signed")
                    }
                    Some(statement) => {
                        follows(file, record, length)?.unwrap_or(Signed::By(statement))
                    }
                });
            }
        }
        hash(file, &mut at, record.end(), &mut sha256)?;
    }
    Ok(Signed::No)
}

/// Adds the bytes from `at` to `end`.
fn hash<B: Bytes + ?Sized>(
    file: &B,
    at: &mut u64,
    end: u64,
    sha256: &mut Sha256,
) -> io::Result<()> {
    let mut buffer = vec![0; PIECE];
    while *at < end {
        let piece = usize::try_from(end - *at).unwrap_or(PIECE).min(PIECE);
        let piece = buffer.get_mut(..piece).unwrap_or_default();
        file.read_exact_at(*at, piece)?;
        sha256.update(&*piece);
        *at += piece.len() as u64;
    }
    Ok(())
}

/// Refuses data behind the signature: only the end of the data and the index may follow.
fn follows<B: Bytes + ?Sized>(
    file: &B,
    signature: RecordAt,
    length: u64,
) -> io::Result<Option<Signed>> {
    let mut at = signature.end();
    let mut ended = false;
    while let Some(record) = records::record_at(file, at, length)? {
        let is_index = matches!(
            record.opcode,
            op::SCHEMA
                | op::CHANNEL
                | op::STATISTICS
                | op::CHUNK_INDEX
                | op::METADATA_INDEX
                | op::ATTACHMENT_INDEX
                | op::SUMMARY_OFFSET
                | op::FOOTER
        );
        if !(record.opcode == op::DATA_END && !ended || is_index && ended) {
            return Ok(Some(Signed::Wrong("there are data behind the signature")));
        }
        ended = true;
        at = record.end();
        if record.opcode == op::FOOTER {
            break;
        }
    }
    // A reader that meets the end of a cut index has read all data already.
    Ok(None)
}

/// Name and entries of a metadata record (MCAP specification, "Metadata").
fn metadata(body: &[u8]) -> Option<(&str, BTreeMap<&str, &str>)> {
    let mut fields = Fields(body);
    let name = fields.text()?;
    let bytes = fields.u32()? as usize;
    let mut pairs = Fields(fields.take(bytes)?);
    let mut entries = BTreeMap::new();
    while !pairs.0.is_empty() {
        entries.insert(pairs.text()?, pairs.text()?);
    }
    // A record with a wrong length would hide the beginning of what follows it.
    fields.0.is_empty().then_some((name, entries))
}
