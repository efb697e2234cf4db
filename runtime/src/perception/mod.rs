//! From pictures and known ego-motion to depth.

mod aggregate;
mod belief;
mod census;
mod coarse;
mod config;
mod enlarge;
mod estimate;
pub mod flow;
mod fusion;
mod keyframes;
pub mod least_squares;
mod motion;
mod moving;
pub mod network;
mod refine;
mod steady;
mod subpixel;
pub mod surround;
mod sweep;
#[cfg(test)]
mod test_scene;
pub mod trust;
mod winner;

pub use belief::Belief;
pub use coarse::CoarseDepth;
pub use config::{CoarseConfig, PerceptionError};
pub use estimate::{DepthEstimate, NoDepth};
pub use network::{DepthNetwork, FlowNetwork, InputKind, NetworkError, NetworkOptions, Provider};
pub use winner::Vote;
