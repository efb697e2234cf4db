//! The workstation's side of a pull: copies the new segments of a store into a directory and verifies them.
//!
//! A file grows as `NAME.part`. When it is complete, its digest is compared with the one that the sender computed, it is synced
//! to disk and renamed, and only then the robot receives the message that a copy exists. A pull that was interrupted resumes at the last
//! byte. Complete files are listed in `pulled.json` and are not read again while their size and modification time stay the same.

mod disk;
mod index;
mod options;
mod order;
mod part;
mod progress;
mod puller;
mod rate_limiter;

pub use disk::{Disk, FileSystem, PartFile};
pub use index::{INDEX_FILE, Indexed};
pub use options::Options;
pub use order::Order;
pub use progress::{Progress, Report};
pub use puller::{Destination, pull};
pub use rate_limiter::RateLimiter;
