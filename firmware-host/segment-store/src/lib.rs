//! The store of a robot's recorded segments: which segments exist, whether they are complete, which of them a workstation has
//! already copied, and how they are transferred, verified, recovered and exported.
//!
//! A store is a directory that contains the `--out` directories of runs, or one such directory itself:
//!
//! ```text
//! STORE/RUN/recording_0007.mcap           a segment
//! STORE/RUN/recording_0007.mcap.pulled    a workstation has a copy: its digest, size and modification time
//! STORE/RUN/recording_0007.mcap.keep      the recorder's quota keeps this segment
//! ```
//!
//! This crate writes only markers into a store, and it follows no symbolic link out of it.
//!
//! Modules depend only on modules above them in this list:
//!
//! 1. `bytes`, `cpu_features`, `digest`, `fields`, `name`, `transfer`: types without knowledge of a store;
//! 2. `records`, `chunk`, `index`, [`verify`](verify()), [`signature`], `check_signature`, [`KnownRobots`]: the MCAP format, and who
//!    recorded a segment;
//! 3. `entry`: what is known about one segment;
//! 4. [`wire`]: the messages of the pull protocol;
//! 5. `error`: [`StoreError`];
//! 6. [`private`], `root`, `marks`, `catalogue`, `partial`, [`recover`](recover()): a store on a local disk;
//! 7. `send`, [`serve`](serve()): the robot's side of a pull;
//! 8. [`source`], [`pull`]: the workstation's side of a pull;
//! 9. [`export`] and `bucket`: other formats and object stores.
#![forbid(unsafe_code)]

#[cfg(feature = "object-store")]
pub mod bucket;
mod bytes;
mod catalogue;
mod check_signature;
mod chunk;
mod cpu_features;
mod digest;
mod entry;
mod error;
#[cfg(feature = "export")]
pub mod export;
mod fields;
mod index;
mod known_robots;
mod marks;
mod name;
mod partial;
pub mod private;
pub mod pull;
mod records;
mod recover;
mod root;
mod send;
mod serve;
pub mod signature;
pub mod source;
mod transfer;
mod verify;
pub mod wire;

pub use bytes::Bytes;
pub use catalogue::{Catalogue, Gap, OPEN_FOR_NS, Unread};
pub use check_signature::{Signed, check_signature};
pub use cpu_features::CpuFeatures;
pub use digest::{Digest, Hasher};
pub use entry::{Entry, Pulled, State, Times};
pub use error::{ErrorKind, StoreError};
pub use known_robots::{BadRobot, KnownRobots};
pub use marks::{KEEP, PULLED, is_kept_for_event, keep_for_event};
pub use name::{BadName, Name, is_segment_name};
pub use recover::{Recovered, recover, recover_file};
pub use root::Root;
pub use serve::serve;
pub use transfer::{FileSink, LocalCopy};
pub use verify::{Finding, Verified, verify};
