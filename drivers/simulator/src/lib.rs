//! This crate simulates a robot in an indoor home: it implements the `hal` camera, lidar, base and
//! clock traits over a scene of textured triangles. Scenes come from glTF or OBJ files or from
//! built-in procedural homes. Time is virtual and advances only when the clock sleeps, so the same
//! seed always produces the same frames, scans and odometry.
//!
//! World frame: x and y horizontal, z up, metres; the floor that the robot drives on is at z = 0
//! after loading.
#![forbid(unsafe_code)]

pub mod body;
mod builtin;
pub mod error;
pub mod floor;
pub mod homes;
pub mod laser;
pub mod load;
pub mod nuisance;
pub mod odometry;
mod path;
pub mod people;
pub mod pets;
mod random;
pub mod render;
pub mod robot;
pub mod scene;
pub mod world;

pub use error::SceneError;
pub use robot::{Devices, RobotOptions, SimulatedRobot};
pub use world::{OpenOptions, World};
