//! One chunk of a segment, checked before anything of it is handed out.

use std::io;

use mcap::records::{Channel, MessageHeader, Record, SchemaHeader, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};

use crate::bytes::Bytes;
use crate::records::{Fields, RecordAt};

/// No chunk that we write comes near this; a broken length must not take the computer's memory.
pub(crate) const MAX_CHUNK: u64 = 64 << 20;

/// What one record of a chunk is. Others are passed over.
pub(crate) enum Item<'a> {
    Schema(SchemaHeader, &'a [u8]),
    Channel(Channel),
    Message(MessageHeader, &'a [u8]),
}

/// Reads a record with its head into `buffer`.
///
/// # Errors
/// The outer when the disk fails, the inner with what is wrong with the record.
pub(crate) fn load<B: Bytes + ?Sized>(
    file: &B,
    record: RecordAt,
    buffer: &mut Vec<u8>,
) -> io::Result<Result<(), String>> {
    if record.body > MAX_CHUNK {
        return Ok(Err(format!("a record of {} bytes where {MAX_CHUNK} are the limit", record.body)));
    }
    buffer.resize(usize::try_from(record.end() - record.start).unwrap_or(0), 0);
    file.read_exact_at(record.start, buffer)?;
    Ok(Ok(()))
}

/// Goes through the records of the chunk in `bytes`, a chunk record with its head. Nothing is handed out of a chunk whose
/// CRC is wrong.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn each_item(
    bytes: &[u8],
    mut each: impl FnMut(Item<'_>) -> Result<(), McapError>,
) -> Result<(), McapError> {
    refuse_giants(bytes)?;
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(4 * MAX_CHUNK as usize);
    let (mut reader, mut rest) = (LinearReader::new_with_options(options), bytes);
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(need) => {
                let (now, later) = rest.split_at(need.min(rest.len()));
                let room = reader.insert(now.len());
                room.get_mut(..now.len()).unwrap_or_default().copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            // Only kinds that a chunk may hold: the parser of attachments panics on broken ones.
            LinearReadEvent::Record { opcode: opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE), data } => {
                match parse_record(opcode, data)? {
                    Record::Schema { header, data } => each(Item::Schema(header, &data))?,
                    Record::Channel(channel) => each(Item::Channel(channel))?,
                    Record::Message { header, data } => each(Item::Message(header, &data))?,
                    _ => {}
                }
            }
            LinearReadEvent::Record { .. } => {}
        }
    }
    Ok(())
}

/// A chunk says itself how large it becomes.
fn refuse_giants(bytes: &[u8]) -> Result<(), McapError> {
    let mut fields = Fields(bytes);
    let size = fields.take(9 + 16).and_then(|_| fields.u64()).ok_or(McapError::UnexpectedEoc)?;
    if size > 4 * MAX_CHUNK {
        return Err(McapError::ChunkTooLarge(size));
    }
    Ok(())
}
