//! One module per real device. Protocols are codecs over bytes that somebody else reads and writes, so that they can be tested
//! without a device and replayed from a recording.
#![forbid(unsafe_code)]

pub mod scip;
