//! Verification of a segment: reads it completely and checks all of its checksums.

use std::io;

use mcap::records::op;

use crate::bytes::Bytes;
use crate::chunk::{self, Item};
use crate::digest::{Digest, Hasher, PIECE};
use crate::fields::Fields;
use crate::records::{self, Footer, MAGIC_LEN, RecordAt};

/// The result of verifying a segment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    /// All checksums are right and the index is there.
    Whole,
    /// All checksums are right, but there is no index.
    Unindexed,
    /// The file ends in the middle of a record; everything before that record is intact.
    Cut {
        /// Where the complete records end.
        at: u64,
    },
    /// Bytes were changed, or the structure is invalid.
    Corrupt {
        /// The offset of the first invalid record.
        at: u64,
        detail: String,
    },
}

/// What [`verify`] found in a segment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verified {
    pub finding: Finding,
    /// The digest of the whole file.
    pub digest: Digest,
    /// The number of complete chunks.
    pub chunks: u64,
    /// The number of messages in complete chunks.
    pub messages: u64,
    /// The number of ticks of the control loop in complete chunks.
    pub ticks: u64,
    /// The time of the last message in a complete chunk, on the run's clock.
    pub last_ns: Option<u64>,
}

/// Reads a whole segment and checks it. At most one chunk is in memory at a time.
///
/// # Errors
/// When the file cannot be read. Corrupt contents are not an error but a [`Finding`].
pub fn verify<B: Bytes + ?Sized>(file: &B) -> io::Result<Verified> {
    let length = file.length()?;
    let verified = Verified {
        finding: Finding::Whole,
        digest: digest_of(file, length)?,
        chunks: 0,
        messages: 0,
        ticks: 0,
        last_ns: None,
    };
    let mut verifier =
        Verifier { file, length, crc: crc32fast::Hasher::new(), verified, tick_channel: None };
    verifier.verified.finding = verifier.read()?;
    Ok(verifier.verified)
}

fn digest_of<B: Bytes + ?Sized>(file: &B, length: u64) -> io::Result<Digest> {
    let mut hasher = Hasher::default();
    let mut buffer = vec![0; PIECE];
    while hasher.bytes() < length {
        let left = usize::try_from(length - hasher.bytes()).unwrap_or(PIECE).min(PIECE);
        let piece = buffer.get_mut(..left).unwrap_or_default();
        file.read_exact_at(hasher.bytes(), piece)?;
        hasher.update(piece);
    }
    Ok(hasher.digest())
}

struct Verifier<'a, B: ?Sized> {
    file: &'a B,
    length: u64,
    /// The CRC of the data section up to the current record.
    crc: crc32fast::Hasher,
    verified: Verified,
    /// The id of the channel `/robot/tick`, once its record has been read.
    tick_channel: Option<u16>,
}

impl<B: Bytes + ?Sized> Verifier<'_, B> {
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
        let mut at = MAGIC_LEN;
        let mut buffer = Vec::new();
        loop {
            let Some(record) = records::record_at(self.file, at, self.length)? else {
                return Ok(match footer {
                    // The file has a footer, so a record in between has a wrong length.
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
        let Self { verified, tick_channel, .. } = self;
        chunk::each_item(bytes, |item| {
            match item {
                Item::Channel(channel) if channel.topic == "/robot/tick" => {
                    *tick_channel = Some(channel.id);
                }
                Item::Message(header, _) => {
                    verified.messages += 1;
                    verified.ticks += u64::from(*tick_channel == Some(header.channel_id));
                    verified.last_ns = verified.last_ns.max(Some(header.log_time));
                }
                _ => {}
            }
            Ok(())
        })?;
        verified.chunks += 1;
        Ok(())
    }

    /// Checks what follows the data: the checksum of the data and the checksum of the index.
    fn read_end(
        &mut self,
        record: RecordAt,
        bytes: &[u8],
        footer: Option<&Footer>,
    ) -> io::Result<Finding> {
        let at = record.start;
        let saved = Fields(bytes.get(9..).unwrap_or_default()).u32();
        match saved {
            None => return Ok(corrupt(at, "the end of the data has no checksum")),
            Some(0) => {}
            Some(saved) if saved == self.crc.clone().finalize() => {}
            Some(_) => return Ok(corrupt(at, "the checksum of the data is wrong")),
        }
        let Some(footer) = footer else { return Ok(Finding::Cut { at }) };
        if footer.start < record.end() {
            return Ok(corrupt(at, "the index begins before the data ends"));
        }
        if footer.summary_start == 0 {
            return Ok(Finding::Unindexed);
        }
        if footer.summary_start != record.end() {
            return Ok(corrupt(footer.start, "the index is not where the footer says"));
        }
        // The checksum covers the index and the footer up to the checksum itself: opcode, length and two offsets (MCAP
        // specification, "Footer").
        let length = footer.start - footer.summary_start + 9 + 16;
        let mut index = vec![0; usize::try_from(length.min(chunk::MAX_CHUNK)).unwrap_or(0)];
        self.file.read_exact_at(footer.summary_start, &mut index)?;
        if footer.summary_crc != 0 && footer.summary_crc != crc32fast::hash(&index) {
            return Ok(corrupt(footer.summary_start, "the checksum of the index is wrong"));
        }
        match records::summary(self.file, footer)? {
            Some(_) => Ok(Finding::Whole),
            None => Ok(corrupt(footer.summary_start, "the index cannot be parsed")),
        }
    }
}

fn corrupt(at: u64, detail: &str) -> Finding {
    Finding::Corrupt { at, detail: detail.to_owned() }
}
