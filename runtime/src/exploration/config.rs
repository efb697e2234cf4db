//! How goals are chosen and given up.

use serde::{Deserialize, Serialize};

/// A way of exploring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// Forward, left or right at random, every frame anew. The paper's weakest baseline.
    Random,
    /// Random arcs of 16 steps: the paper's released warm-up.
    Heuristic,
    /// Straight on, 10 degrees to the right after a collision.
    Forward,
    /// To where free floor meets the unknown.
    Frontier,
    /// To where two looks at the same place disagree.
    Inconsistency,
    /// Frontier and inconsistency by turns: the paper's policy.
    Active,
}

impl PolicyKind {
    /// Every policy, weakest expected coverage first.
    pub const ALL: [Self; 6] = [
        Self::Random,
        Self::Heuristic,
        Self::Forward,
        Self::Inconsistency,
        Self::Frontier,
        Self::Active,
    ];

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
        }
    }
}

/// How one frontier is preferred to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalChoice {
    /// Near, large and ahead first.
    #[default]
    Nearest,
    /// At random, with probability proportional to the distance (the paper's released code).
    Paper,
}

/// Numbers of the goal-driven policies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExplorationConfig {
    /// Frames of `heuristic` before the policy itself begins. All policies then start from the same recording, so that a
    /// comparison of them compares nothing else (the paper's code warms up only its goal-driven policies so).
    pub warm_up_frames: u64,
    /// Frames on frontiers before `active` turns to inconsistencies (800 in the paper).
    pub frontier_frames: u64,
    /// Frames on inconsistencies before `active` turns to frontiers (400 in the paper).
    pub inconsistency_frames: u64,
    /// Frames between the two looks whose disagreement is a goal (5 in the paper's released code).
    pub inconsistency_gap: usize,
    /// How a frontier is chosen.
    pub goal_choice: GoalChoice,
    /// A goal is reached within this distance, metres.
    pub goal_reached_m: f64,
    /// A goal is given up without progress for this long, seconds (30 in explore_lite).
    pub progress_timeout_s: f64,
    /// A goal is given up after this long in any case, seconds.
    pub goal_timeout_s: f64,
    /// A goal is given up after this many bumper trips.
    pub trips_per_goal: u32,
    /// A given-up goal is left alone for this long, seconds.
    pub blacklist_expiry_s: f64,
    /// Goals this near to a given-up one count as the same, metres.
    pub blacklist_radius_m: f64,
    /// Ticks between two looks at the way.
    pub replan_ticks: u64,
    /// When no frontier can be reached, marks with at most these log-odds left are in nobody's way: they were seen seldom or
    /// long ago (a mark that is seen in every frame has 100, and a tenth of that 110 frames later), and going near shows
    /// whether they are still there. 0 always believes them.
    pub doubtful_log_odds: f32,
}

impl Default for ExplorationConfig {
    fn default() -> Self {
        Self {
            warm_up_frames: 0,
            frontier_frames: 800,
            inconsistency_frames: 400,
            inconsistency_gap: 5,
            goal_choice: GoalChoice::Nearest,
            goal_reached_m: 0.25,
            progress_timeout_s: 30.0,
            goal_timeout_s: 180.0,
            trips_per_goal: 3,
            blacklist_expiry_s: 120.0,
            blacklist_radius_m: 0.5,
            replan_ticks: 10,
            doubtful_log_odds: 5.0,
        }
    }
}
