//! The model gate: decides whether a depth model may drive the robot. This module only decides; the
//! caller reads files, starts processes and measures time.
//!
//! | file | question |
//! |---|---|
//! | `held_out.rs` | which frames is no model ever trained on? |
//! | `onnx_file.rs` | may this file be loaded: known opset, all weights inside? |
//! | `lidar_pixels.rs` | which depth does the safety LiDAR measure at which pixels of a frame? |
//! | `lost_obstacles.rs` | which obstacles near the robot, seen by coarse depth, does the depth lose? |
//! | `photometric.rs` | do earlier frames, warped by the model's depth, match this frame? |
//! | `score.rs` | how good is one model's depth of one frame? |
//! | `paired.rs` | is one model worse than the other on the same frames, or is the difference chance? |
//! | `verdict.rs` | is the candidate accepted? |
//! | `trial.rs` | is the accepted model kept after it has driven the robot? |
//!
//! No ground truth is used: a robot in a home has only its frames, wheel odometry and safety LiDAR.

mod held_out;
mod lidar_pixels;
mod lost_obstacles;
mod onnx_file;
mod paired;
mod photometric;
mod score;
mod trial;
mod verdict;

pub use held_out::{HeldOutRule, PoseBin};
pub use lidar_pixels::{LidarPixel, LidarView};
pub use lost_obstacles::{LostObstacles, LostShares, NearRange};
pub use onnx_file::{OPSETS, OnnxFault, check_onnx_file};
pub use paired::{Paired, compare};
pub use photometric::{Photometric, Source};
pub use score::{
    FrameScore, LidarScore, PARALLAX_BINS_PX, Scorer, lidar_score, parallax_bin, parallax_px,
};
pub use trial::{FrameMean, Trial, TrialCounts, TrialLimits, TrialState, TrialTick, TrialVerdict};
pub use verdict::{
    Examination, GateLimits, Latency, Measure, NearEvidence, RefusalReason, ScoredFrame, Verdict,
    judge,
};
