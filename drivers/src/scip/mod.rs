//! SCIP 2.x, the protocol of Hokuyo's planar scanners (Hokuyo, "Communication Protocol Specification for SCIP 2.0 Standard",
//! C-42-03320B). The bytes of one reply go in, the ranges of one scan come out; nothing is read, written or allocated here.
//!
//! A reply is lines that end in LF, and ends with an empty line:
//!
//! ```text
//! MD0000108001000      what was asked for
//! 99b                  status and its checksum
//! m2@0...              time stamp and its checksum
//! 1Dh...               up to 64 characters of data and their checksum, as often as needed
//!
//! ```
//!
//! Every checksum is checked, that of the time stamp too, and so is every character: data characters lie in `0` to `o`, and
//! within these a single changed character always changes the checksum. The echo has none, so it is compared with the request.
//!
//! A checksum has six bits: of two changes in one line, one in 64 goes unnoticed. That is the protocol's limit.

mod clock;
mod codes;
mod command;
mod data;
mod error;
mod framer;
mod info;
mod line;
mod model;
mod reply;
mod request;

pub use clock::{ClockSync, TimeProbe};
pub use codes::RangeCodes;
pub use command::{Answer, Command};
pub use error::ScipError;
pub use framer::{Framer, message_length};
pub use info::{Parameters, State, Version};
pub use model::{Model, Sheet, UnknownModel};
pub use reply::Reply;
pub use request::{Encoding, Mode, Request};
