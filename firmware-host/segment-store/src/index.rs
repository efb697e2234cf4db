//! The parts of a summary section that recovery uses: its copies of schemas and channels, and the offsets of the chunks.
//!
//! A segment defines each schema and channel once in its data, mostly in the second chunk. If that chunk is damaged, the
//! messages of all later chunks can be assigned to their topics by the copies only.

use std::io;

use mcap::parse_record;
use mcap::records::{Channel, Record, SchemaHeader, op};

use crate::bytes::Bytes;
use crate::fields::Fields;
use crate::records::{self, RECORD_HEAD, RecordAt};

/// What the summary section says about the data. Empty when the section is missing or damaged.
#[derive(Debug, Default)]
pub(crate) struct Index {
    pub schemas: Vec<(SchemaHeader, Vec<u8>)>,
    pub channels: Vec<Channel>,
    /// The chunks in the order of their offsets.
    pub chunks: Vec<RecordAt>,
}

impl Index {
    /// Reads the index of a file of `length` bytes. A section with a wrong checksum is ignored.
    pub(crate) fn read<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<Self> {
        let Some(section) = records::checked_summary_bytes(file, length)? else {
            return Ok(Self::default());
        };
        let mut index = parse(&section).unwrap_or_default();
        index.chunks.sort_by_key(|chunk| chunk.start);
        if index.chunks.iter().any(|chunk| chunk.end() > length) {
            index.chunks.clear();
        }
        Ok(index)
    }

    pub(crate) fn channel(&self, id: u16) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.id == id)
    }

    pub(crate) fn schema(&self, id: u16) -> Option<&(SchemaHeader, Vec<u8>)> {
        self.schemas.iter().find(|(header, _)| header.id == id)
    }
}

/// `None` when a record is malformed.
fn parse(section: &[u8]) -> Option<Index> {
    let mut index = Index::default();
    let mut rest = Fields(section);
    while let Some(opcode) = rest.u8() {
        let length = usize::try_from(rest.u64()?).ok()?;
        let body = rest.take(length)?;
        // Only the kinds that are used: the parser of attachments in mcap 0.26 panics on broken ones.
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::CHUNK_INDEX) {
            continue;
        }
        match parse_record(opcode, body).ok()? {
            Record::Schema { header, data } => index.schemas.push((header, data.into_owned())),
            Record::Channel(channel) => index.channels.push(channel),
            Record::ChunkIndex(chunk) => index.chunks.push(RecordAt {
                opcode: op::CHUNK,
                start: chunk.chunk_start_offset,
                body: chunk.chunk_length.checked_sub(RECORD_HEAD)?,
            }),
            _ => {}
        }
    }
    let ends_fit = index.chunks.iter().all(|chunk| {
        chunk.start.checked_add(RECORD_HEAD).and_then(|at| at.checked_add(chunk.body)).is_some()
    });
    ends_fit.then_some(index)
}
