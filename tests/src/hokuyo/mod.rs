//! A simulated Hokuyo scanner that implements SCIP on a pty, a serial port or TCP.
//!
//! `Sensor` is the device without a transport: bytes and times go in, bytes come out.
//! `SimulatedHokuyo` connects it to a pty (with a symbolic link as its stable path), a serial port
//! or a TCP port, paced by the monotonic clock, and lets a test unplug it. It shares no encoding
//! code with the driver, so that the driver is tested against an independent implementation.

mod command;
mod encode;
mod faults;
mod room;
mod sensor;
mod simulated;

pub use command::{HokuyoArgs, run};
pub use faults::{Event, EventKind, FaultPlan, WireFaults, seeded};
pub use room::{Room, ScanSource};
pub use sensor::{Health, Sensor};
pub use simulated::SimulatedHokuyo;
