//! The structure of an MCAP file: its sequence of records, its footer and its summary section. It is parsed here because the
//! reader of the crate `mcap` 0.26 reads all data and panics on some broken records (attachments).

use std::io;

use mcap::MAGIC;
use mcap::records::op;

use crate::bytes::Bytes;
use crate::fields::Fields;

/// The size of a record's opcode and length.
pub(crate) const RECORD_HEAD: u64 = 9;
/// The size of the magic at both ends of a file.
pub(crate) const MAGIC_LEN: u64 = MAGIC.len() as u64;
/// The size of the footer record and the closing magic.
const TAIL: u64 = RECORD_HEAD + 20 + MAGIC_LEN;
/// Largest summary section that is read; those of our recorder have 20 KB.
const MAX_SUMMARY: u64 = 16 << 20;

/// The position of a record in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RecordAt {
    pub opcode: u8,
    /// The offset of the opcode.
    pub start: u64,
    /// The number of bytes after opcode and length.
    pub body: u64,
}

impl RecordAt {
    pub(crate) fn body_start(self) -> u64 {
        self.start + RECORD_HEAD
    }

    pub(crate) fn end(self) -> u64 {
        self.body_start() + self.body
    }
}

/// The record that begins at `at`, or `None` when it does not end before `end`.
pub(crate) fn record_at<B: Bytes + ?Sized>(
    file: &B,
    at: u64,
    end: u64,
) -> io::Result<Option<RecordAt>> {
    if at.checked_add(RECORD_HEAD).is_none_or(|body| body > end) {
        return Ok(None);
    }
    let mut head = [0; RECORD_HEAD as usize];
    file.read_exact_at(at, &mut head)?;
    let mut fields = Fields(&head);
    let (Some(opcode), Some(body)) = (fields.u8(), fields.u64()) else { return Ok(None) };
    let inside = (at + RECORD_HEAD).checked_add(body).is_some_and(|stop| stop <= end);
    Ok(inside.then_some(RecordAt { opcode, start: at, body }))
}

/// Whether the file begins with the MCAP magic.
pub(crate) fn has_magic<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<bool> {
    let mut magic = [0; MAGIC.len()];
    if length < MAGIC_LEN {
        return Ok(false);
    }
    file.read_exact_at(0, &mut magic)?;
    Ok(magic == *MAGIC)
}

/// The footer of a closed file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Footer {
    /// The offset of the summary section; 0 when there is none.
    pub summary_start: u64,
    /// The offset of the footer record.
    pub start: u64,
    /// The CRC-32 of the summary section and of the footer up to this field; 0 when it was not computed.
    pub summary_crc: u32,
}

/// Reads the footer; `None` when the file does not end with one.
pub(crate) fn footer<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<Option<Footer>> {
    let Some(start) = length.checked_sub(TAIL).filter(|start| *start >= MAGIC_LEN) else {
        return Ok(None);
    };
    let mut tail = [0; TAIL as usize];
    file.read_exact_at(start, &mut tail)?;
    let mut fields = Fields(&tail);
    let is_footer =
        fields.u8() == Some(op::FOOTER) && fields.u64() == Some(20) && tail.ends_with(MAGIC);
    let (Some(summary_start), Some(_), Some(summary_crc)) =
        (fields.u64(), fields.u64(), fields.u32())
    else {
        return Ok(None);
    };
    let possible = summary_start == 0 || (MAGIC_LEN..=start).contains(&summary_start);
    Ok((is_footer && possible).then_some(Footer { summary_start, start, summary_crc }))
}

/// The bytes of the summary section; `None` when the file has none, or its checksum is missing or wrong.
pub(crate) fn checked_summary_bytes<B: Bytes + ?Sized>(
    file: &B,
    length: u64,
) -> io::Result<Option<Vec<u8>>> {
    let Some(footer) = footer(file, length)? else { return Ok(None) };
    let section = footer.start.saturating_sub(footer.summary_start);
    if footer.summary_start == 0 || footer.summary_crc == 0 || section > MAX_SUMMARY {
        return Ok(None);
    }
    // The checksum covers the footer up to its last field as well: its opcode, its length and two offsets.
    let mut bytes = vec![0; usize::try_from(section + RECORD_HEAD + 16).unwrap_or(0)];
    file.read_exact_at(footer.summary_start, &mut bytes)?;
    let is_right = crc32fast::hash(&bytes) == footer.summary_crc;
    bytes.truncate(usize::try_from(section).unwrap_or(0));
    Ok(is_right.then_some(bytes))
}

/// The statistics of a segment, from its summary section.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Summary {
    pub first_ns: u64,
    pub last_ns: u64,
    /// The number of messages of each topic.
    messages: Vec<(String, u64)>,
}

impl Summary {
    pub(crate) fn messages_on(&self, topic: &str) -> u64 {
        self.messages.iter().filter(|(name, _)| name == topic).map(|(_, count)| count).sum()
    }
}

/// Reads the summary section; `None` when it is missing or malformed.
pub(crate) fn summary<B: Bytes + ?Sized>(file: &B, footer: &Footer) -> io::Result<Option<Summary>> {
    let length = footer.start.saturating_sub(footer.summary_start);
    if footer.summary_start == 0 || length > MAX_SUMMARY {
        return Ok(None);
    }
    let mut bytes = vec![0; usize::try_from(length).unwrap_or(0)];
    file.read_exact_at(footer.summary_start, &mut bytes)?;
    Ok(parse_summary(&bytes))
}

fn parse_summary(bytes: &[u8]) -> Option<Summary> {
    let mut topics = Vec::new();
    let mut statistics = None;
    let mut records = Fields(bytes);
    while let Some(opcode) = records.u8() {
        let length = records.u64()?;
        let mut body = Fields(records.take(usize::try_from(length).ok()?)?);
        match opcode {
            op::CHANNEL => {
                let id = body.u16()?;
                let _schema = body.u16()?;
                let topic = body.text()?;
                topics.push((id, topic.to_owned()));
            }
            op::STATISTICS => statistics = Some(parse_statistics(&mut body)?),
            _ => {}
        }
    }
    let (mut summary, counts) = statistics?;
    for (id, topic) in topics {
        let count =
            counts.iter().find(|(channel, _)| *channel == id).map_or(0, |(_, count)| *count);
        summary.messages.push((topic, count));
    }
    Some(summary)
}

/// Parses the statistics record (MCAP specification, "Statistics") into a summary without topics and the message counts by
/// channel.
fn parse_statistics(body: &mut Fields<'_>) -> Option<(Summary, Vec<(u16, u64)>)> {
    let _messages = body.u64()?;
    let _schemas = body.u16()?;
    let _channels = body.u32()?;
    let _attachments = body.u32()?;
    let _metadata = body.u32()?;
    let _chunks = body.u32()?;
    let first_ns = body.u64()?;
    let last_ns = body.u64()?;
    let length = body.u32()?;
    let mut map = Fields(body.take(length as usize)?);
    let mut counts = Vec::new();
    while let Some(channel) = map.u16() {
        counts.push((channel, map.u64()?));
    }
    Some((Summary { first_ns, last_ns, messages: Vec::new() }, counts))
}
