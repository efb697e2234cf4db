//! Recovery of a segment that was cut off or damaged.
//!
//! A tick never spans two chunks, and every chunk has a checksum, so all messages of all intact chunks are kept. A chunk that is
//! incomplete or whose checksum is wrong is dropped as a whole, because it is unknown which of its messages are right.
//!
//! The summary section at the end of a closed segment repeats the schemas and channels and lists the offsets of the chunks. With
//! it, the channels that a dropped chunk defined are known, and a damaged length does not hide the chunks behind it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use mcap::records::{Channel, MessageHeader, op};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};

use crate::bytes::Bytes;
use crate::chunk::{self, Item};
use crate::error::StoreError;
use crate::index::Index;
use crate::partial::{create_beside, give_name, refuse_existing};
use crate::records::{self, MAGIC_LEN, RecordAt};

/// What a recovery kept and dropped.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Recovered {
    /// The number of messages that were kept.
    pub messages: u64,
    /// The number of control loop ticks among them.
    pub ticks: u64,
    /// The number of chunks that were kept.
    pub chunks: u64,
    /// The number of complete chunks that were dropped because their checksum or contents are wrong.
    pub bad_chunks: u64,
    /// The number of messages in kept chunks that were dropped because nothing defines their channel: neither a kept chunk nor
    /// the summary section.
    pub unknown_messages: u64,
    /// The number of segments that end early.
    pub cut: u64,
    /// The time of the last message, on the run's clock.
    pub last_ns: Option<u64>,
}

/// What writes a new file.
pub(crate) type Output<W> = Writer<NoSeek<W>>;

/// Writes the intact chunks of one or more segments into one new MCAP file.
pub(crate) struct Rewriter<W: Write> {
    mcap: Output<W>,
    done: Recovered,
}

/// A message of a segment. The channel of its header is that of the new file.
pub(crate) struct Recorded<'a> {
    pub topic: &'a str,
    pub header: MessageHeader,
    pub data: &'a [u8],
}

/// Writes what becomes of a message.
pub(crate) type Edit<'a, W> = dyn FnMut(&mut Output<W>, Recorded<'_>) -> Result<(), McapError> + 'a;

/// The schemas and channels of one segment. Their ids differ between the two files; the maps translate them.
struct Definitions {
    schemas: BTreeMap<u16, u16>,
    /// The id of a channel in the new file, and its topic.
    channels: BTreeMap<u16, (u16, String)>,
}

impl<W: Write> Rewriter<W> {
    pub(crate) fn begin(sink: W) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .library(concat!("embodied-depth ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            // Chunks are ended explicitly, where those of the original end.
            .chunk_size(None)
            .disable_seeking(true);
        Ok(Self { mcap: options.create(NoSeek::new(sink))?, done: Recovered::default() })
    }

    /// Adds all messages of all intact chunks of a segment.
    pub(crate) fn add<B: Bytes + ?Sized>(&mut self, file: &B) -> Result<(), McapError> {
        self.add_edited(file, &mut |out, message| {
            out.write_to_known_channel(&message.header, message.data)
        })
    }

    /// Passes all messages of all intact chunks of a segment to `edit`, which writes what becomes of them.
    pub(crate) fn add_edited<B: Bytes + ?Sized>(
        &mut self,
        file: &B,
        edit: &mut Edit<'_, W>,
    ) -> Result<(), McapError> {
        let mut definitions =
            Definitions { schemas: BTreeMap::from([(0, 0)]), channels: BTreeMap::new() };
        let damage = each_intact_chunk(file, |chunk, index| {
            chunk::each_item(chunk, |item| self.add_item(item, &mut definitions, index, edit))?;
            self.done.chunks += 1;
            self.mcap.flush()
        })?;
        self.done.bad_chunks += damage.bad_chunks;
        self.done.cut += u64::from(damage.is_cut);
        Ok(())
    }

    fn add_item(
        &mut self,
        item: Item<'_>,
        definitions: &mut Definitions,
        index: &Index,
        edit: &mut Edit<'_, W>,
    ) -> Result<(), McapError> {
        match item {
            Item::Schema(header, data) => {
                let id = self.mcap.add_schema(&header.name, &header.encoding, data)?;
                definitions.schemas.insert(header.id, id);
            }
            Item::Channel(channel) => self.add_channel(&channel, definitions, index)?,
            Item::Message(header, data) => {
                self.add_message(header, data, definitions, index, edit)?;
            }
        }
        Ok(())
    }

    fn add_channel(
        &mut self,
        channel: &Channel,
        definitions: &mut Definitions,
        index: &Index,
    ) -> Result<(), McapError> {
        if !definitions.schemas.contains_key(&channel.schema_id)
            && let Some((header, data)) = index.schema(channel.schema_id)
        {
            let id = self.mcap.add_schema(&header.name, &header.encoding, data)?;
            definitions.schemas.insert(header.id, id);
        }
        // 0, no schema, when the schema was in a chunk that was dropped; the messages keep their topic.
        let schema = definitions.schemas.get(&channel.schema_id).copied().unwrap_or(0);
        let id = self.mcap.add_channel(
            schema,
            &channel.topic,
            &channel.message_encoding,
            &channel.metadata,
        )?;
        definitions.channels.insert(channel.id, (id, channel.topic.clone()));
        Ok(())
    }

    fn add_message(
        &mut self,
        mut header: MessageHeader,
        data: &[u8],
        definitions: &mut Definitions,
        index: &Index,
        edit: &mut Edit<'_, W>,
    ) -> Result<(), McapError> {
        if !definitions.channels.contains_key(&header.channel_id)
            && let Some(channel) = index.channel(header.channel_id)
        {
            self.add_channel(channel, definitions, index)?;
        }
        let Some((id, topic)) = definitions.channels.get(&header.channel_id) else {
            self.done.unknown_messages += 1;
            return Ok(());
        };
        header.channel_id = *id;
        self.done.last_ns = self.done.last_ns.max(Some(header.log_time));
        self.done.messages += 1;
        self.done.ticks += u64::from(topic == "/robot/tick");
        edit(&mut self.mcap, Recorded { topic, header, data })
    }

    pub(crate) fn finish(mut self) -> Result<(W, Recovered), McapError> {
        self.mcap.finish()?;
        Ok((self.mcap.into_inner().into_inner(), self.done))
    }
}

/// What is wrong with a segment.
struct Damage {
    bad_chunks: u64,
    /// The file ends before the end of its data.
    is_cut: bool,
}

/// Calls `each` for every intact chunk of a file, with its bytes and the definitions of the file's summary section, for those
/// that no kept chunk has.
fn each_intact_chunk<B: Bytes + ?Sized>(
    file: &B,
    mut each: impl FnMut(&[u8], &Index) -> Result<(), McapError>,
) -> Result<Damage, McapError> {
    let length = file.length()?;
    let mut index = Index::read(file, length)?;
    let mut chunks = std::mem::take(&mut index.chunks);
    let mut damage = Damage { bad_chunks: 0, is_cut: false };
    if chunks.is_empty() {
        if !records::has_magic(file, length)? {
            damage.is_cut = true;
            return if length < MAGIC_LEN { Ok(damage) } else { Err(McapError::BadMagic) };
        }
        (chunks, damage.is_cut) = chunks_in_sequence(file, length)?;
    }
    let mut buffer = Vec::new();
    for record in chunks {
        // Parsed once without a use, so that an error in the middle does not leave half of the chunk in the output.
        let is_intact = chunk::load(file, record, &mut buffer)?.is_ok()
            && chunk::each_item(&buffer, |_| Ok(())).is_ok();
        if is_intact {
            each(&buffer, &index)?;
        } else {
            damage.bad_chunks += 1;
        }
    }
    Ok(damage)
}

/// The chunks of a file without index, from its sequence of records, and whether that ends early. A damaged length ends it.
fn chunks_in_sequence<B: Bytes + ?Sized>(
    file: &B,
    length: u64,
) -> Result<(Vec<RecordAt>, bool), McapError> {
    let mut chunks = Vec::new();
    let mut at = MAGIC_LEN;
    while let Some(record) = records::record_at(file, at, length)? {
        match record.opcode {
            op::DATA_END => return Ok((chunks, false)),
            op::CHUNK => chunks.push(record),
            _ => {}
        }
        at = record.end();
    }
    Ok((chunks, true))
}

/// Writes all messages of all intact chunks of `file` as a complete MCAP file with an index.
///
/// # Errors
/// When `file` is not an MCAP file, or reading or writing fails.
pub fn recover<B: Bytes + ?Sized, W: Write>(file: &B, sink: W) -> Result<Recovered, McapError> {
    let mut rewriter = Rewriter::begin(sink)?;
    rewriter.add(file)?;
    Ok(rewriter.finish()?.1)
}

/// Recovers the segment `from`, called `shown` in errors, into the new file `to`, which appears only when it is complete.
///
/// # Errors
/// When `to` exists already or cannot be written, or `from` is not an MCAP file or has no intact tick.
pub fn recover_file(from: &File, shown: &Path, to: &Path) -> Result<Recovered, StoreError> {
    write_new(to, |sink| {
        let done = recover(from, sink).map_err(|error| failure(error, shown, to))?;
        if done.ticks == 0 {
            let bytes = from.length().map_err(StoreError::read(shown))?;
            let detail = format!(
                "no tick in it is intact ({bytes} bytes), so nothing was recovered; copy it again, or delete it"
            );
            return Err(StoreError::Segment { path: shown.to_owned(), detail });
        }
        Ok(done)
    })
}

/// Writes a new file: `fill` writes a temporary file, which is renamed when it is complete.
pub(crate) fn write_new<T>(
    to: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    refuse_existing(to)?;
    let (partial, file) =
        create_beside(to, |partial| File::create_new(partial)).map_err(StoreError::output(to))?;
    let mut sink = BufWriter::new(file);
    let filled = fill(&mut sink).and_then(|value| {
        let synced = sink.flush().and_then(|()| sink.get_ref().sync_all());
        synced.map_err(StoreError::output(to))?;
        give_name(&partial, to)?;
        Ok(value)
    });
    if filled.is_err() {
        // The error that is returned is the first one; failing to remove the temporary file adds nothing.
        let _ = std::fs::remove_file(&partial);
    }
    filled
}

/// An I/O error concerns the output, every other error the contents of the input.
pub(crate) fn failure(error: McapError, from: &Path, to: &Path) -> StoreError {
    match error {
        McapError::Io(source) => StoreError::Output { path: to.to_owned(), source },
        other => StoreError::Segment { path: from.to_owned(), detail: other.to_string() },
    }
}
