//! Drivers for real devices, each behind a trait of [`hal`].
//!
//! * [`can`] drives a differential base on a CAN bus. Motor controllers are implementations of
//!   [`can::protocol::MotorProtocol`]; `examples/new_motor_protocol.rs` shows how to add one.
//! * [`scip`] is the protocol of Hokuyo's laser scanners, and [`hokuyo`] the driver that speaks it
//!   over a serial port or TCP.
//! * [`rplidar`] and [`ld06`] are protocols and drivers of scanners that rotate slowly; [`rotary`] is
//!   what they share. [`lidar`] is whichever scanner the configuration names.
//! * [`v4l2`] is the driver for cameras of Linux's Video4Linux2.
//! * [`iio`] is the driver for inertial measurement units and gyroscopes of Linux's Industrial I/O.
//! * [`stop_line`] reads an emergency stop on an input line of the computer.
//! * [`fault`] wraps any device and injects faults, for tests and simulated runs.
//!
//! Protocols are sans-I/O codecs: the caller reads and writes the bytes and passes in the time.
//! They can therefore be tested without a device and replayed from a recording. Unsafe code exists
//! only in modules called `sys`; each block has a SAFETY comment.

pub mod can;
pub mod fault;
pub mod hokuyo;
pub mod iio;
pub mod ld06;
pub mod lidar;
pub mod rotary;
pub mod rplidar;
mod scanner;
pub mod scip;
pub mod status;
pub mod stop_line;
pub mod v4l2;

pub use scanner::{
    BlindError, FixedFramer, Identity, LidarMonitor, LinkError, PollError, Port, PortError,
};
pub use status::{DeviceState, DeviceStatus};
