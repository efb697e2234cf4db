//! Fault injectors: each implements the hal trait of the device that it wraps, so that a fault found anywhere replays anywhere.
//!
//! A [`Fault`] is a line of text, such as `lidar:stall@4..6` or `camera:drop=0.1`; a run's [`Faults`] are all of them with a seed
//! and a time. A wrapper without faults hands everything through. Nothing here allocates after a wrapper is made (a camera's
//! buffers grow once, with its first pictures) and nothing waits, so that scanner and base may be wrapped on the safety thread.

mod base;
mod belt;
mod camera;
mod clock;
mod error;
mod injector;
mod lidar;
mod random;
mod schedule;
#[cfg(test)]
mod tests;

pub use base::FaultyBase;
pub use camera::FaultyCamera;
pub use clock::FaultyClock;
pub use error::{FaultTextError, Faulty, FaultyError, Symptom};
pub use injector::{Faults, Injector, Now};
pub use lidar::FaultyLidar;
pub use random::random_faults;
pub use schedule::{Device, Fault, Kind, kinds_of};
