//! Fault injectors and scenarios.
//!
//! A fault injector implements the same hal trait as the device that it wraps, seeded, so that a fault found in one run
//! is found again in the next: `FaultyLidar::new(lidar, LidarFaults { silence: Some(2.0..3.0), .. }, seed)`.
#![forbid(unsafe_code)]

pub mod base;
pub mod camera;
pub mod hokuyo;
pub mod lidar;
pub mod motor;
pub mod rig;
pub mod scenario;
pub mod video;

pub use base::{BaseFaults, FaultyBase};
pub use camera::{CameraFaults, FaultyCamera};
pub use lidar::{FaultyLidar, LidarFaults};
pub use scenario::{Faults, Scenario, Turn};

use std::ops::Range;

/// A stretch of time, seconds since the clock's zero.
pub type Seconds = Range<f64>;

fn holds(stretch: Option<&Seconds>, time_ns: u64) -> bool {
    stretch.is_some_and(|stretch| stretch.contains(&(time_ns as f64 * 1e-9)))
}
