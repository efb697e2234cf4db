//! The local pose: wheels and gyroscope predict, every scan corrects, in a frame that never jumps.
//!
//! A Kalman filter over the pose. The prediction's covariance grows with the motion that wheels and gyroscope report; the scan's
//! information comes from its match against recent keyframes. Directions that a scan says nothing about (along a corridor) keep the
//! prediction of the wheels.

use std::collections::VecDeque;

use hal::{LaserScan, Pose2, ScanGeometry, Twist2, wrap_angle};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::snapshot::{SnapshotError, State, remembers};

use super::LocalizationConfig;
use super::driven_leg::{DrivenLeg, ScanVariances};
use super::gyro_model::{GyroAngle, GyroModel, join};
use super::matcher::{Alignment, Prior, ScanFit, Surfaces, align};
use super::scan_points::{ScanPoints, Stretch, Velocity};
use super::search_grid::{Search, SearchGrid, Window};
use super::seen_through::Sight;
use super::wheel_model::WheelModel;

/// A scan that lies on known surfaces with a smaller share of its stretches says nothing about the pose.
const MIN_INLIERS: f32 = 0.5;
/// A scan of which less is near known surfaces says nothing about the pose.
const MIN_OVERLAP: f32 = 0.15;
/// A scan of which less lies on known surfaces is examined for those that it saw through. With more of them than this it says
/// nothing about the pose: it was taken elsewhere. New ground contradicts nothing, and people stand in front of surfaces.
const EXAMINED_SHARE: f32 = 0.75;
const MAX_CONTRADICTED: f32 = 0.3;
/// A scan that moves the predicted pose by more than this needs the share above. Scans of robots that were pushed had 0.91 and more,
/// those of robots that were put down elsewhere 0.64 and less (lost_tests).
const JUMP_M: f64 = 0.15;
const JUMP_RAD: f64 = 0.15;
/// The two bounds grow by what the wheels report in this time, seconds: wheels that report the wrong direction predict a pose that is off
/// by twice the motion between two scans, of which four or more come in a second.
const REVERSED_S: f64 = 0.5;
/// A scan that fits less may have been aligned with the wrong surfaces: its pose is searched for.
const SEARCH_INLIERS: f32 = 0.75;
/// The search replaces an alignment that has this much fewer stretches on known surfaces.
const BETTER_INLIERS: f32 = 0.1;
/// Beyond three standard deviations, the search reaches this much further: wheels slip on sills and in fast rotations.
const SEARCH_M: f64 = 0.4;
const SEARCH_RAD: f64 = 0.2;
/// The search is within one scan's time, so that it is bounded.
const MAX_SEARCH_M: f64 = 1.5;
const MAX_SEARCH_RAD: f64 = 0.6;
/// How exact a pose is that the search has found: its cells.
const FOUND_M: f64 = 0.15;
const FOUND_RAD: f64 = 0.03;
/// A scan with fewer stretches that have a direction says nothing about the pose.
const MIN_STRETCHES: usize = 6;
/// The wheels are contradicted when the correction costs more than this by the prior: 3 degrees of freedom exceed it in 1 of
/// 2,000 cases.
const CONTRADICTION: f64 = 18.0;

/// After this many keyframe distances without a match, the keyframes are given up.
const RESTART_KEYFRAMES: f64 = 4.0;

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
    /// The scan became a keyframe.
    pub keyframe: bool,
    /// There was nothing to match the scan with.
    pub is_first: bool,
}

/// Estimates the pose of the robot in `odom`.
pub(crate) struct LocalTracker {
    keyframe_count: usize,
    keyframe_distance_m: f64,
    keyframe_yaw_rad: f64,
    points: ScanPoints,
    surfaces: Surfaces,
    search_grid: SearchGrid,
    keyframes: VecDeque<Keyframe>,
    wheel: WheelModel,
    gyro: GyroModel,
    pose: Pose2,
    /// The last corrected pose, moved on by the wheels alone.
    pose_by_wheels: Pose2,
    /// Of x, y (in the axes of `odom`) and yaw, against the keyframes.
    covariance: Matrix3<f64>,
    last_wheel: Option<Pose2>,
    last_time_ns: u64,
    velocity: Velocity,
    /// The stretch of the drive that the last scan ended, if it ended one.
    leg: Option<DrivenLeg>,
}

// Not the gyroscope's part, which a saved map does not have: maps of robots without a gyroscope stay readable.
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
            search_grid: SearchGrid::new(),
            keyframes,
            wheel: WheelModel::new(config),
            gyro: GyroModel::new(config),
            pose: Pose2::IDENTITY,
            pose_by_wheels: Pose2::IDENTITY,
            covariance: Matrix3::zeros(),
            last_wheel: None,
            last_time_ns: 0,
            velocity: Velocity::default(),
            leg: None,
        }
    }

    pub(crate) fn pose(&self) -> Pose2 {
        self.pose
    }

    /// The last corrected pose, moved on by the wheels alone.
    pub(crate) fn pose_by_wheels(&self) -> Pose2 {
        self.pose_by_wheels
    }

    pub(crate) fn covariance(&self) -> &Matrix3<f64> {
        &self.covariance
    }

    pub(crate) fn wheel(&self) -> &WheelModel {
        &self.wheel
    }

    pub(crate) fn gyro(&self) -> &GyroModel {
        &self.gyro
    }

    /// The stretch of the drive that the last scan ended, once.
    pub(crate) fn take_leg(&mut self) -> Option<DrivenLeg> {
        self.leg.take()
    }

    pub(crate) fn geometry(&self) -> &ScanGeometry {
        self.points.geometry()
    }

    /// The stretches of the scan that was tracked last, in the robot's frame.
    pub(crate) fn stretches(&self) -> &[Stretch] {
        self.points.stretches()
    }

    /// The wheels report `wheel`, and the gyroscope an angle at the same time: moves the pose by the corrected increment since the
    /// last report.
    pub(crate) fn predict(&mut self, wheel: &Pose2, gyro: Option<GyroAngle>) {
        let raw = self.last_wheel.map_or(Pose2::IDENTITY, |last| last.inverse().compose(wheel));
        self.last_wheel = Some(*wheel);
        let mut motion = self.wheel.correct(&raw);
        self.wheel.drove(&raw);
        self.pose_by_wheels = self.pose_by_wheels.compose(&motion.pose);
        if let Some(rotation) = self.gyro.advance(gyro) {
            motion = join(&motion, &rotation);
        }
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
    pub(crate) fn measure_velocity(
        &mut self,
        wheel: &Pose2,
        gyro: Option<GyroAngle>,
        time_ns: u64,
    ) {
        let seconds = time_ns.saturating_sub(self.last_time_ns) as f64 * 1e-9;
        self.last_time_ns = time_ns;
        let Some(last) = self.last_wheel.filter(|_| seconds > 1e-3) else { return };
        let by_wheels = self.wheel.correct(&last.inverse().compose(wheel));
        let motion = match self.gyro.rotation(gyro) {
            Some(rotation) => join(&by_wheels, &rotation).pose,
            None => by_wheels.pose,
        };
        self.velocity = Velocity {
            x_mps: motion.x_m / seconds,
            y_mps: motion.y_m / seconds,
            yaw_radps: motion.yaw_rad / seconds,
        };
    }

    /// The velocity without its part to the side, which wheels do not have.
    pub(crate) fn twist(&self) -> Twist2 {
        Twist2 { linear_mps: self.velocity.x_mps, angular_radps: self.velocity.yaw_radps }
    }

    /// Corrects the pose, which was predicted for the middle of the scan, by the scan.
    pub(crate) fn track(&mut self, scan: &LaserScan) -> Tracked {
        self.points.extract(scan, &self.velocity);
        if self.keyframes.is_empty() {
            self.add_keyframe();
            let fit =
                ScanFit { stretches: self.points.stretches().len() as u32, ..ScanFit::default() };
            return Tracked { fit, matched: true, keyframe: true, is_first: true };
        }
        let aligned = self.align_with_keyframes();
        let fit = aligned.map_or_else(ScanFit::default, |alignment| alignment.fit);
        let matched = fit.inliers >= MIN_INLIERS
            && fit.overlap >= MIN_OVERLAP
            && aligned.is_some_and(|alignment| !self.is_contradicted(&alignment));
        match aligned {
            Some(alignment) if matched => self.correct(&alignment),
            _ => self.forget_legs(),
        }
        let mut keyframe = self.is_due() && fit.stretches > 0;
        if keyframe && !matched {
            // Nothing that the keyframes know is in view: the map goes on from the wheels' pose.
            keyframe = self.restart();
        } else if keyframe {
            self.add_keyframe();
        }
        Tracked { fit, matched, keyframe, is_first: false }
    }

    /// Forgets what was seen around the robot, because it is elsewhere. The pose continues from its present value.
    pub(crate) fn forget_surroundings(&mut self) {
        self.keyframes.clear();
        self.forget_legs();
        self.velocity = Velocity::default();
    }

    /// What is being measured says nothing about wheels and gyroscope.
    fn forget_legs(&mut self) {
        self.wheel.forget_leg();
        self.gyro.forget_leg();
    }

    /// The next wheel pose has another origin, as after a restart of the base.
    pub(crate) fn forget_wheel_odometry(&mut self) {
        self.last_wheel = None;
    }

    /// Recent scans with their poses, oldest first.
    pub(crate) fn keyframes(&self) -> impl Iterator<Item = &Keyframe> {
        self.keyframes.iter()
    }

    /// Forgets the keyframes, none of which is in view, and begins again where the wheels say. False while the robot has
    /// not driven far enough to be sure.
    fn restart(&mut self) -> bool {
        let Some(last) = self.keyframes.back() else { return false };
        if last.pose.distance_m(&self.pose) < RESTART_KEYFRAMES * self.keyframe_distance_m {
            return false;
        }
        self.keyframes.clear();
        self.add_keyframe();
        true
    }

    /// The alignment with the keyframes. A prior that is contradicted is widened as far as it was wrong, and the alignment is
    /// repeated; a scan that still fits badly is searched for.
    fn align_with_keyframes(&mut self) -> Option<Alignment> {
        let stretches = self.points.stretches();
        let with_normal = stretches.iter().filter(|stretch| stretch.has_normal()).count();
        if with_normal < MIN_STRETCHES {
            return None;
        }
        let prior = self.prior(1.0)?;
        let mut alignment = align(&self.surfaces, stretches, &prior)?;
        let contradiction = cost(&alignment, &prior);
        if contradiction > CONTRADICTION {
            let widened = self.prior(contradiction / 3.0)?;
            alignment = align(&self.surfaces, stretches, &widened)?;
        }
        if alignment.fit.inliers < SEARCH_INLIERS
            && let Some(found) = self.search()
            && found.fit.share() > alignment.fit.share() + BETTER_INLIERS
        {
            alignment = found;
        }
        Some(alignment)
    }

    /// Whether the scan was probably taken elsewhere: at the pose of its alignment it has seen through surfaces of the keyframes, or
    /// that pose is a jump, and the scan knows too few of them.
    fn is_contradicted(&self, alignment: &Alignment) -> bool {
        if alignment.fit.share() >= EXAMINED_SHARE {
            return false;
        }
        if self.is_jump(&alignment.pose) {
            return true;
        }
        let sight = Sight::new(self.points.stretches(), self.points.t_base_laser());
        sight.contradicted(&self.surfaces.fine, &alignment.pose) > MAX_CONTRADICTED
    }

    /// Whether `pose` is farther from the predicted one than a push, or wheels that report the wrong direction, explain.
    fn is_jump(&self, pose: &Pose2) -> bool {
        let off = difference(pose, &self.pose);
        let Velocity { x_mps, y_mps, yaw_radps } = self.velocity;
        off.xy().norm() > JUMP_M + REVERSED_S * x_mps.hypot(y_mps)
            || off.z.abs() > JUMP_RAD + REVERSED_S * yaw_radps.abs()
    }

    /// The best alignment with the keyframes around the predicted pose, for a prediction that was too wrong to start from.
    fn search(&mut self) -> Option<Alignment> {
        let origin = Pose2::new(self.pose.x_m, self.pose.y_m, 0.0);
        let to_grid = origin.inverse();
        self.search_grid.clear();
        for keyframe in &self.keyframes {
            self.search_grid.insert(&keyframe.stretches, &to_grid.compose(&keyframe.pose));
        }
        self.search_grid.finish();
        self.search_grid.set_query(self.points.stretches());
        let [x, y, yaw] = [0, 1, 2].map(|at| self.covariance[(at, at)].sqrt());
        let mut search = Search::new(Window {
            middle: Pose2::new(0.0, 0.0, self.pose.yaw_rad),
            half_m: [3.0 * x + SEARCH_M, 3.0 * y + SEARCH_M].map(|half_m| half_m.min(MAX_SEARCH_M)),
            radians: (3.0 * yaw + SEARCH_RAD).min(MAX_SEARCH_RAD),
        });
        while !search.is_done() {
            self.search_grid.step(&mut search);
        }
        let mut best: Option<Alignment> = None;
        for place in search.places() {
            let prior = found_prior(&origin.compose(&place.pose));
            let Some(alignment) = align(&self.surfaces, self.points.stretches(), &prior) else {
                continue;
            };
            if best.is_none_or(|best| best.fit.share() < alignment.fit.share()) {
                best = Some(alignment);
            }
        }
        best
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
        self.pose_by_wheels = alignment.pose;
        let variances = self.scan_variances(&alignment.information);
        self.leg = self.wheel.observe(&self.pose, variances);
        self.gyro.observe(self.pose.yaw_rad, variances.yaw_rad2);
    }

    fn scan_variances(&self, information: &Matrix3<f64>) -> ScanVariances {
        let Some(covariance) = information.try_inverse() else {
            let nothing = f64::INFINITY;
            return ScanVariances { yaw_rad2: nothing, forward_m2: nothing, left_m2: nothing };
        };
        let (sin, cos) = self.pose.yaw_rad.sin_cos();
        ScanVariances {
            yaw_rad2: covariance[(2, 2)].max(0.0),
            forward_m2: along(Vector3::new(cos, sin, 0.0), &covariance),
            left_m2: along(Vector3::new(-sin, cos, 0.0), &covariance),
        }
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
        // Where there was nothing to match with, the pose is what it is, and no longer that of the wheels.
        self.pose_by_wheels = self.pose;
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
        self.pose_by_wheels = self.pose;
        self.rebuild();
        Ok(())
    }

    /// The gyroscope's part of the memory.
    pub(crate) fn write_gyro(&self, to: &mut Vec<u8>) {
        self.gyro.write(to);
        self.pose_by_wheels.write(to);
    }

    /// Restores what [`write_gyro`](Self::write_gyro) wrote, after [`restore`](Self::restore).
    pub(crate) fn read_gyro(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.gyro.read(from)?;
        self.pose_by_wheels.read(from)
    }
}

/// The variance along an axis. 5 cm and more: the scan sees no wall that the robot drives towards or away from, or along.
fn along(axis: Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    let variance = axis.dot(&(*covariance * axis));
    if variance > 0.0 && variance < 0.0025 { variance } else { f64::INFINITY }
}

/// A prior around a pose that a search has found.
pub(crate) fn found_prior(pose: &Pose2) -> Prior {
    let metres = 1.0 / (FOUND_M * FOUND_M);
    let radians = 1.0 / (FOUND_RAD * FOUND_RAD);
    let information = Matrix3::from_diagonal(&Vector3::new(metres, metres, radians));
    Prior { pose: *pose, information, width_m: 2.0 * FOUND_M }
}

/// By how much an alignment contradicts the prior: the squared Mahalanobis distance.
fn cost(alignment: &Alignment, prior: &Prior) -> f64 {
    let off = difference(&alignment.pose, &prior.pose);
    off.dot(&(prior.information * off))
}

/// `a - b` as x, y and yaw.
fn difference(a: &Pose2, b: &Pose2) -> Vector3<f64> {
    Vector3::new(a.x_m - b.x_m, a.y_m - b.y_m, wrap_angle(a.yaw_rad - b.yaw_rad))
}
