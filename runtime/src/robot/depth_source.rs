//! Where the depth that goes into the map comes from.

use serde::{Deserialize, Serialize};

use crate::perception::DenseConfig;

/// Where the depth that goes into the map comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthSource {
    /// Triangulated from known ego-motion; needs no model.
    Coarse,
    /// Dense depth, as far as a map may believe it (`perception/map_depth.rs`).
    Dense,
    /// The depth network.
    Network,
    /// Ground truth: only to test mapping, planning and policies apart from depth.
    Truth,
}

impl DepthSource {
    pub const ALL: [Self; 4] = [Self::Coarse, Self::Dense, Self::Network, Self::Truth];

    /// The depth that goes into the map of a robot without a network.
    #[must_use]
    pub fn without_network(dense: &DenseConfig) -> Self {
        if dense.enabled { Self::Dense } else { Self::Coarse }
    }

    /// The name on the command line, in the summary and in recordings.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Coarse => "coarse",
            Self::Dense => "dense",
            Self::Network => "network",
            Self::Truth => "truth",
        }
    }

    /// The source with this [`name`](Self::name).
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|source| source.name() == name)
    }

    /// What it is, for the help of the command line.
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::Coarse => {
                "Coarse depth, triangulated between frames from the known motion of the robot"
            }
            Self::Dense => {
                "Dense depth: for each pixel the most probable of coarse depth, depth that was observed earlier, and the walls and the floor that the scan shows"
            }
            Self::Network => "The output of the depth network",
            Self::Truth => {
                "Ground truth of the simulator, to test mapping and planning only; no real robot has it"
            }
        }
    }
}
