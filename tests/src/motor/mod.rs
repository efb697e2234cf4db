//! Simulated motor controllers on a CAN bus, with ODrive, VESC and CiA 402 protocols.
//!
//! From a terminal: `cargo run -p hil -- motor --bus unix:/tmp/can --protocol odrive` simulates two
//! controllers and a bus between processes. With the name of a CAN interface it simulates them on
//! that interface.
//!
//! To couple them with a simulated home, create two [`MotorNode`]s (with [`rig::node`]) and any
//! [`drivers::can::CanBus`], call [`rig::step_nodes`] every millisecond, move the robot by
//! `node.wheel().velocity_radps()` or `position_rad()`, and set `node.wheel_mut().blocked` while
//! the robot touches an obstacle.

pub mod cia402;
pub mod composition;
mod host;
pub mod hub;
pub mod memory;
pub mod node;
pub mod odrive;
pub mod outbox;
pub mod power;
pub mod rig;
mod run;
pub mod vesc;
pub mod wheel;

pub use composition::Composition;
pub use host::{BaseArgs, run_base};
pub use hub::Hub;
pub use memory::{LineFaults, MemoryBus};
pub use node::{MotorNode, NodeFaults, Watchdog};
pub use outbox::Outbox;
pub use rig::Rig;
pub(crate) use run::ProtocolArg;
pub use run::{MotorArgs, run};
pub use wheel::{Drive, Wheel};
