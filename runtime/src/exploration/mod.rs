//! Exploration policies: which motion primitive the robot drives next.
//!
//! [`Explorer::step`] answers this once per tick from the pose, the occupancy map and the newest
//! single-frame maps. The goal-driven policies choose a goal (a frontier or an inconsistent place),
//! plan a path to it with [`crate::planning`], follow the path, and give the goal up when it is
//! blocked, unreachable or takes too long. Every choice and every dropped goal is reported as an
//! event with its reason. The blind policies are the paper's baselines: they use only the bumper.
//!
//! | file | what it answers |
//! |---|---|
//! | `explorer.rs` | what is the next step of this policy? |
//! | `navigator.rs` | which places can be reached, and what is the path to a place? |
//! | `choose.rs` | which candidate is the best goal? |
//! | `unseen.rs` | how much unknown floor might be seen from a place? |
//! | `goal.rs` | is the robot making progress towards its goal? |
//! | `blacklist.rs` | which places were given up recently? |
//! | `ending.rs` | has all floor that can be reached been seen? |
//! | `errand.rs` | what is the next step towards a place where the robot shall stand? |
//! | `blind.rs` | what is the next step of a policy without a map? |
//! | `pattern.rs` | what is the next step of the drive for a calibration? |

mod blacklist;
mod blind;
mod choose;
mod config;
mod ending;
mod errand;
#[cfg(test)]
mod errand_tests;
mod explorer;
mod goal;
mod navigator;
mod observations;
mod pattern;
mod unseen;

pub use blacklist::Blacklist;
pub use blind::BlindPolicy;
pub use config::{ExplorationConfig, GoalChoice, PolicyKind};
pub use explorer::Explorer;
pub use goal::Goal;
pub use observations::Observations;
