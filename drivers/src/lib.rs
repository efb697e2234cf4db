//! One module per real device. Protocols are codecs over bytes that somebody else reads and writes, so that they can be tested
//! without a device and replayed from a recording.
//!
//! Unsafe code lives only in a module called `sys`, each block with its SAFETY note.

pub mod can;
pub mod fault;
pub mod hokuyo;
pub mod scip;
pub mod status;
pub mod v4l2;

pub use status::{DeviceState, DeviceStatus};
