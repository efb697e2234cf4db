//! Checks who recorded a segment: reads it whole, in bounded memory. The trainer has the same check in Python
//! (`store/signature.py`); both are tested on a segment that the robot's program signed.

use std::collections::BTreeMap;
use std::io;

use data_encoding::HEXLOWER;
use mcap::records::op;
use sha2::{Digest as _, Sha256};

use crate::bytes::Bytes;
use crate::digest::PIECE;
use crate::fields::Fields;
use crate::records::{self, MAGIC_LEN, RecordAt};
use crate::signature::{SIGNATURE, Statement};

/// Largest record that is read at the end of a segment. The robot's have 2 KB at most.
const MAX_RECORD: u64 = 1 << 20;

const NOT_ITS_TEXT: &str = "the signature is not that of its text";
const CHANGED: &str = "the data were changed since they were signed";
const BEHIND: &str = "there are data behind the signature";

/// What is known of a segment's signature.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Signed {
    /// There is none, or the file is cut.
    No,
    /// The robot of this key recorded the segment, and its data are as they were.
    By(Statement),
    /// There is one, and it does not hold; the text says why.
    Wrong(&'static str),
}

/// Reads a whole segment and checks its signature.
///
/// # Errors
/// When the file cannot be read.
pub fn check_signature<B: Bytes + ?Sized>(file: &B) -> io::Result<Signed> {
    let length = file.length()?;
    let mut data = Sha256::new();
    let mut at = 0;
    hash(file, &mut at, MAGIC_LEN.min(length), &mut data)?;
    while let Some(record) = records::record_at(file, at, length)? {
        if matches!(record.opcode, op::DATA_END | op::FOOTER) {
            return Ok(Signed::No);
        }
        if record.opcode == op::METADATA
            && record.body <= MAX_RECORD
            && let Some((SIGNATURE, entries)) = metadata(&body(file, record)?)
        {
            let digest = HEXLOWER.encode(&data.finalize());
            return judge(file, record, Statement::checked(&entries), &digest);
        }
        hash(file, &mut at, record.end(), &mut data)?;
    }
    Ok(Signed::No)
}

/// What is known of a segment with this signature record and this digest of the data before it.
fn judge<B: Bytes + ?Sized>(
    file: &B,
    record: RecordAt,
    statement: Option<Statement>,
    digest: &str,
) -> io::Result<Signed> {
    let Some(statement) = statement else { return Ok(Signed::Wrong(NOT_ITS_TEXT)) };
    if statement.digest != digest {
        return Ok(Signed::Wrong(CHANGED));
    }
    Ok(match end(file, record.end())? {
        End::Usual => Signed::By(statement),
        End::Cut => Signed::No,
        End::Other => Signed::Wrong(BEHIND),
    })
}

/// Adds the bytes from `at` to `end`.
fn hash<B: Bytes + ?Sized>(file: &B, at: &mut u64, end: u64, data: &mut Sha256) -> io::Result<()> {
    let mut buffer = vec![0; PIECE];
    while *at < end {
        let piece = usize::try_from(end - *at).unwrap_or(PIECE).min(PIECE);
        let piece = buffer.get_mut(..piece).unwrap_or_default();
        file.read_exact_at(*at, piece)?;
        data.update(&*piece);
        *at += piece.len() as u64;
    }
    Ok(())
}

fn body<B: Bytes + ?Sized>(file: &B, record: RecordAt) -> io::Result<Vec<u8>> {
    let mut body = vec![0; usize::try_from(record.body).unwrap_or(0)];
    file.read_exact_at(record.body_start(), &mut body)?;
    Ok(body)
}

/// What follows the signature.
enum End {
    /// The end of the data, the index and the footer.
    Usual,
    /// The file ends too early.
    Cut,
    /// Something that a reader might read as data.
    Other,
}

fn end<B: Bytes + ?Sized>(file: &B, mut at: u64) -> io::Result<End> {
    let length = file.length()?;
    let mut is_first = true;
    loop {
        let Some(record) = records::record_at(file, at, length)? else { return Ok(End::Cut) };
        let is_in_order = (record.opcode == op::DATA_END) == is_first;
        if !is_in_order
            || record.body > MAX_RECORD
            || !is_of_index(record.opcode, &body(file, record)?)
        {
            return Ok(End::Other);
        }
        at = record.end();
        is_first = false;
        if record.opcode == op::FOOTER {
            return Ok(if at + MAGIC_LEN == length { End::Usual } else { End::Other });
        }
    }
}

/// Whether a record is one of those behind the data, and its fields end where the record does. Python's reader goes by the
/// lengths of the fields and not by that of the record: fields with false lengths would lead it to a message that is hidden
/// in a later record (MCAP specification, "Records").
fn is_of_index(opcode: u8, body: &[u8]) -> bool {
    let mut fields = Fields(body);
    let known = match opcode {
        op::DATA_END => fields.take(4).map(drop),
        op::FOOTER => fields.take(8 + 8 + 4).map(drop),
        op::SCHEMA => schema(&mut fields),
        op::CHANNEL => channel(&mut fields),
        op::STATISTICS => statistics(&mut fields),
        op::CHUNK_INDEX => chunk_index(&mut fields),
        op::METADATA_INDEX => fields.take(8 + 8).and_then(|_| fields.text()).map(drop),
        op::SUMMARY_OFFSET => fields.take(1 + 8 + 8).map(drop),
        _ => None,
    };
    known.is_some() && fields.0.is_empty()
}

fn schema(fields: &mut Fields<'_>) -> Option<()> {
    fields.u16()?;
    fields.text()?;
    fields.text()?;
    counted(fields).map(drop)
}

fn channel(fields: &mut Fields<'_>) -> Option<()> {
    fields.take(2 + 2)?;
    fields.text()?;
    fields.text()?;
    entries(fields).map(drop)
}

fn statistics(fields: &mut Fields<'_>) -> Option<()> {
    fields.take(8 + 2 + 4 * 4 + 8 + 8)?;
    numbers_by_channel(fields)
}

fn chunk_index(fields: &mut Fields<'_>) -> Option<()> {
    fields.take(4 * 8)?;
    numbers_by_channel(fields)?;
    fields.u64()?;
    fields.text()?;
    fields.take(8 + 8).map(drop)
}

/// A map from channels (`u16`) to numbers (`u64`).
fn numbers_by_channel(fields: &mut Fields<'_>) -> Option<()> {
    counted(fields)?.len().is_multiple_of(2 + 8).then_some(())
}

/// Bytes that follow their number as a `u32`.
fn counted<'a>(fields: &mut Fields<'a>) -> Option<&'a [u8]> {
    let count = fields.u32()?;
    fields.take(count as usize)
}

/// A map of texts in which no name is twice.
fn entries<'a>(fields: &mut Fields<'a>) -> Option<BTreeMap<&'a str, &'a str>> {
    let mut pairs = Fields(counted(fields)?);
    let mut entries = BTreeMap::new();
    while !pairs.0.is_empty() {
        let is_new = entries.insert(pairs.text()?, pairs.text()?).is_none();
        is_new.then_some(())?;
    }
    Some(entries)
}

/// Name and entries of a metadata record. `None` if it has a wrong length, which would hide the beginning of what follows it.
fn metadata(body: &[u8]) -> Option<(&str, BTreeMap<&str, &str>)> {
    let mut fields = Fields(body);
    let name = fields.text()?;
    let entries = entries(&mut fields)?;
    fields.0.is_empty().then_some((name, entries))
}
