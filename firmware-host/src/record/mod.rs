//! Recording to disk, in files of bounded size, on a thread of its own.
//!
//! # What a power cut costs
//!
//! A chunk holds at most [`CHUNK_NS`](runtime::recording::CHUNK_NS) (1 s) or
//! [`CHUNK_BYTES`](runtime::recording::CHUNK_BYTES) (4 MiB) of ticks. On a robot ([`RecorderOptions::robot`]) every
//! chunk is synced to the disk, so a power cut costs the chunk that is being filled and the ticks in the queue: at 10
//! Hz at most 1 s plus 16 ticks, 2.6 s. A crash of the program alone costs the same. A simulation
//! ([`RecorderOptions::simulation`]) can be repeated, so its chunks are not synced.
//!
//! # What a full disk costs
//!
//! The segment that is being written is truncated to its last complete chunk and closed without an index. It is then a
//! valid MCAP file. A simulation ends with `output_failed`. A robot goes on, counts the ticks that it does not record,
//! shows the reason in `health`, and tries again every [`RETRY_NS`], with a snapshot from which a replay can begin.
//!
//! To prevent that, the recorder removes old segments from the robot's buffer before it begins a new one, as the
//! [quota](Quota) demands: first those that a workstation has pulled, then the oldest. A segment with a file of its name
//! and `.keep` beside it is not removed. The recorder writes this file around a contact or a stop that needs a person; of
//! the segments that it keeps so, the oldest lose their protection when they exceed a share of the quota.

mod age;
mod disk;
mod error;
mod faulty_disk;
mod free_space;
mod kept;
mod recorder;
mod segments;
mod signer;

#[cfg(test)]
pub(crate) mod tests;

pub use disk::{Disk, FileSystem, SegmentFile, Space};
pub use error::RecordError;
pub use faulty_disk::FaultyDisk;
pub use free_space::{Quota, Removed};
pub use recorder::{
    RETRY_NS, Recorder, RecorderOptions, RecorderStatus, RecordingSummary, WhenFull,
    recorded_views, refuse_old_recording, snapshot,
};
pub use segments::segment_name;
