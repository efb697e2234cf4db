//! What keeps the robot from harm: the state machine between every wish and the wheels.

mod config;
mod control;
mod footprint;
mod plane;
mod rear;
mod state;
mod surroundings;

pub use config::{BodySector, SafetyConfig, SafetySection};
pub use control::{Orders, SafetyLoop, Turn};
pub use footprint::Footprint;
pub use plane::SafetyPlane;
pub use state::{BackOff, Escape, Plan, Request, SafetyInput, SafetyOutput, SafetyState};
pub use surroundings::{Obstacle, ScanHealth, Surroundings};

#[cfg(test)]
mod orders_tests;
