//! The robot's recorded segments as a store: what is there, whole or cut, what was pulled, and how it travels.
//!
//! A buffer is a directory that holds the `--out` directories of runs, or is one itself:
//!
//! ```text
//! BUFFER/RUN/recording_0007.mcap           a segment
//! BUFFER/RUN/recording_0007.mcap.pulled    a workstation has it: its digest, size and time
//! BUFFER/RUN/recording_0007.mcap.keep      never deleted by the recorder's quota
//! ```
//!
//! Nothing here writes into a buffer but the mark `.pulled`, and nothing follows a symbolic link out of it.
#![forbid(unsafe_code)]

#[cfg(feature = "object-store")]
pub mod bucket;
mod bytes;
mod catalogue;
mod chunk;
mod computer;
mod digest;
mod error;
#[cfg(feature = "export")]
pub mod export;
mod marks;
mod name;
pub mod pull;
mod records;
mod recover;
mod root;
mod send;
mod serve;
pub mod source;
mod verify;
pub mod wire;

pub use bytes::Bytes;
pub use catalogue::{Catalogue, Entry, OPEN_FOR_NS, State, Times};
pub use computer::Computer;
pub use digest::{Digest, Hasher};
pub use error::{BufferError, Kind};
pub use marks::{KEEP, PULLED, Pulled, keep};
pub use name::{BadName, Name, is_segment_name};
pub use recover::{Recovered, recover, recover_file};
pub use root::Root;
pub use send::{Have, Receive};
pub use serve::serve;
pub use verify::{Finding, Verified, verify};
