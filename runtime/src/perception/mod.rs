//! From pictures and known ego-motion to depth.

mod estimate;
pub mod network;

pub use estimate::{DepthEstimate, NoDepth};
pub use network::{DepthNetwork, NetworkError, NetworkOptions};
