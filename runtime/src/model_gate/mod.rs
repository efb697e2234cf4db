//! May this model drive the robot? Decisions only: who calls reads files, starts processes and measures time.
//!
//! | file | question |
//! |---|---|
//! | `held_out.rs` | which pictures is no model ever trained on? |
//! | `onnx_file.rs` | is the file what a model may be: known opset, no data outside? |
//! | `lidar_line.rs` | how far is what the safety LiDAR sees in the picture? |
//! | `photometric.rs` | do earlier pictures, moved by the model's depth, look like this one? |
//! | `score.rs` | how good is one model's depth of one picture? |
//! | `paired.rs` | is one model worse than the other on the same pictures, or is that chance? |
//! | `verdict.rs` | is it taken? |
//! | `trial.rs` | does it stay? |
//!
//! Nothing here uses ground truth: pictures, wheels and the safety LiDAR are what a robot in a home has.

mod held_out;
mod lidar_line;
mod onnx_file;
mod paired;
mod photometric;
mod score;
mod trial;
mod verdict;

pub use held_out::{HeldOutRule, PoseBin};
pub use lidar_line::{LidarView, LinePoint};
pub use onnx_file::{OPSETS, OnnxFault, check_onnx_file};
pub use paired::{Paired, compare};
pub use photometric::{Photometric, Source};
pub use score::{
    FrameScore, LineScore, PARALLAX_BINS_PX, Scorer, line_score, parallax_bin, parallax_px,
};
pub use trial::{Trial, TrialCounts, TrialLimits, TrialState, TrialTurn, TrialVerdict};
pub use verdict::{Examination, GateLimits, Latency, Measure, ScoredFrame, Verdict, Why, judge};
