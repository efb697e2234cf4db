//! A simulated LD06 or LD19. It shares no encoding code with the driver, so that the driver is tested
//! against an independent implementation.

mod encode;
mod sensor;

pub use sensor::{Ld06Sensor, RATE_HZ};

/// A simulated LD06 on its transport.
pub type SimulatedLd06 = crate::rotary::SimulatedRotary<Ld06Sensor>;
