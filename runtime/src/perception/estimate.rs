//! What perception says about one picture.

use hal::DepthMap;
use serde::{Deserialize, Serialize};

/// Depth and how far to trust it, pixel by pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthEstimate {
    /// z-depth in metres, 0 where there is none.
    pub depth: DepthMap,
    /// Trust in each depth, 0 to 1, row-major; exactly 0 where there is no depth.
    pub confidence: Vec<f32>,
}

impl DepthEstimate {
    /// No depth anywhere.
    #[must_use]
    pub fn none(width: usize, height: usize) -> Self {
        Self { depth: DepthMap::none(width, height), confidence: vec![0.0; width * height] }
    }

    /// Forgets everything, keeps the memory.
    pub fn clear(&mut self) {
        self.depth.clear();
        self.confidence.fill(0.0);
    }
}

/// Why a picture has no depth at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum NoDepth {
    /// No picture came with this tick.
    NoFrame,
    /// No earlier picture yet.
    FirstFrame,
    /// The robot has not moved far enough from any earlier picture that still overlaps: standing still or pure rotation.
    TooLittleParallax,
    /// The pose jumped further than the robot can drive; earlier pictures were forgotten.
    PoseJump,
    /// The pose holds NaN or infinity.
    PoseNotFinite,
    /// The picture has another size than the camera model.
    FrameSize,
    /// The picture has no texture to match: black, saturated or blank.
    NoTexture,
    /// The robot has moved, but the picture is the one before to the last bit: the camera is frozen.
    SamePicture,
    /// The network failed or its output holds NaN or leaves the allowed range.
    NetworkOutput,
}
