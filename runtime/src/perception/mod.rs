//! From pictures and known ego-motion to depth.

mod aggregate;
mod census;
mod coarse;
mod config;
mod estimate;
mod fusion;
mod keyframes;
pub mod network;
mod refine;
mod sweep;
mod winner;

pub use coarse::CoarseDepth;
pub use config::{CoarseConfig, PerceptionError};
pub use estimate::{DepthEstimate, NoDepth};
pub use network::{DepthNetwork, NetworkError, NetworkOptions};
