//! Recording to disk: a thread of its own, files of bounded size, and nothing half-written.
//!
//! # What a power cut costs
//!
//! A chunk holds at most [`CHUNK_NS`](runtime::recording::CHUNK_NS) (1 s) or
//! [`CHUNK_BYTES`](runtime::recording::CHUNK_BYTES) (4 MiB) of turns. On a robot ([`RecorderOptions::robot`]) every
//! chunk is synced to the disk, so a power cut costs the chunk that is being filled and what waits in the queue: at 10
//! Hz at most 1 s plus 16 turns, 2.6 s. A crash of the program alone costs the same. A simulation
//! ([`RecorderOptions::simulation`]) can be run again, so nothing is synced and the operating system decides.
//!
//! # What a full disk costs
//!
//! The segment that is being written is cut back to its last complete chunk and closed without an index: a valid MCAP
//! file. A simulation then ends with `output_failed`; a robot goes on, counts what it does not record, says why in `health`, and
//! tries again every [`RETRY_NS`]: with a snapshot, so that what comes then can be replayed.
//!
//! It should not come to that: before a segment begins, the oldest ones of the robot's buffer make [room](Quota), first those
//! that were pulled. A segment beside which there is a file of its name and `.keep` stays.

mod disk;
mod error;
mod faulty_disk;
mod recorder;
mod room;
mod segments;

#[cfg(test)]
pub(crate) mod tests;

pub use disk::{Disk, FileSystem, SegmentFile, Space};
pub use error::RecordError;
pub use faulty_disk::FaultyDisk;
pub use recorder::{
    RETRY_NS, Recorder, RecorderOptions, RecordingSummary, WhenFull, Word, recorded_views,
    refuse_old_recording, snapshot,
};
pub use room::{Quota, Removed};
pub use segments::segment_name;
