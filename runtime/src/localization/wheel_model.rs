//! What wheel odometry gets wrong in the same way every time, learnt while driving.
//!
//! Unequal wheels rotate the robot a little on every metre, a wrong track scales every rotation, a wrong radius scales every
//! distance. Kalman filters with slowly changing states estimate these three numbers from what the scans say; a direction that the
//! scans say nothing about changes nothing.

use hal::Pose2;
use nalgebra::{Matrix3, Vector2};
use serde::{Deserialize, Serialize};

use super::LocalizationConfig;
use super::driven_leg::{DrivenLeg, ScanVariances};
use super::yaw_errors::{MAX_SURPRISE, YawErrors};

/// Before anything is learnt: standard deviations of the three numbers. Real robots have been seen to drift by 0.065 rad/m
/// (Intel Research Lab) and to be 5 % wrong in yaw (Freiburg, building 079).
const FIRST_DRIFT_RAD_PER_M: f64 = 0.05;
const FIRST_YAW_SCALE: f64 = 0.03;
const FIRST_DISTANCE_SCALE: f64 = 0.02;
/// How far the numbers may change on one metre or one radian: air pressure, load, floor.
const CHANGE_PER_METRE: f64 = 0.001;
/// Numbers are learnt from legs of this length, because scans say more about them: metres or radians.
const LEG: f64 = 0.3;
/// Increments of the yaw shorter than this, in metres or radians, add up like independent ones, with a tenth of the variance that the
/// configured standard deviation of a whole metre or radian has. The yaw of real wheels is better over short distances: with all of
/// that variance, the poses along the Intel log drift more until loops are closed (docs/localization.md).
const YAW_PIECE: f64 = 0.1;
/// Standard deviation of sideways motion, as a share of the distance times its noise: wheels slide little sideways.
const LATERAL_SHARE: f64 = 0.3;

/// The learnt numbers and how certain they are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct WheelModel {
    distance_noise: f64,
    yaw_noise: f64,
    drift_noise: f64,
    /// Per metre, and per radian.
    yaw: YawErrors,
    /// Metres per metre that the wheels do not report.
    distance_error: f64,
    distance_variance: f64,
    leg: Leg,
}

/// What the wheels reported since numbers were learnt last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Leg {
    /// Where the leg began according to the scans.
    from: Option<(Pose2, ScanVariances)>,
    /// Sums of reported increments: signed distance, and yaw.
    distance_m: f64,
    yaw_rad: f64,
    /// Length of the path, without signs.
    travelled: f64,
    /// The leg's end in the frame of its beginning, by the corrected wheels.
    motion: Pose2,
    /// The same as the wheels reported it.
    reported: Pose2,
}

impl Leg {
    const EMPTY: Self = Self {
        from: None,
        distance_m: 0.0,
        yaw_rad: 0.0,
        travelled: 0.0,
        motion: Pose2::IDENTITY,
        reported: Pose2::IDENTITY,
    };
}

/// A motion of the robot in its own frame, with its covariance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    pub pose: Pose2,
    pub covariance: Matrix3<f64>,
}

impl WheelModel {
    pub(crate) fn new(config: &LocalizationConfig) -> Self {
        Self {
            distance_noise: config.wheel_distance_noise,
            yaw_noise: config.wheel_yaw_noise,
            drift_noise: config.wheel_drift_rad_per_m,
            yaw: YawErrors::new([FIRST_DRIFT_RAD_PER_M, FIRST_YAW_SCALE]),
            distance_error: 0.0,
            distance_variance: FIRST_DISTANCE_SCALE * FIRST_DISTANCE_SCALE,
            leg: Leg::EMPTY,
        }
    }

    /// Corrects a reported increment `raw` (in the robot's frame) and says how uncertain it is.
    pub(crate) fn correct(&self, raw: &Pose2) -> Motion {
        let distance_m = signed_length(raw);
        let reported = Vector2::new(distance_m, raw.yaw_rad);
        let yaw_rad = raw.yaw_rad + self.yaw.unreported(&reported);
        let scale = 1.0 + self.distance_error;
        let [x_m, y_m] = bent_chord(raw, yaw_rad - raw.yaw_rad);
        let pose = Pose2::new(scale * x_m, scale * y_m, yaw_rad);
        Motion { pose, covariance: self.covariance(&reported) }
    }

    fn covariance(&self, reported: &Vector2<f64>) -> Matrix3<f64> {
        let (distance_m, yaw_rad) = (reported.x.abs(), reported.y.abs());
        let unlearnt = self.yaw.variance(reported);
        let yaw = self.drift_noise * self.drift_noise * distance_m * distance_m.max(YAW_PIECE)
            + self.yaw_noise * self.yaw_noise * yaw_rad * yaw_rad.max(YAW_PIECE)
            + unlearnt;
        // Noise adds up like that of independent pieces: its variance is proportional to the distance.
        let forward_variance = self.distance_noise * self.distance_noise * distance_m
            + distance_m * distance_m * self.distance_variance;
        let sideways = LATERAL_SHARE * self.distance_noise * distance_m + 0.01 * yaw_rad;
        let slack = 1e-8;
        Matrix3::from_diagonal(&nalgebra::Vector3::new(
            forward_variance + 1e-4 * yaw_rad * yaw_rad + slack,
            sideways * sideways + slack,
            yaw + slack,
        ))
    }

    /// Adds a reported increment to the current leg.
    pub(crate) fn drove(&mut self, raw: &Pose2) {
        let distance_m = signed_length(raw);
        self.leg.distance_m += distance_m;
        self.leg.yaw_rad += raw.yaw_rad;
        self.leg.travelled += distance_m.abs() + raw.yaw_rad.abs();
        self.leg.motion = self.leg.motion.compose(&self.correct(raw).pose);
        self.leg.reported = self.leg.reported.compose(raw);
    }

    /// The scans say that the robot is at `pose`, with these variances. Learns if the leg is long enough, and returns it then.
    pub(crate) fn observe(&mut self, pose: &Pose2, variances: ScanVariances) -> Option<DrivenLeg> {
        let next = Leg { from: Some((*pose, variances)), ..Leg::EMPTY };
        let Some((from, from_variances)) = self.leg.from else {
            self.leg = next;
            return None;
        };
        if self.leg.travelled < LEG {
            return None;
        }
        let moved = from.inverse().compose(pose);
        self.learn_yaw(moved.yaw_rad, variances.yaw_rad2 + from_variances.yaw_rad2);
        self.learn_distance(&moved, variances.forward_m2);
        let leg = std::mem::replace(&mut self.leg, next);
        Some(DrivenLeg {
            distance_m: leg.distance_m,
            yaw_rad: leg.yaw_rad,
            by_wheels: leg.reported,
            by_scans: moved,
            variances: variances.plus(&from_variances),
        })
    }

    /// The current leg says nothing about the wheels: the robot slipped, was carried, or its scans did not fit.
    pub(crate) fn forget_leg(&mut self) {
        self.leg = Leg::EMPTY;
    }

    fn learn_yaw(&mut self, yaw_rad: f64, variance: f64) {
        let reported = Vector2::new(self.leg.distance_m, self.leg.yaw_rad);
        let change = CHANGE_PER_METRE * CHANGE_PER_METRE * self.leg.travelled;
        self.yaw.forget([change, change]);
        let noise = variance
            + self.drift_noise * self.drift_noise * self.leg.distance_m.abs()
            + self.yaw_noise * self.yaw_noise * self.leg.yaw_rad.abs();
        self.yaw.learn(&reported, yaw_rad - self.leg.yaw_rad, noise);
    }

    /// Legs with much rotation say little about distance.
    fn learn_distance(&mut self, moved: &Pose2, variance: f64) {
        let reported_m = self.leg.motion.x_m.hypot(self.leg.motion.y_m);
        let travelled_m = self.leg.distance_m.abs();
        let is_straight = self.leg.yaw_rad.abs() < 0.2 && reported_m > 0.8 * travelled_m;
        if !is_straight || reported_m < 0.1 || !variance.is_finite() {
            return;
        }
        self.distance_variance += CHANGE_PER_METRE * CHANGE_PER_METRE * travelled_m;
        let surprise = moved.x_m.hypot(moved.y_m) - reported_m;
        let noise = 2.0 * variance + self.distance_noise * self.distance_noise * travelled_m;
        let expected = reported_m * reported_m * self.distance_variance + noise;
        if surprise * surprise > MAX_SURPRISE * MAX_SURPRISE * expected {
            return;
        }
        let gain = reported_m * self.distance_variance / expected;
        self.distance_error += gain * surprise;
        self.distance_variance *= 1.0 - gain * reported_m;
    }

    /// Radians per metre, radians per radian, and metres per metre that the wheels do not report.
    pub(crate) fn errors(&self) -> [f64; 3] {
        let [per_metre, per_radian] = self.yaw.numbers();
        [per_metre, per_radian, self.distance_error]
    }
}

/// Position at the end of a motion whose yaw is corrected. The robot drove along an arc: its chord rotates by half of the correction.
pub(super) fn bent_chord(motion: &Pose2, correction_rad: f64) -> [f64; 2] {
    let (sin, cos) = (0.5 * correction_rad).sin_cos();
    [cos * motion.x_m - sin * motion.y_m, sin * motion.x_m + cos * motion.y_m]
}

/// Length of an increment, negative if it is backwards.
fn signed_length(raw: &Pose2) -> f64 {
    let length_m = raw.x_m.hypot(raw.y_m);
    if raw.x_m < 0.0 { -length_m } else { length_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn variances(forward_m2: f64) -> ScanVariances {
        ScanVariances { yaw_rad2: 1e-6, forward_m2, left_m2: 1e-6 }
    }

    proptest! {
        /// Whatever mixture of driving and rotating: what scans of a robot with a constant bias say is learnt.
        #[test]
        fn a_constant_bias_of_yaw_is_learnt(
            drift in -0.06..0.06f64,
            scale in -0.05..0.05f64,
            seed in 0u64..1000,
        ) {
            let mut model = WheelModel::new(&LocalizationConfig::default());
            let mut pose = Pose2::IDENTITY;
            for step in 0..6000_u64 {
                let rotates = (step / 40 + seed) % 3 == 0;
                let raw = if rotates {
                    Pose2::new(0.0, 0.0, if step % 240 < 120 { 0.035 } else { -0.035 })
                } else {
                    Pose2::new(0.03, 0.0, 0.0)
                };
                let yaw = raw.yaw_rad * (1.0 + scale) + drift * raw.x_m;
                pose = pose.compose(&Pose2::new(raw.x_m, 0.0, yaw));
                model.drove(&raw);
                model.observe(&pose, variances(1e-6));
            }
            let [learnt_drift, learnt_scale, _] = model.errors();
            prop_assert!((learnt_drift - drift).abs() < 0.004, "{learnt_drift} {drift}");
            prop_assert!((learnt_scale - scale).abs() < 0.004, "{learnt_scale} {scale}");
        }
    }

    #[test]
    fn a_corridor_that_says_nothing_about_distance_leaves_the_distance_alone() {
        let mut model = WheelModel::new(&LocalizationConfig::default());
        for step in 0..200 {
            model.drove(&Pose2::new(0.03, 0.0, 0.0));
            model.observe(&Pose2::new(0.01 * f64::from(step), 0.0, 0.0), variances(f64::INFINITY));
        }
        assert!(model.errors()[2].abs() < f64::EPSILON);
    }

    #[test]
    fn a_correction_of_nothing_is_nothing_and_driving_back_undoes_driving() {
        let mut model = WheelModel::new(&LocalizationConfig::default());
        model.yaw.set([0.05, 0.02]);
        assert_eq!(model.correct(&Pose2::IDENTITY).pose, Pose2::IDENTITY);
        let raw = Pose2::new(0.2, 0.01, 0.1);
        let there = model.correct(&raw).pose;
        let back = model.correct(&raw.inverse()).pose;
        let around = there.compose(&back);
        assert!(around.distance_m(&Pose2::IDENTITY) < 1e-3 && around.yaw_rad.abs() < 1e-9);
    }
}
