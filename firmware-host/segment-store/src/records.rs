//! The frame of an MCAP file: records one after the other, and what its end says about them. Read by hand, because the
//! crate's own reader goes through all of the data and panics on some broken records (mcap 0.26, attachments).

use std::io;

use mcap::MAGIC;
use mcap::records::op;

use crate::bytes::Bytes;

/// Opcode and length.
pub(crate) const RECORD_HEAD: u64 = 9;
/// Magic at both ends.
pub(crate) const MAGIC_LEN: u64 = MAGIC.len() as u64;
/// Footer record and closing magic.
const TAIL: u64 = RECORD_HEAD + 20 + MAGIC_LEN;
/// Index of a segment; ours take 20 KB.
const MAX_SUMMARY: u64 = 16 << 20;

/// Where a record is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RecordAt {
    pub opcode: u8,
    /// Of its opcode.
    pub start: u64,
    /// Bytes after opcode and length.
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

/// The record that begins at `at`, if it lies before `end` as a whole.
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

/// Whether the file begins as MCAP files do.
pub(crate) fn has_magic<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<bool> {
    let mut magic = [0; MAGIC.len()];
    if length < MAGIC_LEN {
        return Ok(false);
    }
    file.read_exact_at(0, &mut magic)?;
    Ok(magic == *MAGIC)
}

/// What stands at the end of a closed file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Footer {
    /// Where the index begins; 0 for none.
    pub summary_start: u64,
    /// Where the footer record begins.
    pub start: u64,
    /// CRC-32 of the index up to this field; 0 for none.
    pub summary_crc: u32,
}

/// The footer; `None` for a file that does not end as MCAP files do.
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

/// What the index says about a whole segment.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Summary {
    pub first_ns: u64,
    pub last_ns: u64,
    /// Messages by topic.
    messages: Vec<(String, u64)>,
}

impl Summary {
    pub(crate) fn messages_on(&self, topic: &str) -> u64 {
        self.messages.iter().filter(|(name, _)| name == topic).map(|(_, count)| count).sum()
    }
}

/// Reads the index; `None` where there is none that makes sense.
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
    let (mut topics, mut statistics) = (Vec::new(), None);
    let mut records = Fields(bytes);
    while let Some(opcode) = records.u8() {
        let length = records.u64()?;
        let mut body = Fields(records.take(usize::try_from(length).ok()?)?);
        match opcode {
            op::CHANNEL => {
                let (id, _schema, topic) = (body.u16()?, body.u16()?, body.text()?);
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

/// MCAP specification, "Statistics".
fn parse_statistics(body: &mut Fields<'_>) -> Option<(Summary, Vec<(u16, u64)>)> {
    let (_messages, _schemas) = (body.u64()?, body.u16()?);
    let (_channels, _attachments, _metadata, _chunks) =
        (body.u32()?, body.u32()?, body.u32()?, body.u32()?);
    let (first_ns, last_ns) = (body.u64()?, body.u64()?);
    let length = body.u32()?;
    let mut map = Fields(body.take(length as usize)?);
    let mut counts = Vec::new();
    while let Some(channel) = map.u16() {
        counts.push((channel, map.u64()?));
    }
    Some((Summary { first_ns, last_ns, messages: Vec::new() }, counts))
}

/// Little-endian numbers from the front of some bytes; `None` when they are used up.
pub(crate) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    pub(crate) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Text behind its length in four bytes, as MCAP has it.
    pub(crate) fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()?;
        std::str::from_utf8(self.take(length as usize)?).ok()
    }
}
