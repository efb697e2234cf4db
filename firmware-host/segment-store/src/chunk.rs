//! Reading of one chunk of a segment. A chunk is verified as a whole before any of its records is used.

use std::io;

use mcap::records::{Channel, MessageHeader, Record, SchemaHeader, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};

use crate::bytes::Bytes;
use crate::fields::Fields;
use crate::records::RecordAt;

/// Largest record that is read. The recorder's chunks are far smaller; a corrupt length must not exhaust the memory.
pub(crate) const MAX_CHUNK: u64 = 64 << 20;

/// A record of a chunk. Records of other kinds are skipped.
pub(crate) enum Item<'a> {
    Schema(SchemaHeader, &'a [u8]),
    Channel(Channel),
    Message(MessageHeader, &'a [u8]),
}

/// Reads a record, including its opcode and length, into `buffer`.
///
/// # Errors
/// The outer error when the file cannot be read, the inner error when the record is too large.
pub(crate) fn load<B: Bytes + ?Sized>(
    file: &B,
    record: RecordAt,
    buffer: &mut Vec<u8>,
) -> io::Result<Result<(), String>> {
    if record.body > MAX_CHUNK {
        return Ok(Err(format!(
            "a record of {} bytes, more than the limit of {MAX_CHUNK}",
            record.body
        )));
    }
    buffer.resize(usize::try_from(record.end() - record.start).unwrap_or(0), 0);
    file.read_exact_at(record.start, buffer)?;
    // The same bytes, unless the position of the record comes from the index and its head in the file is damaged.
    if let Some((opcode, rest)) = buffer.split_first_mut() {
        *opcode = record.opcode;
        if let Some(length) = rest.first_chunk_mut() {
            *length = record.body.to_le_bytes();
        }
    }
    Ok(Ok(()))
}

/// Calls `each` for the records of a chunk. `bytes` is the chunk record including its opcode and length. When the CRC of the
/// chunk is wrong, `each` is never called.
///
/// # Errors
/// When the chunk is corrupt, or the error of `each`.
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
    let mut reader = LinearReader::new_with_options(options);
    let mut rest = bytes;
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(need) => {
                let (now, later) = rest.split_at(need.min(rest.len()));
                let buffer = reader.insert(now.len());
                buffer.get_mut(..now.len()).unwrap_or_default().copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            // Only the kinds that a chunk may contain: the parser of attachments panics on broken ones.
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

/// Refuses chunks that mcap 0.26 does not reject itself: those that announce too large an uncompressed size, and uncompressed
/// ones with a record that reaches beyond the chunk's end, for which it subtracts one length from the other and underflows.
fn refuse_impossible(chunk: &[u8]) -> Result<(), McapError> {
    let mut fields = Fields(chunk);
    // Skips the opcode and length, and the first and last time.
    let size = fields.take(9 + 16).and_then(|_| fields.u64()).ok_or(McapError::UnexpectedEoc)?;
    if size > 4 * MAX_CHUNK {
        return Err(McapError::ChunkTooLarge(size));
    }
    let _crc = fields.u32().ok_or(McapError::UnexpectedEoc)?;
    let compression = fields.text().ok_or(McapError::UnexpectedEoc)?;
    let length = fields.u64().ok_or(McapError::UnexpectedEoc)?;
    let records = usize::try_from(length)
        .ok()
        .and_then(|length| fields.take(length))
        .ok_or(McapError::UnexpectedEoc)?;
    if compression.is_empty() { refuse_truncated(records) } else { Ok(()) }
}

/// Refuses an uncompressed chunk in which a record does not end within the chunk.
fn refuse_truncated(records: &[u8]) -> Result<(), McapError> {
    let mut rest = Fields(records);
    while !rest.0.is_empty() {
        let _opcode = rest.u8();
        let length = rest.u64().and_then(|length| usize::try_from(length).ok());
        length.and_then(|length| rest.take(length)).ok_or(McapError::UnexpectedEoc)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chunk with one message whose header announces `length` bytes of records.
    fn chunk(length: u64) -> Vec<u8> {
        let message = [&[op::MESSAGE][..], &22_u64.to_le_bytes(), &[0; 22]].concat();
        let body = [&[0; 16][..], &31_u64.to_le_bytes(), &[0; 8], &length.to_le_bytes(), &message]
            .concat();
        [&[op::CHUNK][..], &(body.len() as u64).to_le_bytes(), &body].concat()
    }

    #[test]
    fn a_record_that_reaches_beyond_the_end_of_its_chunk_is_refused() {
        assert!(matches!(count_items(&chunk(31)), Ok(1)));
        for length in [1, 8, 9, 30, 32, u64::MAX] {
            assert!(count_items(&chunk(length)).is_err(), "{length}");
        }
    }

    fn count_items(chunk: &[u8]) -> Result<u32, McapError> {
        let mut items = 0;
        each_item(chunk, |_| {
            items += 1;
            Ok(())
        })?;
        Ok(items)
    }
}
