//! The recording of a run: one MCAP stream that opens in Foxglove and Rerun and that replays exactly.
//!
//! A [`RecordedTick`] is read back bit for bit. Images, scans and poses use Foxglove's well-known schemas; what those
//! cannot hold exactly is recorded beside them in `/robot/*` as JSON. A tick never spans two chunks, and a chunk is
//! written in one piece and carries a CRC. All ticks in the complete chunks of a truncated stream can be read.
//!
//! All times in the stream are the run's monotonic times. The header of each segment of a real robot says which date that is; a
//! simulated run has none, so that the same run gives the same bytes.

mod calibration_words;
mod container;
mod digest;
mod error;
mod event_log;
mod header;
mod image;
mod json;
mod reader;
mod scan;
mod sentences;
mod tick;
mod topics;
mod views;
mod writer;

#[cfg(test)]
mod tests;

pub use self::image::quantise_mm;
pub use calibration_words::changed;
pub use digest::{RunDigest, input_digest};
pub use error::RecordingError;
pub use event_log::EventLog;
pub use header::{FORMAT_VERSION, HandOverSchedule, RunHeader, RunIdentity, SegmentHeader};
pub use reader::RecordingReader;
pub use sentences::{Severity, drop_reason, fault_reason, goal_reason, lost_reason, sentence};
pub use tick::{RecordedTick, RgbImage};
pub use views::{MapView, Views};
/// Foxglove's messages of single parts, for the live view.
pub mod messages {
    pub use super::views::{
        calibration, field, grid, path, pose, pose_in, scan, timestamp, transforms,
    };
}
pub use writer::{CHUNK_BYTES, CHUNK_NS, END_WITHOUT_SUMMARY, RecordingWriter};
