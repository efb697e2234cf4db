//! Device simulators, fault injectors and the harness of the hardware-in-the-loop tests. The
//! scenarios are in `tests/tests`. For example, a robot in a simulated home whose scanner falls
//! silent is `Scenario::new(policy, &["lidar:stall@2..3"], seed)`; its faults are injected by
//! [`drivers::fault`].
#![forbid(unsafe_code)]

// First, because its macros replace those of the standard library in the modules below.
#[macro_use]
mod output;

pub mod hokuyo;
pub mod kills;
pub mod ld06;
pub mod motor;
mod noise;
mod port;
pub mod rig;
pub mod rotary;
pub mod rplidar;
pub mod scenario;
pub mod sshd;
pub mod video;
pub mod world;

pub use noise::noise;
pub use scenario::{Scenario, Sensors, Tick, successor};

use std::ops::Range;

/// A time interval, seconds since the clock's zero.
pub type Seconds = Range<f64>;

fn holds(stretch: Option<&Seconds>, time_ns: u64) -> bool {
    stretch.is_some_and(|stretch| stretch.contains(&(time_ns as f64 * 1e-9)))
}
