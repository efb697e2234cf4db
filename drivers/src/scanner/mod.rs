//! What the drivers of all planar scanners share: the port, reading with deadlines, the reader
//! thread's life, and the side that the safety thread polls.

mod error;
mod framer;
mod link;
mod polled;
mod port;
mod retry;
mod shared;
#[allow(unsafe_code, reason = "one ioctl, which rustix does not wrap")]
mod sys;

pub(crate) use link::{Link, Received, Stop};
pub(crate) use polled::{Polled, ReaderEnd};
pub(crate) use retry::{End, FIRST_WAIT_NS, keep_trying};
pub(crate) use shared::Shared;

pub use error::{BlindError, LinkError, PollError};
pub use framer::FixedFramer;
pub use port::{Port, PortError};
pub use shared::{Identity, LidarMonitor};
