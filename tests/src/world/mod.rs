//! A simulated home behind simulated devices, in real time: what `firmware-host run` drives when there is no robot.
//!
//! Motors on a CAN bus turn wheels that move the robot, the scanner and the camera see the home from where it is. The program
//! under test speaks to all of them as to real ones.

mod cables;
mod command;
mod faults;
mod home;
mod live;
mod output;
mod sight;

pub use cables::{Cable, Cables};
pub use command::{WorldArgs, run};
pub use home::Home;
pub use live::{LiveOptions, LiveWorld};
