//! What the simulated scanners that rotate slowly and clockwise share: the room around them and their
//! transport.

mod command;
mod simulated;
mod source;

pub use command::{RotaryArgs, run};
pub use simulated::{Sensor, SimulatedRotary};
pub use source::{CircleRoom, CircleSource};

pub(crate) use source::packet_mm;
