//! The local pose: wheels predict, every scan corrects, in a frame that never jumps.
//!
//! A Kalman filter over the pose. The prediction's covariance grows with the motion that the wheels report; the scan's
//! information comes from its match against recent keyframes. Directions that a scan says nothing about (along a corridor) keep the
//! prediction of the wheels.

use std::collections::VecDeque;

use hal::{LaserScan, Pose2, ScanGeometry, wrap_angle};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::snapshot::{SnapshotError, State, remembers};

use super::LocalizationConfig;
use super::matcher::{Alignment, Prior, ScanFit, Surfaces, align};
use super::scan_points::{ScanPoints, Stretch, Velocity};
use super::wheel_model::WheelModel;

/// A scan with a smaller share of known surfaces says nothing about the pose.
const MIN_INLIERS: f32 = 0.25;
/// A scan with fewer stretches that have a direction says nothing about the pose.
const MIN_STRETCHES: usize = 6;
/// The wheels are contradicted when the correction costs more than this by the prior: 3 degrees of freedom exceed it in 1 of
/// 2,000 cases.
const CONTRADICTION: f64 = 18.0;

/// An earlier scan and where the robot was.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Keyframe {
    pub pose: Pose2,
    pub stretches: Vec<Stretch>,
}

/// What became of a scan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tracked {
    pub fit: ScanFit,
    /// The scan fits and has corrected the pose.
    pub matched: bool,
    /// By how much the scan contradicts the wheels: the squared Mahalanobis distance.
    pub contradiction: f64,
    /// The scan became a keyframe.
    pub keyframe: bool,
}

/// Estimates the pose of the robot in `odom`.
pub(crate) struct LocalTracker {
    keyframe_count: usize,
    keyframe_distance_m: f64,
    keyframe_yaw_rad: f64,
    points: ScanPoints,
    surfaces: Surfaces,
    keyframes: VecDeque<Keyframe>,
    wheel: WheelModel,
    pose: Pose2,
    /// Of x, y (in the axes of `odom`) and yaw, against the keyframes.
    covariance: Matrix3<f64>,
    last_wheel: Option<Pose2>,
    last_time_ns: u64,
    velocity: Velocity,
}

remembers!(LocalTracker: keyframes, wheel, pose, covariance, last_wheel, last_time_ns, velocity);

impl LocalTracker {
    pub(crate) fn new(
        config: &LocalizationConfig,
        geometry: ScanGeometry,
        t_base_laser: Pose2,
    ) -> Self {
        let keyframes = (0..=config.keyframes).map(|_| Keyframe {
            pose: Pose2::IDENTITY,
            stretches: Vec::with_capacity(geometry.beams),
        });
        let mut keyframes: VecDeque<_> = keyframes.collect();
        keyframes.clear();
        Self {
            keyframe_count: config.keyframes,
            keyframe_distance_m: config.keyframe_distance_m,
            keyframe_yaw_rad: config.keyframe_yaw_deg.to_radians(),
            points: ScanPoints::new(
                geometry,
                t_base_laser,
                config.range_noise_m,
                config.range_limit_m,
            ),
            surfaces: Surfaces::new(),
            keyframes,
            wheel: WheelModel::new(config),
            pose: Pose2::IDENTITY,
            covariance: Matrix3::zeros(),
            last_wheel: None,
            last_time_ns: 0,
            velocity: Velocity::default(),
        }
    }

    pub(crate) fn pose(&self) -> Pose2 {
        self.pose
    }

    pub(crate) fn covariance(&self) -> &Matrix3<f64> {
        &self.covariance
    }

    pub(crate) fn wheel(&self) -> &WheelModel {
        &self.wheel
    }

    pub(crate) fn geometry(&self) -> &ScanGeometry {
        self.points.geometry()
    }

    /// The stretches of the scan that was tracked last, in the robot's frame.
    pub(crate) fn stretches(&self) -> &[Stretch] {
        self.points.stretches()
    }

    /// The wheels report `wheel`: moves the pose by the corrected increment since the last report.
    pub(crate) fn predict(&mut self, wheel: &Pose2) {
        let raw = self.last_wheel.map_or(Pose2::IDENTITY, |last| last.inverse().compose(wheel));
        self.last_wheel = Some(*wheel);
        let motion = self.wheel.correct(&raw);
        self.wheel.drove(&raw);
        let next = self.pose.compose(&motion.pose);
        let mut spread = Matrix3::identity();
        spread[(0, 2)] = self.pose.y_m - next.y_m;
        spread[(1, 2)] = next.x_m - self.pose.x_m;
        let rotation = nalgebra::Rotation3::from_axis_angle(
            &Vector3::z_axis(),
            self.pose.yaw_rad + 0.5 * motion.pose.yaw_rad,
        );
        let noise = rotation.matrix() * motion.covariance * rotation.matrix().transpose();
        self.covariance = spread * self.covariance * spread.transpose() + noise;
        self.pose = next;
    }

    /// The velocity between two reports, for the motion during a sweep.
    pub(crate) fn measure_velocity(&mut self, wheel: &Pose2, time_ns: u64) {
        let seconds = time_ns.saturating_sub(self.last_time_ns) as f64 * 1e-9;
        self.last_time_ns = time_ns;
        let Some(last) = self.last_wheel.filter(|_| seconds > 1e-3) else { return };
        let motion = self.wheel.correct(&last.inverse().compose(wheel)).pose;
        self.velocity = Velocity {
            x_mps: motion.x_m / seconds,
            y_mps: motion.y_m / seconds,
            yaw_radps: motion.yaw_rad / seconds,
        };
    }

    /// Corrects the pose, which was predicted for the middle of the scan, by the scan.
    pub(crate) fn track(&mut self, scan: &LaserScan) -> Tracked {
        self.points.extract(scan, &self.velocity);
        if self.keyframes.is_empty() {
            self.add_keyframe();
            let fit =
                ScanFit { stretches: self.points.stretches().len() as u32, ..ScanFit::default() };
            return Tracked { fit, matched: true, contradiction: 0.0, keyframe: true };
        }
        let Some((alignment, contradiction)) = self.align_with_keyframes() else {
            self.wheel.forget_leg();
            let fit = ScanFit::default();
            return Tracked { fit, matched: false, contradiction: 0.0, keyframe: false };
        };
        let fit = alignment.fit;
        let matched = fit.inliers >= MIN_INLIERS;
        if matched {
            self.correct(&alignment);
        } else {
            self.wheel.forget_leg();
        }
        let keyframe = matched && self.is_due();
        if keyframe {
            self.add_keyframe();
        }
        Tracked { fit, matched, contradiction, keyframe }
    }

    /// The alignment with the keyframes, and by how much it contradicts the wheels. A prior that is contradicted is
    /// widened as far as it was wrong, and the alignment is repeated.
    fn align_with_keyframes(&self) -> Option<(Alignment, f64)> {
        let stretches = self.points.stretches();
        let with_normal = stretches.iter().filter(|stretch| stretch.has_normal()).count();
        if with_normal < MIN_STRETCHES {
            return None;
        }
        let mut prior = self.prior(1.0)?;
        let first = align(&self.surfaces, stretches, &prior)?;
        let off = difference(&first.pose, &prior.pose);
        let contradiction = off.dot(&(prior.information * off));
        if contradiction <= CONTRADICTION {
            return Some((first, contradiction));
        }
        prior = self.prior(contradiction / 3.0)?;
        let second = align(&self.surfaces, stretches, &prior)?;
        Some((second, contradiction))
    }

    fn prior(&self, widened: f64) -> Option<Prior> {
        let covariance = self.covariance * widened;
        // Points 4 m away are typical of rooms.
        let lever = 4.0 * covariance[(2, 2)].sqrt();
        let width_m = 3.0 * (covariance[(0, 0)].max(covariance[(1, 1)]).sqrt() + lever);
        Some(Prior { pose: self.pose, information: covariance.try_inverse()?, width_m })
    }

    fn correct(&mut self, alignment: &Alignment) {
        let prior = self.covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
        if let Some(covariance) = (prior + alignment.information).try_inverse() {
            self.covariance = 0.5 * (covariance + covariance.transpose());
        }
        self.pose = alignment.pose;
        let [yaw_variance, forward_variance] = self.scan_variances(&alignment.information);
        self.wheel.observe(&self.pose, yaw_variance, forward_variance);
    }

    /// Variances of yaw and of the position along the heading by the scan alone; infinite where it says nothing.
    fn scan_variances(&self, information: &Matrix3<f64>) -> [f64; 2] {
        let Some(covariance) = information.try_inverse() else { return [f64::INFINITY; 2] };
        let (sin, cos) = self.pose.yaw_rad.sin_cos();
        let heading = Vector3::new(cos, sin, 0.0);
        let forward = heading.dot(&(covariance * heading));
        // 5 cm and more: the scan sees no wall that the robot drives towards or away from.
        let forward = if forward > 0.0 && forward < 0.0025 { forward } else { f64::INFINITY };
        [covariance[(2, 2)].max(0.0), forward]
    }

    fn is_due(&self) -> bool {
        self.keyframes.back().is_none_or(|last| {
            last.pose.distance_m(&self.pose) > self.keyframe_distance_m
                || wrap_angle(last.pose.yaw_rad - self.pose.yaw_rad).abs() > self.keyframe_yaw_rad
        })
    }

    fn add_keyframe(&mut self) {
        let recycled = if self.keyframes.len() >= self.keyframe_count {
            self.keyframes.pop_front().map(|keyframe| keyframe.stretches)
        } else {
            None
        };
        let capacity = self.points.geometry().beams;
        let mut stretches = recycled.unwrap_or_else(|| Vec::with_capacity(capacity));
        stretches.clear();
        stretches.extend_from_slice(self.points.stretches());
        self.keyframes.push_back(Keyframe { pose: self.pose, stretches });
        self.rebuild();
    }

    /// Surfaces follow from the keyframes alone, so that a snapshot does not need them.
    fn rebuild(&mut self) {
        let Some(newest) = self.keyframes.back() else { return };
        self.surfaces.clear([newest.pose.x_m, newest.pose.y_m]);
        for keyframe in &self.keyframes {
            self.surfaces.insert(&keyframe.stretches, &keyframe.pose);
        }
    }

    pub(crate) fn restore(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        State::read(self, from)?;
        self.rebuild();
        Ok(())
    }
}

/// `a - b` as x, y and yaw.
fn difference(a: &Pose2, b: &Pose2) -> Vector3<f64> {
    Vector3::new(a.x_m - b.x_m, a.y_m - b.y_m, wrap_angle(a.yaw_rad - b.yaw_rad))
}
