//! Where to go next: the policies.

mod blacklist;
mod blind;
mod choose;
mod config;
mod explorer;
mod goal;
mod navigator;

pub use blacklist::Blacklist;
pub use blind::BlindPolicy;
pub use config::{ExplorationConfig, GoalChoice, PolicyKind};
pub use explorer::{Explorer, Senses};
pub use goal::Goal;
