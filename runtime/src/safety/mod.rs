//! What keeps the robot from harm: the bumper between every wish and the wheels.

mod bumper;
mod zone;

pub use bumper::{Bumper, BumperConfig, BumperInput, BumperOutput, BumperState};
pub use zone::{Obstacle, ScanHealth, StopZone};
