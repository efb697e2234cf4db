//! Reads a segment from beginning to end and says whether it is whole.

use std::io;

use mcap::records::op;

use crate::bytes::Bytes;
use crate::chunk::{self, Item};
use crate::digest::{Digest, Hasher, PIECE};
use crate::records::{self, Fields, Footer, MAGIC_LEN, RecordAt};

/// What is wrong with a segment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    /// Every checksum is right and the end is there.
    Whole,
    /// Whole, but without an index.
    Unindexed,
    /// It ends at this byte, in the middle of something; everything before is good.
    Cut {
        /// Length of the complete records.
        at: u64,
    },
    /// Bytes were changed.
    Corrupt {
        /// Where.
        at: u64,
        /// What is wrong there.
        detail: String,
    },
}

/// What was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verified {
    /// Whether it is whole.
    pub finding: Finding,
    /// Of all bytes.
    pub digest: Digest,
    /// Complete chunks.
    pub chunks: u64,
    /// Messages in complete chunks.
    pub messages: u64,
    /// Turns of the loop in complete chunks.
    pub turns: u64,
    /// Time of the last message in a complete chunk.
    pub last_ns: Option<u64>,
}

/// Reads a whole segment; at most one chunk is in memory.
///
/// # Errors
/// When the disk fails. Whatever the bytes are is no error.
pub fn verify<B: Bytes + ?Sized>(file: &B) -> io::Result<Verified> {
    let length = file.length()?;
    let mut reading = Reading {
        file,
        length,
        crc: crc32fast::Hasher::new(),
        verified: blank(file, length)?,
        tick: None,
    };
    reading.verified.finding = reading.read()?;
    Ok(reading.verified)
}

fn blank<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<Verified> {
    let (mut hasher, mut buffer) = (Hasher::default(), vec![0; PIECE]);
    while hasher.bytes() < length {
        let left = usize::try_from(length - hasher.bytes()).unwrap_or(PIECE).min(PIECE);
        let piece = buffer.get_mut(..left).unwrap_or_default();
        file.read_exact_at(hasher.bytes(), piece)?;
        hasher.update(piece);
    }
    let digest = hasher.digest();
    Ok(Verified {
        finding: Finding::Whole,
        digest,
        chunks: 0,
        messages: 0,
        turns: 0,
        last_ns: None,
    })
}

struct Reading<'a, B: ?Sized> {
    file: &'a B,
    length: u64,
    /// Of the data section, so far.
    crc: crc32fast::Hasher,
    verified: Verified,
    /// The channel `/robot/tick`.
    tick: Option<u16>,
}

impl<B: Bytes + ?Sized> Reading<'_, B> {
    fn read(&mut self) -> io::Result<Finding> {
        if !records::has_magic(self.file, self.length)? {
            let detail = "the MCAP magic is missing".to_owned();
            return Ok(if self.length < MAGIC_LEN {
                Finding::Cut { at: 0 }
            } else {
                Finding::Corrupt { at: 0, detail }
            });
        }
        self.crc.update(mcap::MAGIC);
        let footer = records::footer(self.file, self.length)?;
        let (mut at, mut buffer) = (MAGIC_LEN, Vec::new());
        loop {
            let Some(record) = records::record_at(self.file, at, self.length)? else {
                return Ok(match footer {
                    // The end is there, so something in between has a wrong length.
                    Some(_) => Finding::Corrupt {
                        at,
                        detail: "a record reaches beyond the end".to_owned(),
                    },
                    None => Finding::Cut { at },
                });
            };
            if let Err(detail) = chunk::load(self.file, record, &mut buffer)? {
                return Ok(Finding::Corrupt { at, detail });
            }
            if record.opcode == op::DATA_END {
                return self.read_end(record, &buffer, footer.as_ref());
            }
            self.crc.update(&buffer);
            if record.opcode == op::CHUNK
                && let Err(error) = self.read_chunk(&buffer)
            {
                return Ok(Finding::Corrupt { at, detail: error.to_string() });
            }
            at = record.end();
        }
    }

    fn read_chunk(&mut self, bytes: &[u8]) -> Result<(), mcap::McapError> {
        let (verified, tick) = (&mut self.verified, &mut self.tick);
        chunk::each_item(bytes, |item| {
            match item {
                Item::Channel(channel) if channel.topic == "/robot/tick" => {
                    *tick = Some(channel.id);
                }
                Item::Message(header, _) => {
                    verified.messages += 1;
                    verified.turns += u64::from(*tick == Some(header.channel_id));
                    verified.last_ns = verified.last_ns.max(Some(header.log_time));
                }
                _ => {}
            }
            Ok(())
        })?;
        verified.chunks += 1;
        Ok(())
    }

    /// From the end of the data on: checksums of the data and of the index.
    fn read_end(
        &mut self,
        record: RecordAt,
        bytes: &[u8],
        footer: Option<&Footer>,
    ) -> io::Result<Finding> {
        let corrupt = |at, detail: &str| Ok(Finding::Corrupt { at, detail: detail.to_owned() });
        let at = record.start;
        let saved = Fields(bytes.get(9..).unwrap_or_default()).u32();
        match saved {
            None => return corrupt(at, "the data's end has no checksum"),
            Some(0) => {}
            Some(saved) if saved == self.crc.clone().finalize() => {}
            Some(_) => return corrupt(at, "the checksum of the data is wrong"),
        }
        let Some(footer) = footer else { return Ok(Finding::Cut { at }) };
        if footer.start < record.end() {
            return corrupt(at, "the index begins before the data ends");
        }
        if footer.summary_start == 0 {
            return Ok(Finding::Unindexed);
        }
        if footer.summary_start != record.end() {
            return corrupt(footer.start, "the index is not where the end says");
        }
        // Of the index and of the footer up to its checksum: opcode, length and two offsets (MCAP specification, "Footer").
        let length = footer.start - footer.summary_start + 9 + 16;
        let mut index = vec![0; usize::try_from(length.min(chunk::MAX_CHUNK)).unwrap_or(0)];
        self.file.read_exact_at(footer.summary_start, &mut index)?;
        if footer.summary_crc != 0 && footer.summary_crc != crc32fast::hash(&index) {
            return corrupt(footer.summary_start, "the checksum of the index is wrong");
        }
        match records::summary(self.file, footer)? {
            Some(_) => Ok(Finding::Whole),
            None => corrupt(footer.summary_start, "the index cannot be read"),
        }
    }
}
