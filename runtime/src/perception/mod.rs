//! Depth from camera frames and known ego-motion.
//!
//! Terms of this module:
//!
//! - **Coarse depth**: depth by multi-view matching, without a network; one value per cell ([`CoarseDepth`]).
//! - **Cell**: 4x4 pixels, the resolution at which coarse depth is computed.
//! - **Keyframe**: an earlier frame that is kept with its pose, so that later frames can be matched against it.
//! - **Reference**: a keyframe that was selected for matching with the current frame.
//! - **Sweep**: the plane sweep, which computes the matching cost of every cell at 64 inverse depths in all references.
//! - **Vote**: the winner-take-all result of one frame for one cell ([`Vote`]).
//! - **Belief**: the depth of a cell as accumulated from the votes of all frames so far ([`Belief`]).
//! - **Evidence**: the strength of a belief, the sum of the confidence of agreeing votes less that of contradicting ones.
//! - **Confidence**: the probability that a vote, a belief or a depth is right, that is, within 25 % of the true depth.
//! - **Voxel map**: sparse memory of the surfaces that were seen with confidence; depth of any view is *recalled* from it.
//! - **Dense depth**: coarse depth, completed by recalled depth, by filling and by walls above the hits of the scanner ([`DenseDepth`]).
//! - **Candidate**: a depth that a cell could have: coarse, recalled, filled, wall. The *choice* takes the most probable one (`choice.rs`).
//! - **Map depth**: what a map may believe of dense depth, which holds assumptions ([`map_depth()`]).
//! - **Motion mask**: the cells whose content moves relative to the static scene; they get no depth.

mod aggregate;
mod belief;
mod census;
pub mod choice;
mod choice_weights;
mod coarse;
pub mod confidence;
mod config;
pub mod dense;
mod estimate;
pub mod fill;
mod floor_plane;
pub mod flow;
mod frame_motion;
mod fusion;
mod keyframes;
mod map_depth;
mod motion_mask;
mod mount_equations;
pub mod network;
mod refine;
mod rotation_filter;
mod subpixel;
pub mod surround;
mod sweep;
#[cfg(test)]
mod test_scene;
mod upsample;
mod voxel_map;
mod wall_agreement;
pub mod walls;
mod wta;

pub use belief::Belief;
pub use coarse::CoarseDepth;
pub use config::{CoarseConfig, DenseConfig, PerceptionError};
pub use dense::{DenseDepth, Moment};
pub use estimate::{DepthEstimate, NoDepth};
pub use map_depth::map_depth;
pub use network::{DepthNetwork, GivenDepth, InputKind, NetworkError, NetworkOptions, Provider};
pub use rotation_filter::YawError;
pub use wta::Vote;
