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
        return Ok(Err(format!(
            "a record of {} bytes where {MAX_CHUNK} are the limit",
            record.body
        )));
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
    refuse_impossible(bytes)?;
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
            LinearReadEvent::Record {
                opcode: opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE),
                data,
            } => match parse_record(opcode, data)? {
                Record::Schema { header, data } => each(Item::Schema(header, &data))?,
                Record::Channel(channel) => each(Item::Channel(channel))?,
                Record::Message { header, data } => each(Item::Message(header, &data))?,
                _ => {}
            },
            LinearReadEvent::Record { .. } => {}
        }
    }
    Ok(())
}

/// A chunk says itself how large it becomes. Of one that is not compressed, mcap 0.26 does not notice that a record reaches beyond
/// its end: it subtracts one length from the other.
fn refuse_impossible(chunk: &[u8]) -> Result<(), McapError> {
    let mut fields = Fields(chunk);
    // Opcode, length, first and last time.
    let size = fields.take(9 + 16).and_then(|_| fields.u64()).ok_or(McapError::UnexpectedEoc)?;
    if size > 4 * MAX_CHUNK {
        return Err(McapError::ChunkTooLarge(size));
    }
    let (Some(_crc), Some(compression), Some(length)) = (fields.u32(), fields.text(), fields.u64())
    else {
        return Err(McapError::UnexpectedEoc);
    };
    let records = usize::try_from(length)
        .ok()
        .and_then(|length| fields.take(length))
        .ok_or(McapError::UnexpectedEoc)?;
    if compression.is_empty() { refuse_torn(records) } else { Ok(()) }
}

/// Every record of a chunk must end within it.
fn refuse_torn(records: &[u8]) -> Result<(), McapError> {
    let mut rest = Fields(records);
    while !rest.0.is_empty() {
        let (_opcode, length) = (rest.u8(), rest.u64());
        let length = length.and_then(|length| usize::try_from(length).ok());
        length.and_then(|length| rest.take(length)).ok_or(McapError::UnexpectedEoc)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chunk of one message that says that its records have `length` bytes.
    fn chunk(length: u64) -> Vec<u8> {
        let message = [&[op::MESSAGE][..], &22_u64.to_le_bytes(), &[0; 22]].concat();
        let body = [&[0; 16][..], &31_u64.to_le_bytes(), &[0; 8], &length.to_le_bytes(), &message]
            .concat();
        [&[op::CHUNK][..], &(body.len() as u64).to_le_bytes(), &body].concat()
    }

    #[test]
    fn a_record_that_reaches_beyond_the_end_of_its_chunk_is_refused() {
        let messages = |length| {
            let mut messages = 0;
            let counted = each_item(&chunk(length), |_| {
                messages += 1;
                Ok(())
            });
            counted.map(|()| messages)
        };
        assert!(matches!(messages(31), Ok(1)));
        for length in [1, 8, 9, 30, 32, u64::MAX] {
            assert!(messages(length).is_err(), "{length}");
        }
    }
}
