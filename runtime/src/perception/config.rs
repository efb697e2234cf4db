//! Settings of the coarse engine.

use serde::{Deserialize, Serialize};

use super::sweep::MAX_REFERENCES;

/// Settings of [`CoarseDepth`](super::CoarseDepth). The defaults suit a robot with a 90 degree camera of 640x192 pixels and
/// a handheld camera alike, because references are chosen by the parallax that they promise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CoarseConfig {
    /// Nearest depth that is looked for, metres.
    pub min_depth_m: f64,
    /// Farthest depth that is looked for, metres.
    pub max_depth_m: f64,
    /// Parallax that each reference should promise for the depth of the scene, in full-size pixels; one
    /// reference for each, at most three. A short one is unambiguous and sees the same things, a long one is precise.
    pub parallax_px: Vec<f64>,
    /// What rotations of the pose are wrong by, as a share of the turn between two pictures (odometry, timing, shutter) ...
    pub turn_error: f64,
    /// ... and at least, radians.
    pub turn_error_floor_rad: f64,
    /// A reference must promise this many times the parallax that its rotation error would fake. At 5, one standard
    /// deviation of error is a depth that is wrong by a fifth.
    pub parallax_over_error: f64,
    /// Whether the rotation of every reference is corrected by looking at the pictures.
    pub refine_rotation: bool,
    /// Whether the rotation of every pose is steadied by what is seen from picture to picture.
    pub steady_rotation: bool,
    /// Whether things that move by themselves are looked for; they get no depth.
    pub find_moving: bool,
    /// A reference nearer than this has more pose error than parallax, metres.
    pub min_baseline_m: f64,
    /// A reference farther than this sees another scene, metres.
    pub max_baseline_m: f64,
    /// Share of the picture that a reference must see too.
    pub min_overlap: f64,
    /// A picture becomes a keyframe when it is this far from the last one, metres ...
    pub keyframe_step_m: f64,
    /// ... or turned by this angle, radians.
    pub keyframe_turn_rad: f64,
    /// How many keyframes are remembered.
    pub keyframes: usize,
    /// Motion between two pictures that no robot makes: the pose jumped, metres.
    pub max_step_m: f64,
    /// The same for turning, radians.
    pub max_turn_rad: f64,
    /// Smoothness: cost of a neighbour in the same column one hypothesis away (less across columns; see
    /// [`aggregate`](super::aggregate)); a hypothesis in which every bit differs costs 96.
    pub penalty_small: i16,
    /// Smoothness: cost of a neighbour farther away where the picture is flat; less across edges.
    pub penalty_large: i16,
    /// Share of its evidence that a remembered depth keeps from one picture to the next; 0 remembers nothing.
    pub memory: f32,
    /// Probability that one picture's vote is right: weights of a constant, margin, logarithms of parallax and texture, and
    /// misfit in a logistic model; see [`trust`](super::trust).
    pub vote_weights: [f32; 5],
    /// Probability that what is remembered is right: weights of a constant, the mean trust of its votes, the logarithm of their
    /// number, the mean trust around it and whether its neighbours agree; see [`surround`](super::surround).
    pub belief_weights: [f32; 5],
    /// Pixels that are less probably right than this are marked as having no depth. At 0.6 a kitchen with white walls, on which
    /// confidence was not fitted, has 80 % of what is left right; at even odds 78 %.
    pub min_confidence: f32,
    /// Without any reference (turning on the spot), the remembered depth is handed out while it covers this share of the
    /// picture.
    pub min_remembered: f32,
}

impl Default for CoarseConfig {
    fn default() -> Self {
        Self {
            min_depth_m: 0.3,
            max_depth_m: 20.0,
            parallax_px: vec![6.0, 16.0, 40.0],
            turn_error: 0.02,
            turn_error_floor_rad: 0.001,
            parallax_over_error: 5.0,
            refine_rotation: true,
            steady_rotation: true,
            find_moving: true,
            min_baseline_m: 0.02,
            max_baseline_m: 1.0,
            min_overlap: 0.6,
            keyframe_step_m: 0.02,
            keyframe_turn_rad: 0.05,
            keyframes: 48,
            max_step_m: 0.5,
            max_turn_rad: 0.8,
            penalty_small: 24,
            penalty_large: 160,
            memory: 0.92,
            vote_weights: [-0.99, 5.47, 0.36, 0.28, -0.06],
            belief_weights: [-3.57, 1.3, 0.87, 3.35, 1.99],
            min_confidence: 0.6,
            min_remembered: 0.3,
        }
    }
}

/// The engine cannot work like this.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PerceptionError {
    /// An impossible setting.
    #[error("perception: {field} = {value} is impossible; allowed: {allowed}")]
    Setting {
        /// The field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        allowed: &'static str,
    },
    /// A flow field does not belong to the camera.
    #[error(
        "perception: the flow is {width}x{height}, the camera {want_width}x{want_height}; resample the flow"
    )]
    FlowSize {
        /// Columns of the flow.
        width: usize,
        /// Rows of the flow.
        height: usize,
        /// Columns of the camera.
        want_width: usize,
        /// Rows of the camera.
        want_height: usize,
    },
    /// The search for moving things cannot work.
    #[error(transparent)]
    Flow(super::flow::FlowError),
    /// The camera cannot be used.
    #[error("perception: the camera {width}x{height} (fx {fx}, fy {fy}) cannot be used: {why}")]
    Camera {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Focal length along x, pixels.
        fx: f64,
        /// Focal length along y, pixels.
        fy: f64,
        /// Why.
        why: &'static str,
    },
}

impl From<super::flow::FlowError> for PerceptionError {
    fn from(error: super::flow::FlowError) -> Self {
        Self::Flow(error)
    }
}

impl CoarseConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the field, its value and what it may be.
    pub fn validate(&self) -> Result<(), PerceptionError> {
        let positive = "a finite number above 0";
        let ok = |v: f64| v.is_finite() && v > 0.0;
        require("min_depth_m", self.min_depth_m, ok(self.min_depth_m), positive)?;
        let deep = ok(self.max_depth_m) && self.max_depth_m > self.min_depth_m;
        require("max_depth_m", self.max_depth_m, deep, "a finite number above min_depth_m")?;
        let parallax = (1..=MAX_REFERENCES).contains(&self.parallax_px.len())
            && self.parallax_px.iter().all(|p| ok(*p));
        require(
            "parallax_px",
            format!("{:?}", self.parallax_px),
            parallax,
            "one to three finite numbers above 0",
        )?;
        let error = "0 or a finite number above 0";
        let not_negative = |v: f64| v.is_finite() && v >= 0.0;
        require("turn_error", self.turn_error, not_negative(self.turn_error), error)?;
        require(
            "turn_error_floor_rad",
            self.turn_error_floor_rad,
            not_negative(self.turn_error_floor_rad),
            error,
        )?;
        require(
            "parallax_over_error",
            self.parallax_over_error,
            not_negative(self.parallax_over_error),
            error,
        )?;
        require("min_baseline_m", self.min_baseline_m, ok(self.min_baseline_m), positive)?;
        let far = ok(self.max_baseline_m) && self.max_baseline_m >= self.min_baseline_m;
        require(
            "max_baseline_m",
            self.max_baseline_m,
            far,
            "a finite number, min_baseline_m or more",
        )?;
        require(
            "min_overlap",
            self.min_overlap,
            (0.0..=1.0).contains(&self.min_overlap),
            "0 to 1",
        )?;
        require("keyframe_step_m", self.keyframe_step_m, ok(self.keyframe_step_m), positive)?;
        require("keyframe_turn_rad", self.keyframe_turn_rad, ok(self.keyframe_turn_rad), positive)?;
        require("keyframes", self.keyframes, (1..=256).contains(&self.keyframes), "1 to 256")?;
        require("max_step_m", self.max_step_m, ok(self.max_step_m), positive)?;
        require("max_turn_rad", self.max_turn_rad, ok(self.max_turn_rad), positive)?;
        require(
            "penalty_small",
            self.penalty_small,
            (0..=200).contains(&self.penalty_small),
            "0 to 200",
        )?;
        let large = (self.penalty_small..=1000).contains(&self.penalty_large);
        require("penalty_large", self.penalty_large, large, "penalty_small to 1000")?;
        require("memory", self.memory, (0.0..1.0).contains(&self.memory), "0 to below 1")?;
        let weights = self.vote_weights.iter().chain(&self.belief_weights).all(|w| w.is_finite());
        let all = format!("{:?} and {:?}", self.vote_weights, self.belief_weights);
        require("vote_weights and belief_weights", all, weights, "finite numbers")?;
        require(
            "min_remembered",
            self.min_remembered,
            (0.0..=1.0).contains(&self.min_remembered),
            "0 to 1",
        )?;
        require(
            "min_confidence",
            self.min_confidence,
            (0.0..1.0).contains(&self.min_confidence),
            "0 to below 1",
        )
    }
}

// By value: every caller has a number at hand.
#[allow(clippy::needless_pass_by_value)]
fn require(
    field: &'static str,
    value: impl std::fmt::Display,
    sound: bool,
    allowed: &'static str,
) -> Result<(), PerceptionError> {
    if sound {
        Ok(())
    } else {
        Err(PerceptionError::Setting { field, value: value.to_string(), allowed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_sound() {
        assert_eq!(CoarseConfig::default().validate(), Ok(()));
    }

    #[test]
    fn impossible_values_are_refused_by_name() {
        let good = CoarseConfig::default;
        for (bad, name) in [
            (CoarseConfig { min_depth_m: f64::NAN, ..good() }, "min_depth_m"),
            (CoarseConfig { max_depth_m: 0.2, ..good() }, "max_depth_m"),
            (CoarseConfig { parallax_px: vec![6.0, 0.0, 24.0], ..good() }, "parallax_px"),
            (CoarseConfig { turn_error: -0.1, ..good() }, "turn_error"),
            (CoarseConfig { memory: f32::NAN, ..good() }, "memory"),
            (CoarseConfig { min_overlap: 1.5, ..good() }, "min_overlap"),
            (CoarseConfig { penalty_large: 1, ..good() }, "penalty_large"),
        ] {
            assert!(bad.validate().unwrap_err().to_string().contains(name));
        }
    }

    #[test]
    fn unknown_settings_are_refused() {
        let error =
            serde_json::from_str::<CoarseConfig>(r#"{"penalty_smal": 6}"#).unwrap_err().to_string();
        assert!(error.contains("penalty_smal`") && error.contains("penalty_small"), "{error}");
    }
}
