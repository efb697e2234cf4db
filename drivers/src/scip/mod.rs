//! SCIP 2.x, the protocol of Hokuyo's planar scanners (Hokuyo, "Communication Protocol
//! Specification for SCIP 2.0 Standard", C-42-03320B). This module converts the bytes of a reply to
//! the ranges of a scan. It does no I/O and allocates nothing.
//!
//! A reply consists of lines that end with LF. Its last line is empty:
//!
//! ```text
//! MD0000108001000      the request
//! 99b                  status and its checksum
//! m2@0...              timestamp and its checksum
//! 1Dh...               up to 64 characters of data and their checksum; as many lines as needed
//!
//! ```
//!
//! Every checksum is checked, including that of the timestamp, and so is every character. Data
//! characters are in the range `0` to `o`, and within it a single changed character always changes
//! the checksum. The echo has no checksum, so it is compared with the request.
//!
//! A checksum has six bits, so one in 64 double errors in a line is not detected. This is a limit
//! of the protocol.

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
pub use model::{Model, ModelSpec, UnknownModel};
pub use reply::Reply;
pub use request::{Encoding, Mode, Request};
