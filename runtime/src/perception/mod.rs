//! From pictures and known ego-motion to depth.

mod estimate;

pub use estimate::{DepthEstimate, NoDepth};
