//! What a run is as bytes: one MCAP stream that people open in Foxglove or Rerun and that replays exactly.
//!
//! Everything that a turn of the loop knows ([`RecordedTick`]) comes back bit for bit. Pictures, scans and poses use
//! Foxglove's well-known schemas; what those cannot hold exactly stands beside them in `/robot/*` as JSON. A turn never
//! spans two chunks, a chunk is written in one piece and carries a CRC: a stream that is cut anywhere gives back every
//! turn of its complete chunks.
//!
//! All times in the stream are the run's own monotonic times, so the same run gives the same bytes.

mod container;
mod digest;
mod error;
mod header;
mod json;
mod picture;
mod reader;
mod scan;
mod sentences;
mod tick;
mod topics;
mod views;
mod writer;

#[cfg(test)]
mod tests;

pub use digest::{RunDigest, input_digest};
pub use error::RecordingError;
pub use header::{FORMAT_VERSION, HandOverSchedule, RunHeader, SegmentHeader};
pub use picture::quantise_mm;
pub use reader::RecordingReader;
pub use sentences::{Severity, fault_reason, sentence};
pub use tick::{Picture, RecordedTick};
pub use views::{MapView, Views};
pub use writer::{CHUNK_BYTES, CHUNK_NS, END_WITHOUT_SUMMARY, RecordingWriter};
