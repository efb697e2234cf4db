//! The path of the scanner: every scan matched against the scans before it, in the scanner's own frame.
//!
//! The matcher is that of the robot's localization. It begins each match where the wheels say; the wheels count as so uncertain
//! that the scan decides alone.

use hal::Pose2;
use runtime::localization::{LocalizationConfig, LocalizationError, Localizer};

use super::drive::Drive;
use super::laser::LaserParameters;

/// Standard deviation of the wheels as a share of their motion: the largest that localization takes.
const WHEEL_NOISE: f64 = 0.5;

/// Where the scanner was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ScanPose {
    /// Time of the middle of the scan as it was stamped, seconds.
    pub time_s: f64,
    /// Pose in the frame of the first scan.
    pub pose: Pose2,
    /// The scan agreed with the scans before it.
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
    let mut by_wheels = parameters.t_base_laser;
    let mut last_s = None;
    let mut poses = Vec::with_capacity(drive.scans.len());
    for timed in &drive.scans {
        let time_s = timed.time_s - parameters.latency_s;
        if let Some(last_s) = last_s {
            let moved = drive.wheels.motion_by_wheels(&parameters.wheels, last_s, time_s);
            by_wheels = by_wheels.compose(&laser_motion(&moved, &parameters.t_base_laser));
        }
        last_s = Some(time_s);
        let time_ns = (timed.time_s.max(0.0) * 1e9) as u64;
        let estimate = localizer.update(&by_wheels, time_ns, Some((&timed.scan, &by_wheels)));
        localizer.continue_by_wheels();
        let pose = estimate.t_odom_base_at_scan.unwrap_or(estimate.t_odom_base);
        poses.push(ScanPose { time_s: timed.time_s, pose, matched: estimate.matched });
    }
    Ok(poses)
}

/// The motion of the scanner in its own frame, for a motion of `base_link`.
pub(super) fn laser_motion(moved: &Pose2, t_base_laser: &Pose2) -> Pose2 {
    t_base_laser.inverse().compose(moved).compose(t_base_laser)
}
