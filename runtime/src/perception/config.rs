//! Settings of the coarse-depth engine, and what can be wrong with them.

use hal::settings::OutOfRange;

use super::Provider;
use super::sweep::MAX_REFERENCES;

hal::choices!(Provider: "cpu", "xnnpack", "cuda", "tensorrt");

hal::settings! {
    /// Coarse depth from the robot's own motion. References are chosen by the parallax that they promise, so the defaults
    /// suit a robot with a 90 degree camera of 640x192 pixels and a handheld camera alike.
    pub struct CoarseConfig {
        /// Smallest depth of the search.
        min_depth_m: f64 = 0.3, in 0.05..=10.0, unit "m";
        /// Largest depth of the search.
        max_depth_m: f64 = 20.0, in 0.5..=100.0, unit "m", source "paper";
        /// Parallax that each reference should promise at the depth of the scene, in full-size pixels; one to three
        /// references, one for each number. A short parallax is unambiguous and has the same scene content, a long one is
        /// precise.
        parallax_px: Vec<f64> = vec![6.0, 16.0, 40.0], in 0.5..=200.0, unit "pixels";
        /// Error of the pose's rotation as a fraction of the rotation between two frames (odometry, timing, shutter).
        turn_error: f64 = 0.02, in 0.0..=1.0;
        /// Smallest error that is assumed of the pose's rotation.
        turn_error_floor_rad: f64 = 0.001, in 0.0..=0.1, unit "rad";
        /// A reference must promise this many times the parallax that an error of its rotation would imitate. At 5, one
        /// standard deviation of that error changes a depth by a fifth.
        parallax_over_error: f64 = 5.0, in 0.0..=100.0;
        /// Whether the images correct the rotation of every reference.
        refine_rotation: bool = true;
        /// Whether the rotation between consecutive images filters the jitter out of every pose.
        steady_rotation: bool = true;
        /// Whether the engine searches for objects that move. They get no depth.
        find_moving: bool = true;
        /// A nearer reference has more pose error than parallax.
        min_baseline_m: f64 = 0.02, in 0.001..=1.0, unit "m";
        /// A reference further away shows another scene.
        max_baseline_m: f64 = 1.0, in 0.01..=10.0, unit "m";
        /// Fraction of the image that a reference must show too.
        min_overlap: f64 = 0.6, in 0.0..=1.0;
        /// A frame becomes a keyframe when it is this far from the last keyframe ...
        keyframe_step_m: f64 = 0.02, in 0.001..=1.0, unit "m";
        /// ... or rotated by this angle.
        keyframe_turn_rad: f64 = 0.05, in 0.001..=1.0, unit "rad";
        /// Number of keyframes that are kept.
        keyframes: usize = 48, in 1..=256, unit "keyframes";
        /// A larger distance between two frames is no motion of a robot: the pose has jumped.
        max_step_m: f64 = 0.5, in 0.01..=10.0, unit "m";
        /// A larger rotation between two frames is no motion of a robot: the pose has jumped.
        max_turn_rad: f64 = 0.8, in 0.01..=3.2, unit "rad";
        /// P1 of semi-global matching: cost of a neighbour one hypothesis away in the same column; a quarter of it along a
        /// row. A hypothesis in which every bit differs costs 96.
        penalty_small: i16 = 24, in 0..=200;
        /// P2 of semi-global matching: cost of a neighbour further away where the image is flat; less across edges.
        penalty_large: i16 = 160, in 0..=1000;
        /// Fraction of its evidence that a depth keeps from one frame to the next. 0 keeps nothing.
        memory: f32 = 0.92, in 0.0..=0.99;
        /// Logistic model of the probability that the vote of one frame is correct: weights of a constant, the margin, the
        /// logarithms of parallax and texture, and the misfit.
        vote_weights: [f32; 5] = [-0.99, 5.47, 0.36, 0.28, -0.06], in -100.0..=100.0,
            source "cargo xtask accuracy --fit";
        /// Logistic model of the probability that a depth in memory is correct: weights of a constant, the mean confidence
        /// of its votes, the logarithm of their number, the mean confidence around it, and the agreement of its neighbours.
        belief_weights: [f32; 5] = [-3.57, 1.3, 0.87, 3.35, 1.99], in -100.0..=100.0,
            source "cargo xtask accuracy --fit";
        /// Pixels with a lower probability of being correct are marked as having no depth. At 0.6, 80 % of the remaining
        /// depth is correct in a kitchen with white walls, on which the confidence was not fitted; at 0.5 it is 78 %.
        min_confidence: f32 = 0.6, in 0.0..=0.99;
        /// Without any reference (a robot that rotates in place), the depth in memory is used while it covers this fraction
        /// of the image.
        min_remembered: f32 = 0.3, in 0.0..=1.0;
    }
}

hal::settings! {
    /// Dense depth: coarse depth, completed by what was seen before and by the cells around.
    pub struct DenseConfig {
        /// Whether dense depth is computed. If it is, the map of a robot without a network uses it, else coarse depth.
        enabled: bool = true;
        /// A frame is put into the voxel map when the camera is this far from the last one that was.
        learn_step_m: f64 = 0.05, in 0.01..=1.0, unit "m";
        /// Depths with a lower probability of being correct are not put into the voxel map.
        learn_confidence: f32 = 0.7, in 0.0..=0.99;
        /// Logistic model of the probability that a recalled depth is correct: weights as in `coarse.belief_weights`.
        recall_weights: [f32; 5] = [-5.26, 2.02, 0.80, 3.50, 2.19], in -100.0..=100.0,
            source "cargo xtask accuracy --fit-dense";
        /// Logistic model where there are coarse and recalled depth: weights of a constant, the logit of the more probable one,
        /// the logit of the other one when it agrees and when it does not, and the agreement.
        joint_weights: [f32; 5] = [-0.82, 0.83, 0.45, 0.07, 0.86], in -100.0..=100.0,
            source "cargo xtask accuracy --fit-dense";
        /// Logistic model of the probability that a filled depth is correct: weights of a constant, the logarithm of the cost of
        /// the path from the nearest known cell, and the spread of the values from all sides.
        fill_weights: [f32; 3] = [2.27, -0.78, -4.63], in -100.0..=100.0, source "cargo xtask accuracy --fit-dense";
        /// Whether the safety LiDAR's scan is used, too: in front of what it hit there is floor, and a wall stands above it.
        walls: bool = true;
        /// Logistic model of the probability that such a wall or floor is correct: weights of a constant, the logit of the share
        /// of the cells around that agree with their walls, and whether it is floor.
        wall_weights: [f32; 3] = [0.12, 1.45, 1.16], in -100.0..=100.0, source "cargo xtask accuracy --fit-dense";
        /// Logistic model where there are a depth that was seen and a wall: weights as in `joint_weights`.
        seen_wall_weights: [f32; 5] = [-0.45, 0.73, 0.43, -0.12, 0.27], in -100.0..=100.0,
            source "cargo xtask accuracy --fit-dense";
        /// Logistic model where there are a filled depth and a wall: weights as in `joint_weights`.
        filled_wall_weights: [f32; 5] = [0.47, 0.57, 0.43, 0.18, 0.68], in -100.0..=100.0,
            source "cargo xtask accuracy --fit-dense";
        /// Whether a small network chooses among coarse, recalled and filled depth and walls where there is a scan, after the
        /// logistic models. The map takes what both agree on.
        choice: bool = true, source "cargo xtask accuracy --fit-choice";
    }
}

/// Why the engine cannot work with its configuration or its input.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PerceptionError {
    /// A setting is not allowed.
    #[error("perception: {field} = {value} is not allowed; allowed: {allowed}")]
    Setting {
        field: &'static str,
        value: String,
        /// The values that are allowed.
        allowed: &'static str,
    },
    /// The optical flow, which the search for moving objects needs, cannot be computed.
    #[error(transparent)]
    Flow(super::flow::FlowError),
    /// The camera cannot be used.
    #[error("perception: the camera {width}x{height} (fx {fx}, fy {fy}) cannot be used: {why}")]
    Camera {
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
        /// Horizontal focal length in pixels.
        fx: f64,
        /// Vertical focal length in pixels.
        fy: f64,
        why: &'static str,
    },
}

impl From<super::flow::FlowError> for PerceptionError {
    fn from(error: super::flow::FlowError) -> Self {
        Self::Flow(error)
    }
}

impl From<OutOfRange> for PerceptionError {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        Self::Setting { field: key, value: value.to_string(), allowed }
    }
}

impl CoarseConfig {
    /// Checks every value, and the values together.
    ///
    /// # Errors
    /// Names the field, its value and the allowed values.
    pub fn validate(&self) -> Result<(), PerceptionError> {
        self.check_ranges()?;
        require(
            "max_depth_m",
            self.max_depth_m,
            self.max_depth_m > self.min_depth_m,
            "above min_depth_m",
        )?;
        require(
            "parallax_px",
            format!("{:?}", self.parallax_px),
            (1..=MAX_REFERENCES).contains(&self.parallax_px.len()),
            "one to three numbers",
        )?;
        require(
            "max_baseline_m",
            self.max_baseline_m,
            self.max_baseline_m >= self.min_baseline_m,
            "min_baseline_m or more",
        )?;
        require(
            "penalty_large",
            self.penalty_large,
            self.penalty_large >= self.penalty_small,
            "penalty_small or more",
        )
    }
}

// The value is passed by value because every caller has just computed it.
#[allow(clippy::needless_pass_by_value)]
fn require(
    field: &'static str,
    value: impl std::fmt::Display,
    is_allowed: bool,
    allowed: &'static str,
) -> Result<(), PerceptionError> {
    if is_allowed {
        Ok(())
    } else {
        Err(PerceptionError::Setting { field, value: value.to_string(), allowed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed() {
        assert_eq!(CoarseConfig::default().validate(), Ok(()));
    }

    #[test]
    fn values_that_are_not_allowed_are_refused_by_name() {
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
