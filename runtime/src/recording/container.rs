//! Messages of an MCAP stream.
//!
//! `mcap::io::MessageReader` is not used, because mcap 0.26 panics on a corrupt attachment record (`parse_record` slices
//! before it checks), and a flipped bit can turn any record into one. It also accepts a record that ends behind its
//! chunk. This reader parses channel and message records only, and checks every chunk before it parses it.

use std::collections::BTreeMap;
use std::io::{Cursor, ErrorKind, Read};

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};

/// The recorder writes no chunk or record of nearly this size. A corrupt length must not allocate more.
const MAX_RECORD_BYTES: usize = 256 << 20;

/// The messages of a stream in the order in which they were written. The CRC of a message's chunk is checked before the
/// message is returned.
pub(super) struct Messages<R> {
    file: Records<R>,
    /// The rest of the chunk that is being read.
    chunk: Option<Box<Records<Cursor<Vec<u8>>>>>,
    /// Topics by channel.
    topics: Topics,
}

type Topics = BTreeMap<u16, String>;

/// A message of a segment, with its channel's topic.
pub(super) struct Message {
    pub topic: String,
    pub data: Vec<u8>,
}

impl<R: Read> Messages<R> {
    pub(super) fn new(source: R) -> Self {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            // A chunk whose opcode is corrupt would be skipped as a record of an unknown kind.
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true);
        Self { file: Records::new(source, options), chunk: None, topics: Topics::new() }
    }

    /// The next message; `None` after the footer.
    pub(super) fn next(&mut self) -> Result<Option<Message>, McapError> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                let found = chunk.find(|opcode, data| message(opcode, data, &mut self.topics));
                // Only a file can be cut; a chunk that ends early is corrupt.
                let found = found.map_err(|error| match error {
                    McapError::UnexpectedEof => McapError::UnexpectedEoc,
                    other => other,
                })?;
                if found.is_some() {
                    return Ok(found);
                }
            }
            self.chunk = None;
            let found = self.file.find(|opcode, data| match opcode {
                op::CHUNK => {
                    Records::of_chunk(data).map(|chunk| Some(Found::Chunk(Box::new(chunk))))
                }
                _ => message(opcode, data, &mut self.topics)
                    .map(|message| message.map(Found::Message)),
            })?;
            match found {
                Some(Found::Chunk(chunk)) => self.chunk = Some(chunk),
                Some(Found::Message(message)) => return Ok(Some(message)),
                None => return Ok(None),
            }
        }
    }
}

enum Found {
    Chunk(Box<Records<Cursor<Vec<u8>>>>),
    Message(Message),
}

fn message(opcode: u8, data: &[u8], topics: &mut Topics) -> Result<Option<Message>, McapError> {
    if !matches!(opcode, op::CHANNEL | op::MESSAGE) {
        return Ok(None);
    }
    match parse_record(opcode, data)? {
        Record::Channel(channel) => {
            topics.insert(channel.id, channel.topic);
            Ok(None)
        }
        Record::Message { header, data } => {
            let unknown = McapError::UnknownChannel(header.sequence, header.channel_id);
            let topic = topics.get(&header.channel_id).cloned();
            Ok(Some(Message { topic: topic.ok_or(unknown)?, data: data.into_owned() }))
        }
        _ => Ok(None),
    }
}

struct Records<R> {
    source: R,
    reader: LinearReader,
}

impl Records<Cursor<Vec<u8>>> {
    /// The records of a chunk, given without opcode and length. The chunk's CRC is checked before the first record is
    /// returned.
    fn of_chunk(data: &[u8]) -> Result<Self, McapError> {
        refuse_torn(data).ok_or(McapError::UnexpectedEoc)?;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true);
        let record = [&[op::CHUNK][..], &(data.len() as u64).to_le_bytes(), data].concat();
        Ok(Self::new(Cursor::new(record), options))
    }
}

impl<R: Read> Records<R> {
    fn new(source: R, options: LinearReaderOptions) -> Self {
        let options = options.with_record_length_limit(MAX_RECORD_BYTES);
        Self { source, reader: LinearReader::new_with_options(options) }
    }

    /// Passes the opcode and the contents of each record to `select` until it returns something; `None` after the footer.
    fn find<T>(
        &mut self,
        mut select: impl FnMut(u8, &[u8]) -> Result<Option<T>, McapError>,
    ) -> Result<Option<T>, McapError> {
        while let Some(event) = self.reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(need) => {
                    let read = match self.source.read(self.reader.insert(need)) {
                        Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                        read => read?,
                    };
                    self.reader.notify_read(read);
                }
                LinearReadEvent::Record { opcode, data } => {
                    let found = select(opcode, data)?;
                    if found.is_some() {
                        return Ok(found);
                    }
                }
            }
        }
        Ok(None)
    }
}

/// `None` when the records of an uncompressed chunk do not fill it exactly: mcap 0.26 subtracts one length from the
/// other and overflows.
fn refuse_torn(chunk: &[u8]) -> Option<()> {
    // First and last time, size and CRC; then the compression's name and the records, each behind its length.
    let (_, rest) = chunk.split_at_checked(8 + 8 + 8 + 4)?;
    let (length, rest) = rest.split_first_chunk()?;
    let (compression, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    let (mut records, _) = counted(rest)?;
    while compression.is_empty() && !records.is_empty() {
        (_, records) = counted(records.get(1..)?)?;
    }
    Some(())
}

/// Splits off the bytes whose number is in the first eight bytes. Returns them and the rest.
fn counted(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with one chunk of one message. The chunk claims that its records have `length` bytes.
    fn file(length: u64) -> Vec<u8> {
        let channel = [&[0; 4][..], &2_u32.to_le_bytes(), b"/t", &[0; 8]].concat();
        let records = [record(op::CHANNEL, &channel), record(op::MESSAGE, &[0; 22])].concat();
        assert_eq!(records.len(), 58);
        let chunk = [&[0; 16][..], &58_u64.to_le_bytes(), &[0; 8], &length.to_le_bytes(), &records]
            .concat();
        let end = &super::super::END_WITHOUT_SUMMARY;
        [mcap::MAGIC, &record(op::HEADER, &[0; 8]), &record(op::CHUNK, &chunk), end].concat()
    }

    fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
    }

    #[test]
    fn a_record_that_reaches_beyond_the_end_of_its_chunk_is_refused() {
        assert_eq!(messages_of(58).map(|messages| messages.len()).unwrap(), 1);
        for length in [1, 20, 40, 57, 59, u64::MAX] {
            assert!(matches!(messages_of(length), Err(McapError::UnexpectedEoc)), "{length}");
        }
    }

    fn messages_of(length: u64) -> Result<Vec<Message>, McapError> {
        let file = file(length);
        let mut messages = Messages::new(&file[..]);
        std::iter::from_fn(|| messages.next().transpose()).collect()
    }
}
