//! Inertial measurement units and gyroscopes of Linux's Industrial I/O subsystem (IIO), and simulated units.
//!
//! From the bottom up:
//!
//! * [`ElementType`] and [`Layout`] say where each channel is in a record of the kernel, and [`Decoder`] makes a sample of a
//!   record. They perform no I/O. [`wire`] does the same for a unit in another program.
//! * `kernel` sets up a device by its attributes in sysfs, and `remote` connects to another program.
//! * [`SampleCheck`] refuses samples that cannot be.
//! * [`IioImu`] is all of this behind [`hal::Imu`], with a thread of its own that opens the device again after it was gone.
//!
//! # Times
//!
//! A sample has the kernel's time, on the monotonic clock. A device that has no timestamps, or whose driver cannot take them from
//! the monotonic clock, gets the time at which the sample was read: late by the time that the thread took to wake up, which is
//! below a millisecond on an idle computer and unbounded on a busy one. [`ImuSetup::times`] says which of the two a unit has.
//!
//! # Limits
//!
//! The queue holds [`QUEUE`] samples. When it is full, the newest samples are dropped and counted as lost: the caller reads the
//! samples from before the gap first, and the gap shows in their times.
//!
//! Statements about IIO are from the kernel's `Documentation/ABI/testing/sysfs-bus-iio`.

mod attributes;
mod check;
mod config;
mod decoder;
mod element;
mod error;
mod find;
mod imu;
mod kernel;
mod layout;
mod mount_matrix;
mod rate;
mod reader;
mod records;
mod remote;
mod source;
#[cfg(test)]
mod tests;
pub mod wire;

pub use check::{Refusal, SampleCheck};
pub use config::{ImuConfig, ImuPlace};
pub use decoder::{Axis, Decoder, Triad};
pub use element::{ElementType, TypeError};
pub use error::{ImuError, ImuPollError};
pub use find::Roots;
pub use imu::{IioImu, ImuMonitor, QUEUE};
pub use layout::{Element, Layout, Place};
pub use records::Records;
pub use source::{ImuSetup, Times};
