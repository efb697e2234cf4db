//! A simulated home with simulated devices in real time, for `firmware-host run` without a robot.
//!
//! Motors on a CAN bus drive the wheels that move the robot; scanner and camera observe the home
//! from the robot's pose. The program under test communicates with all of them as with real
//! devices.

mod cables;
mod command;
mod faults;
mod hands;
mod home;
mod imu;
mod live;
mod output;
mod scanner;
mod sensors;
mod wheels;

pub use cables::{Cable, Cables};
pub use command::{WorldArgs, run};
pub use hands::Handled;
pub use home::Home;
pub use live::{LiveOptions, LiveWorld};
pub use scanner::{ScannerModel, SimulatedScanner};
