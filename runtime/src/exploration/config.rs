//! How goals are chosen and given up.

use serde::{Deserialize, Serialize};

/// An exploration policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// Drives forward, rotates left or rotates right, chosen at random in every frame. The paper's weakest baseline.
    Random,
    /// Random arcs of 16 steps: the warm-up of the paper's released code.
    Heuristic,
    /// Drives straight on, and rotates 10 degrees to the right after a collision.
    Forward,
    /// Drives to where free floor meets unknown space.
    Frontier,
    /// Drives to where two observations of the same place disagree.
    Inconsistency,
    /// Alternates between frontiers and inconsistencies: the paper's policy.
    Active,
    /// Explores nothing: rotates, stops and drives to and fro on 2 x 2 m, for `calibrate`.
    Calibration,
}

impl PolicyKind {
    /// Every policy, the one with the weakest expected coverage first.
    pub const ALL: [Self; 7] = [
        Self::Calibration,
        Self::Random,
        Self::Heuristic,
        Self::Forward,
        Self::Inconsistency,
        Self::Frontier,
        Self::Active,
    ];

    /// Whether it drives along planned paths only, and so can keep out of areas.
    #[must_use]
    pub fn plans_paths(self) -> bool {
        match self {
            Self::Random | Self::Heuristic | Self::Forward | Self::Calibration => false,
            Self::Frontier | Self::Inconsistency | Self::Active => true,
        }
    }

    /// The name on the command line and in the summary.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Heuristic => "heuristic",
            Self::Forward => "forward",
            Self::Frontier => "frontier",
            Self::Inconsistency => "inconsistency",
            Self::Active => "active",
            Self::Calibration => "calibration",
        }
    }
}

/// How a frontier is chosen among several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalChoice {
    /// Prefers the frontier from which most unknown floor might be seen for every metre of path to it.
    #[default]
    Unseen,
    /// Prefers frontiers that are near, long and ahead of the robot.
    Nearest,
    /// Chooses at random, with a probability proportional to the distance (the paper's released code).
    Paper,
}

hal::choices!(GoalChoice: "unseen", "nearest", "paper");

hal::settings! {
    /// How the goal-driven policies choose goals and give them up.
    #[derive(Copy)]
    pub struct ExplorationConfig {
        /// Frames of the policy `heuristic` before the chosen policy begins. All policies then start from the same recording,
        /// so that a comparison of policies compares nothing else (the paper's code warms up only its goal-driven policies).
        warm_up_frames: u64 = 0, in 0..=10000000, unit "frames", source "paper: 6000";
        /// Frames that `active` spends on frontiers before it changes to inconsistencies.
        frontier_frames: u64 = 800, in 1..=1000000, unit "frames", source "paper";
        /// Frames that `active` spends on inconsistencies before it changes to frontiers.
        inconsistency_frames: u64 = 400, in 1..=1000000, unit "frames", source "paper";
        /// Frames between the two observations whose disagreement is a goal.
        inconsistency_gap: usize = 5, in 1..=1000, unit "frames", source "paper's code";
        /// Which frontier becomes the goal: the one from which most unknown floor might be seen for every metre of path (`unseen`), a near,
        /// long one ahead of the robot (`nearest`), or one at random, distant ones more often (`paper`).
        goal_choice: GoalChoice = GoalChoice::Unseen;
        /// A goal is reached within this distance.
        goal_reached_m: f64 = 0.25, in 0.05..=5.0, unit "m";
        /// A goal is given up if the robot has not come nearer to it for this long.
        progress_timeout_s: f64 = 30.0, in 1.0..=3600.0, unit "s", source "explore_lite (ROS)";
        /// A goal is given up after this long in any case.
        goal_timeout_s: f64 = 180.0, in 1.0..=3600.0, unit "s";
        /// A goal is given up after the bumper has tripped this often on the path to it.
        trips_per_goal: u32 = 3, in 1..=1000, unit "trips";
        /// A goal that was given up is not chosen again for this long.
        blacklist_expiry_s: f64 = 120.0, in 1.0..=86400.0, unit "s";
        /// Goals this near to one that was given up are not chosen either.
        blacklist_radius_m: f64 = 0.5, in 0.0..=10.0, unit "m";
        /// Whether the robot drives back to where the run began, and stands there, when all floor that it can reach has been seen.
        /// Without it the robot continues to observe known places.
        return_to_start: bool = false;
        /// The path to the goal is checked against the map once in this many ticks.
        replan_ticks: u64 = 10, in 1..=1000, unit "ticks";
        /// When no frontier can be reached, the planner ignores obstacles with at most these log-odds: they were observed
        /// rarely or long ago (an obstacle observed in every frame has 100, and a tenth of that 110 frames later), and
        /// driving near them shows whether they are still there. 0 never ignores an obstacle.
        doubtful_log_odds: f32 = 5.0, in 0.0..=1000.0, unit "log-odds";
    }
}
