//! The parts of the robot's binary, as a library so that tests can use them without a process.
#![forbid(unsafe_code)]

pub mod record;
pub mod replay;
