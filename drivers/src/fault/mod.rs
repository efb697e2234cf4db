//! Fault injectors. Each implements the `hal` trait of the device that it wraps, so the same faults
//! can be injected into the simulator, a replayed run and the real robot.
//!
//! A [`Fault`] is one line of text, such as `lidar:stall@4..6` or `camera:drop=0.1`. The [`Faults`]
//! of a run are all of its faults with a random seed and a clock. A wrapper without faults passes
//! everything through unchanged. Nothing here allocates after a wrapper is made (a camera's buffers
//! grow once, with its first frames) and nothing blocks, so the scanner and the base can be wrapped
//! on the safety thread.

mod base;
mod camera;
mod clock;
mod error;
mod imu;
mod injector;
mod kind;
mod lidar;
mod random;
mod reorder_buffer;
mod schedule;
#[cfg(test)]
mod tests;

pub use base::FaultyBase;
pub use camera::FaultyCamera;
pub use clock::FaultyClock;
pub use error::{FaultTextError, Faulty, FaultyError, Symptom};
pub use imu::FaultyImu;
pub use injector::{Faults, Injector, Now};
pub use kind::{Device, Kind, kinds_of};
pub use lidar::FaultyLidar;
pub use random::random_faults;
pub use schedule::Fault;
