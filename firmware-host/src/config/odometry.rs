//! The odometry of a simulated robot: with or without errors.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// How wrong a simulated robot's odometry is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Odometry {
    /// With the errors of an ordinary base: noise, drift, a wrong wheel radius and track, slip.
    #[default]
    Realistic,
    /// Without error. Tests only; no real robot has it.
    Perfect,
}

hal::choices!(Odometry: "realistic", "perfect");
