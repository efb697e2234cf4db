//! Simulated motor controllers on a CAN bus.
//!
//! By hand: `cargo run -p hil -- motor --bus unix:/tmp/can --protocol odrive` plays two controllers and the bus between
//! processes; with an interface's name it plays them on a real one.
//!
//! To couple them with a simulated home, own two [`MotorNode`]s (from [`rig::node`]) and any [`drivers::can::CanBus`], call
//! [`rig::step_nodes`] every millisecond, move the robot by what `node.wheel().velocity_radps()` or `position_rad()` says, and set
//! `node.wheel_mut().blocked` while it stands against something.

pub mod cia402;
mod host;
pub mod hub;
pub mod memory;
pub mod node;
pub mod odrive;
pub mod outbox;
pub mod rig;
mod run;
pub mod vesc;
pub mod wheel;

pub use host::{BaseArgs, run_base};
pub use hub::Hub;
pub use memory::{LineFaults, MemoryBus};
pub use node::{MotorNode, NodeFaults, Watchdog};
pub use outbox::Outbox;
pub use rig::Rig;
pub use run::{MotorArgs, run};
pub use wheel::{Drive, Wheel};
