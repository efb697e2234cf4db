//! The path of the scanner: every scan matched against the scans before it, in the scanner's own frame.
//!
//! The matcher is that of the robot's localization. It begins each match where the wheels say; the wheels count as so uncertain
//! that the scan decides alone.

use hal::Pose2;
use nalgebra::Matrix3;
use runtime::localization::{LocalizationConfig, LocalizationError, Localizer};

use super::drive::Drive;
use super::laser_parameters::LaserParameters;

/// Standard deviation of the wheels after a metre or a radian: the largest that localization takes.
const WHEEL_NOISE: f64 = 0.5;

/// A scan is left out when its standard deviation in any direction is this many times the median of all scans.
const UNCERTAIN: f64 = 3.0;
/// The velocity is taken over this time at least, seconds, if a scanner does not say how long its sweep is.
const SHORTEST_SWEEP_S: f64 = 0.02;

/// Where the scanner was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ScanPose {
    /// Time of the middle of the scan as it was stamped, seconds.
    pub time_s: f64,
    /// Pose in the frame of the first scan.
    pub pose: Pose2,
    /// The scan agreed with the scans before it, and showed its position in every direction.
    pub matched: bool,
}

/// Matches all scans. `parameters` only say where each match begins.
///
/// # Errors
/// A scanner that localization cannot use.
pub(super) fn match_scans(
    drive: &Drive,
    parameters: &LaserParameters,
) -> Result<Vec<ScanPose>, LocalizationError> {
    let config = LocalizationConfig {
        wheel_distance_noise: WHEEL_NOISE,
        wheel_yaw_noise: WHEEL_NOISE,
        wheel_drift_rad_per_m: WHEEL_NOISE,
        ..LocalizationConfig::default()
    };
    let mut localizer = Localizer::new(&config, drive.geometry, Pose2::IDENTITY)?;
    let half_s = 0.5 * (drive.geometry.period_ns as f64 * 1e-9).max(SHORTEST_SWEEP_S);
    let mut by_wheels = ByWheels::new(drive, parameters);
    let mut poses = Vec::with_capacity(drive.scans.len());
    let mut sigmas_m = Vec::with_capacity(drive.scans.len());
    for timed in &drive.scans {
        let time_s = timed.time_s;
        // Two reports for each scan, so that its motion is taken out with the velocity during its sweep.
        let begin = by_wheels.at(time_s - half_s);
        let middle = by_wheels.at(time_s);
        localizer.update(&begin, nanoseconds(time_s - half_s), None);
        let scan = Some((&timed.scan, &middle));
        let estimate = localizer.update(&middle, nanoseconds(time_s), scan);
        localizer.continue_by_wheels();
        sigmas_m.push(largest_sigma_m(&estimate.covariance));
        let pose = estimate.t_odom_base_at_scan.unwrap_or(estimate.t_odom_base);
        poses.push(ScanPose { time_s, pose, matched: estimate.matched });
    }
    leave_out_uncertain(&mut poses, &sigmas_m);
    Ok(poses)
}

/// A scan that is far less certain of its position than others, as along a corridor, follows the wheels there, and would only
/// confirm them.
fn leave_out_uncertain(poses: &mut [ScanPose], sigmas_m: &[f64]) {
    let mut sorted = sigmas_m.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(median_m) = sorted.get(sorted.len() / 2) else { return };
    for (scan, sigma_m) in poses.iter_mut().zip(sigmas_m) {
        scan.matched &= *sigma_m <= UNCERTAIN * median_m;
    }
}

/// Standard deviation of the position in its least certain direction, metres.
fn largest_sigma_m(covariance: &Matrix3<f64>) -> f64 {
    let [xx, xy, yy] = [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]];
    let half = 0.5 * (xx - yy);
    (0.5 * (xx + yy) + half.hypot(xy)).max(0.0).sqrt()
}

/// A second before the drive, so that the first sweep does not begin before time 0.
fn nanoseconds(time_s: f64) -> u64 {
    ((time_s + 1.0).max(0.0) * 1e9) as u64
}

/// Where the wheels say that the scanner is.
struct ByWheels<'a> {
    drive: &'a Drive,
    parameters: &'a LaserParameters,
    last_s: Option<f64>,
    pose: Pose2,
}

impl<'a> ByWheels<'a> {
    fn new(drive: &'a Drive, parameters: &'a LaserParameters) -> Self {
        Self { drive, parameters, last_s: None, pose: Pose2::IDENTITY }
    }

    /// The scanner's pose at a time on the scanner's clock. Times that go back leave it where it is.
    fn at(&mut self, time_s: f64) -> Pose2 {
        let LaserParameters { wheels, t_base_laser, latency_s } = self.parameters;
        let time_s = time_s - latency_s;
        if let Some(last_s) = self.last_s {
            let moved = self.drive.wheels.motion_by_wheels(wheels, last_s, time_s.max(last_s));
            self.pose = self.pose.compose(&laser_motion(&moved, t_base_laser));
        }
        self.last_s = Some(self.last_s.map_or(time_s, |last_s| last_s.max(time_s)));
        self.pose
    }
}

/// The motion of the scanner in its own frame, for a motion of `base_link`.
pub(super) fn laser_motion(moved: &Pose2, t_base_laser: &Pose2) -> Pose2 {
    t_base_laser.inverse().compose(moved).compose(t_base_laser)
}
