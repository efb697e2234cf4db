//! How late scans are stamped, against the wheels.
//!
//! Between two scans the yaw by scans lacks latency times the *change* of the yaw rate: where the robot starts or ends a rotation, the
//! wheels show it. The camera is compared with the scans, so that late scans look like early frames; this says which it is.

use hal::{Pose2, wrap_angle};
use nalgebra::Vector1;
use serde::{Deserialize, Serialize};

use super::change_test::{Begin, ChangeTest, Found, Limits};
use super::sums::Sums;
use crate::localization::LocalizationConfig;
use crate::snapshot::remembers;

/// Error of the yaw between two scans, radians: that of the heading between two frames (`camera_time`), which comes from scans.
const MATCHING_RAD: f64 = 0.002;
/// Scans further apart have the wheels' noise of a longer way between them, seconds. Slow scanners send one in 0.1 to 0.2 s.
const LONGEST_GAP_S: f64 = 0.25;
/// Wheels that report more between two scans jump, radians.
const LARGEST_STEP_RAD: f64 = 0.5;
/// A robot rotates less than this when it does not rotate, and more than [`ROTATES_RADPS`] when it does, rad/s. Of the wheels' noise in
/// 10 ms, which the camera's latency is measured with, the simulated robot has 0.02 rad/s without a rotation and 0.2 rad/s in one of
/// 1 rad/s.
const RESTS_RADPS: f64 = 0.1;
const ROTATES_RADPS: f64 = 0.25;

/// Latency of the scanner, s. The stated noise of the wheels is twice that of a good base ([`LocalizationConfig`]).
pub(super) const SCANNER_LATENCY: Limits<1> =
    Limits { expected: [0.03], noise: [0.5], least_noise: [0.05], least: [0.004], sigmas: 6.0 };
/// Which time stamps have changed is said when one explanation is more probable than the other by this factor (its logarithm), which is
/// 55. A sequential test with this factor (Wald 1945) is wrong in about 1 of 55 if the noise is right.
const SURE: f64 = 4.0;

/// A scan that was matched.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct MatchedScan {
    pub time_ns: u64,
    /// The robot's pose at the scan by the wheels, as they report it.
    pub by_wheels: Pose2,
    /// The same by the scans, with the scanner's latency as configured.
    pub by_scans: Pose2,
    /// Yaw rate of the robot, rad/s, the mean over the tick: a rotation that starts in the middle of it seems to start slowly.
    pub yaw_rate_radps: f64,
}

/// Watches the latency of the scanner.
#[derive(Debug, Default)]
pub(super) struct ScannerTime {
    test: ChangeTest<1>,
    before: Option<MatchedScan>,
}

remembers!(ScannerTime: test, before);

impl ScannerTime {
    /// Takes a scan; `None` when it did not fit.
    pub(super) fn see(&mut self, scan: Option<MatchedScan>, config: &LocalizationConfig) {
        let before = std::mem::replace(&mut self.before, scan);
        if let (Some(before), Some(scan)) = (before, scan)
            && let Some(said) = latency(&before, &scan, config)
        {
            self.test.add(&said, &SCANNER_LATENCY);
        }
    }

    pub(super) fn end_block(&mut self, begin: Begin) {
        self.test.end_block(begin, &SCANNER_LATENCY);
    }

    pub(super) fn find(&self) -> Option<Found> {
        self.test.find(&SCANNER_LATENCY)
    }

    pub(super) fn restart(&mut self) {
        self.test.restart();
    }

    pub(super) fn estimate(&self) -> Option<(f64, f64)> {
        self.test.estimate(0, &SCANNER_LATENCY)
    }

    /// The change since `begin`, and its standard deviation; `None` while scans and wheels do not say enough.
    pub(super) fn change_since(&self, begin: Begin) -> Option<(f64, f64)> {
        self.test.change_since(begin, 0, &SCANNER_LATENCY)
    }

    /// Whether the last blocks say anything: wheels that rotate, and scans that fit.
    pub(super) fn has_equations(&self) -> bool {
        self.test.has_equations()
    }
}

/// Whether a change that was measured as `by` with the standard deviation `sigma` is rather `expected`, which has an error of its own,
/// than zero. `None` while neither is sure.
pub(super) fn is_rather(
    (by, sigma): (f64, f64),
    expected: f64,
    expected_sigma: f64,
) -> Option<bool> {
    let spread = sigma.hypot(expected_sigma);
    let of_none = (by / sigma).powi(2);
    let of_expected = ((by - expected) / spread).powi(2) + 2.0 * (spread / sigma).ln();
    let sureness = 0.5 * (of_none - of_expected);
    (sureness.abs() > SURE).then_some(sureness > 0.0)
}

/// What two scans in a row say of the latency, if a rotation starts or stops between them.
fn latency(
    before: &MatchedScan,
    now: &MatchedScan,
    config: &LocalizationConfig,
) -> Option<Sums<1>> {
    let passed_s = now.time_ns.saturating_sub(before.time_ns) as f64 * 1e-9;
    if passed_s > LONGEST_GAP_S
        || !rotation_starts_or_stops(before.yaw_rate_radps, now.yaw_rate_radps)
    {
        return None;
    }
    let by_wheels_rad = wrap_angle(now.by_wheels.yaw_rad - before.by_wheels.yaw_rad);
    let by_scans_rad = wrap_angle(now.by_scans.yaw_rad - before.by_scans.yaw_rad);
    let more_rad = wrap_angle(by_scans_rad - by_wheels_rad);
    if by_wheels_rad.is_nan() || by_wheels_rad.abs() > LARGEST_STEP_RAD {
        return None;
    }
    let change_radps = now.yaw_rate_radps - before.yaw_rate_radps;
    let yaw_rad = by_wheels_rad.abs().max(by_scans_rad.abs());
    let variance = MATCHING_RAD.powi(2) + config.wheel_yaw_noise.powi(2) * yaw_rad;
    Some(Sums::of(Vector1::new(-change_radps), more_rad, variance))
}

/// Whether one of two yaw rates is that of a robot that rotates, and the other is not. Within a rotation the yaw rate changes only by
/// the wheels' noise, which also makes their yaw wrong: that seems to be a latency of the time between two of their reports.
pub(crate) fn rotation_starts_or_stops(before_radps: f64, now_radps: f64) -> bool {
    let [before, now] = [before_radps, now_radps].map(f64::abs);
    before.min(now) < RESTS_RADPS && before.max(now) > ROTATES_RADPS
}
