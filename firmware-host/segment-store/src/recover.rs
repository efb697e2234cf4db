//! Makes a whole segment of a cut one.
//!
//! A turn never spans two chunks, and a chunk has a checksum: every message of every complete chunk is kept. A chunk that
//! is cut or whose checksum is wrong is left out as a whole, because nothing vouches for what is in it.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::Path;

use mcap::records::op;
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};
use rustix::fs::{CWD, RenameFlags, renameat_with};

use crate::bytes::Bytes;
use crate::chunk::{self, Item};
use crate::error::BufferError;
use crate::records::{self, MAGIC_LEN};

/// What came of it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Recovered {
    /// Messages that were kept.
    pub messages: u64,
    /// Turns of the loop among them.
    pub turns: u64,
    /// Chunks that were kept.
    pub chunks: u64,
    /// Chunks that were left out because their checksum or contents are wrong, not counting one that is cut.
    pub bad_chunks: u64,
    /// Where the complete records of the original end.
    pub good_bytes: u64,
    /// Time of the last message, on the run's clock.
    pub last_ns: Option<u64>,
}

/// Several segments as one, or one made whole.
pub(crate) struct Rewriter<W: Write> {
    mcap: Writer<NoSeek<W>>,
    done: Recovered,
}

impl<W: Write> Rewriter<W> {
    pub(crate) fn begin(sink: W) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .library(concat!("embodied-depth ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            // The chunks stay those of the original.
            .chunk_size(None)
            .disable_seeking(true);
        Ok(Self { mcap: options.create(NoSeek::new(sink))?, done: Recovered::default() })
    }

    /// Adds every complete chunk of a segment.
    pub(crate) fn add<B: Bytes + ?Sized>(&mut self, file: &B) -> Result<(), McapError> {
        let length = file.length()?;
        if !records::has_magic(file, length)? {
            return if length < MAGIC_LEN { Ok(()) } else { Err(McapError::BadMagic) };
        }
        let (mut at, mut buffer) = (MAGIC_LEN, Vec::new());
        let (mut schemas, mut channels) = (BTreeMap::from([(0, 0)]), BTreeMap::new());
        self.done.good_bytes = at;
        while let Some(record) =
            records::record_at(file, at, length)?.filter(|record| record.opcode != op::DATA_END)
        {
            at = record.end();
            self.done.good_bytes = at;
            if record.opcode != op::CHUNK {
                continue;
            }
            // First without writing: what is wrong in the middle must not leave half of the chunk behind.
            let sound = chunk::load(file, record, &mut buffer)?.is_ok()
                && chunk::each_item(&buffer, |_| Ok(())).is_ok();
            if !sound {
                self.done.bad_chunks += 1;
                continue;
            }
            chunk::each_item(&buffer, |item| self.add_item(item, &mut schemas, &mut channels))?;
            self.done.chunks += 1;
            self.mcap.flush()?;
        }
        Ok(())
    }

    /// Numbers of schemas and channels are the file's own, so they are looked up by what the original calls them.
    fn add_item(
        &mut self,
        item: Item<'_>,
        schemas: &mut BTreeMap<u16, u16>,
        channels: &mut BTreeMap<u16, (u16, bool)>,
    ) -> Result<(), McapError> {
        match item {
            Item::Schema(header, data) => {
                schemas
                    .insert(header.id, self.mcap.add_schema(&header.name, &header.encoding, data)?);
            }
            Item::Channel(channel) => {
                // A schema of a chunk that is lost: the messages are still readable by name.
                let schema = schemas.get(&channel.schema_id).copied().unwrap_or(0);
                let id = self.mcap.add_channel(
                    schema,
                    &channel.topic,
                    &channel.message_encoding,
                    &channel.metadata,
                )?;
                channels.insert(channel.id, (id, channel.topic == "/robot/tick"));
            }
            Item::Message(mut header, data) => {
                let unknown = McapError::UnknownChannel(header.sequence, header.channel_id);
                let Some((id, is_turn)) = channels.get(&header.channel_id).copied() else {
                    return Err(unknown);
                };
                header.channel_id = id;
                self.done.last_ns = self.done.last_ns.max(Some(header.log_time));
                self.done.messages += 1;
                self.done.turns += u64::from(is_turn);
                self.mcap.write_to_known_channel(&header, data)?;
            }
        }
        Ok(())
    }

    pub(crate) fn finish(mut self) -> Result<(W, Recovered), McapError> {
        self.mcap.finish()?;
        Ok((self.mcap.into_inner().into_inner(), self.done))
    }
}

/// Writes a whole MCAP file with an index to `sink`: every message of every complete chunk of `file`.
///
/// # Errors
/// When `file` is no MCAP file, or reading or writing fails.
pub fn recover<B: Bytes + ?Sized, W: Write>(file: &B, sink: W) -> Result<Recovered, McapError> {
    let mut rewriter = Rewriter::begin(sink)?;
    rewriter.add(file)?;
    Ok(rewriter.finish()?.1)
}

/// Recovers the segment `from` into the new file `to`, which appears as a whole or not at all.
///
/// # Errors
/// When `to` is there already, cannot be written, or `from` is no MCAP file.
pub fn recover_file(from: &File, shown: &Path, to: &Path) -> Result<Recovered, BufferError> {
    write_new(to, |sink| recover(from, sink).map_err(|error| failure(error, shown, to)))
}

/// Writes a file that is not there yet by way of a temporary one.
pub(crate) fn write_new<T>(
    to: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> Result<T, BufferError>,
) -> Result<T, BufferError> {
    if to.exists() {
        return Err(BufferError::Exists { path: to.to_owned() });
    }
    let mut partial = to.as_os_str().to_owned();
    partial.push(".partial");
    let file = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .open(&partial)
        .map_err(BufferError::write(to))?;
    let mut sink = BufWriter::new(file);
    let filled = fill(&mut sink).and_then(|value| {
        let synced = sink.flush().and_then(|()| sink.get_ref().sync_all());
        // NOREPLACE: somebody may have made the file in the meantime.
        let named = synced
            .and_then(|()| Ok(renameat_with(CWD, &partial, CWD, to, RenameFlags::NOREPLACE)?));
        named.map_err(BufferError::write(to)).map(|()| value)
    });
    if filled.is_err() {
        // The first error is the one to tell.
        let _ = std::fs::remove_file(&partial);
    }
    filled
}

pub(crate) fn failure(error: McapError, from: &Path, to: &Path) -> BufferError {
    match error {
        McapError::Io(source) => BufferError::Write { path: to.to_owned(), source },
        other => BufferError::Segment { path: from.to_owned(), detail: other.to_string() },
    }
}
