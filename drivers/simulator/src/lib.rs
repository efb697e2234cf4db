//! A home to explore, without the home: the hal traits over a textured triangle scene, in virtual time.
//!
//! World frame: x and y horizontal, z up, metres; the floor that the robot drives on is at z = 0 after loading.
#![forbid(unsafe_code)]

mod builtin;
pub mod error;
pub mod floor;
pub mod homes;
pub mod laser;
pub mod load;
pub mod nuisance;
pub mod odometry;
pub mod people;
mod random;
pub mod render;
pub mod robot;
pub mod scene;
pub mod world;

pub use error::SceneError;
pub use robot::{Devices, RobotOptions, SimulatedRobot};
pub use world::{OpenOptions, World};
