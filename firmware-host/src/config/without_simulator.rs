//! The section `[simulator]` of a program without the simulator: read, so that the same file and recordings of simulated runs work
//! on the robot, and otherwise ignored.

use hal::settings::{ConfigValue, Kind};
use serde::{Deserialize, Serialize};

/// The section as it was read from the file, without interpretation.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SimulatorSection(serde_json::Map<String, serde_json::Value>);

impl ConfigValue for SimulatorSection {
    const KIND: Kind = Kind::Other("a table that only `explore` uses");
}
