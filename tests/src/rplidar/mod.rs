//! A simulated RPLIDAR. It shares no encoding code with the driver, so that the driver is tested
//! against an independent implementation.

mod encode;
mod sensor;

pub use sensor::{RplidarHealth, RplidarSensor};

/// A simulated RPLIDAR on its transport.
pub type SimulatedRplidar = crate::rotary::SimulatedRotary<RplidarSensor>;
