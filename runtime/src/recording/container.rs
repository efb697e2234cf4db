//! Messages of an MCAP stream. `mcap::io::MessageReader` would do, but mcap 0.26 panics on a corrupt attachment record
//! (`parse_record` slices before it checks), and a flipped bit makes any record one. Here only the two kinds of records
//! that we need are parsed.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read};

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};

/// No chunk or record that we write comes near this; a corrupt length must not take the computer's memory.
const MAX_RECORD_BYTES: usize = 256 << 20;

/// The messages of a stream in the order in which they were written, each checked before it is handed out.
pub(super) struct Messages<R> {
    source: R,
    reader: LinearReader,
    /// Topics by channel.
    topics: BTreeMap<u16, String>,
}

/// One message.
pub(super) struct Message {
    pub topic: String,
    pub data: Vec<u8>,
}

impl<R: Read> Messages<R> {
    pub(super) fn new(source: R) -> Self {
        let options = LinearReaderOptions::default()
            // A message of a corrupt chunk must not be seen before the chunk's CRC.
            .with_prevalidate_chunk_crcs(true)
            // A chunk whose opcode is corrupt would be skipped as a record of an unknown kind.
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        Self { source, reader: LinearReader::new_with_options(options), topics: BTreeMap::new() }
    }

    /// The next message; `None` after the stream's proper end.
    pub(super) fn next(&mut self) -> Result<Option<Message>, McapError> {
        while let Some(event) = self.reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(need) => {
                    let read = match self.source.read(self.reader.insert(need)) {
                        Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                        read => read?,
                    };
                    self.reader.notify_read(read);
                }
                LinearReadEvent::Record { opcode: opcode @ (op::CHANNEL | op::MESSAGE), data } => {
                    match parse_record(opcode, data)? {
                        Record::Channel(channel) => {
                            self.topics.insert(channel.id, channel.topic);
                        }
                        Record::Message { header, data } => {
                            let topic = self.topics.get(&header.channel_id).cloned();
                            let unknown = McapError::UnknownChannel(header.sequence, header.channel_id);
                            return Ok(Some(Message { topic: topic.ok_or(unknown)?, data: data.into_owned() }));
                        }
                        _ => {}
                    }
                }
                LinearReadEvent::Record { .. } => {}
            }
        }
        Ok(None)
    }
}
