//! What the drivers of scanners that rotate slowly and clockwise share: measurements are collected
//! over a revolution, and become a scan of a whole circle.
//!
//! * Angles become counter-clockwise; see [`Mount`].
//! * A beam that was not measured is an error. No return is not free space. Of several measurements in
//!   one beam the nearest counts.
//! * The beams are the same in every scan, although the motor never rotates exactly as it should: a
//!   revolution up to a tenth too fast still fills them all ([`circle`]), and one that takes
//!   [`SLOWER`] times as long as configured is a fault.

mod clock;
mod device;
mod error;
mod lidar;
mod revolution;
mod sample;
mod settings;
mod stream;

pub(crate) use device::Device;
pub(crate) use settings::Settings;

pub use clock::{RevolutionClock, RevolutionTime, SLOWER};
pub use device::WireError;
pub use error::RotaryError;
pub use lidar::RotaryLidar;
pub use revolution::{Mount, Revolution, circle};
pub use sample::{Event, Sample};
pub use settings::Place;
