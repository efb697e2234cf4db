//! A simulated Hokuyo scanner that speaks SCIP on a pty or TCP.
//!
//! `Sensor` is the device without wires: bytes and times go in, bytes come out. `SimulatedHokuyo` puts it on a pty (with a
//! symbolic link as its stable path) or a TCP port, paced on the monotonic clock, and lets a test pull its plug.
//! It shares no code for bytes with the driver.

mod command;
mod encode;
mod faults;
mod port;
mod room;
mod sensor;
mod simulated;

pub use command::{HokuyoArgs, run};
pub use faults::{Event, EventKind, FaultPlan, WireFaults};
pub use room::{Room, ScanSource};
pub use sensor::{Health, Sensor};
pub use simulated::SimulatedHokuyo;
