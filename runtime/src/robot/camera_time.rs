//! How much earlier than its time stamp a frame was exposed, found while the robot drives.
//!
//! A camera stamps frames when their transfer begins, some 20 ms after their exposure. At 1 rad/s the frame then gets a heading
//! that is wrong by 20 mrad, which is more than the parallax of most of the scene. Between two frames the heading is wrong by
//! latency times the *change* of the yaw rate: where the robot starts or ends a rotation, image motion shows the error, and a
//! Kalman filter (Kalman 1960) with one state finds the latency.

use hal::{Pose2, Twist2};
use nalgebra::Vector1;
use serde::{Deserialize, Serialize};

use crate::calibration_watch::{Sums, rotation_starts_or_stops};
use crate::perception::YawError;
use crate::tick::TickInput;

/// Latency that is expected before any frame: within 20 ms of the stamp, as a standard deviation.
const FIRST_ERROR_S: f64 = 0.02;
/// Error of the heading between two frames that has other reasons than latency, radians: the matching of scans.
const HEADING_ERROR_RAD: f64 = 0.002;
/// The same as a share of the yaw between the frames: the wheels between two scans.
const HEADING_ERROR: f64 = 0.02;
/// The latency may change this much in one second, as a standard deviation (a random walk): exposure times follow the light.
const WALK_S: f64 = 0.00005;
/// An observation further from the estimate than this many standard deviations is left out: people, slip, blur.
const GATE: f64 = 4.0;
/// Latencies beyond this are defects of the driver, and other motion would be taken for them, seconds.
const LARGEST_S: f64 = 0.15;
/// Frames further apart overlap too little, seconds.
const LONGEST_GAP_S: f64 = 0.25;

/// The gyroscope's rotation since the scan gives the yaw rate if the scan was this long ago, seconds: over less, its noise counts, and over more,
/// the robot may have rotated otherwise at the beginning.
const GYRO_SPAN_S: std::ops::RangeInclusive<f64> = 0.005..=0.06;

/// The robot's motion at the time of the wheel feedback. The yaw rate of the wheels is that of their last report, some milliseconds, in which
/// their noise is large: from simulated wheels with a noise of 5 %, a latency of about 20 ms was found as 14 to 18 ms, and as -5 to 13 ms where a
/// gyroscope gave the pose (docs/accuracy.md). So the yaw rate is that of the gyroscope, if there is one.
pub(super) fn motion_now(input: &TickInput<'_>) -> Twist2 {
    let wheels = input.wheel.twist;
    let by_gyro = input.scan.zip(input.imu).and_then(|(scan, imu)| {
        let span_s = (input.wheel.time_ns as f64 - scan.middle_ns() as f64) * 1e-9;
        let rotated_rad = imu.yaw_rad - imu.yaw_at_scan_rad;
        GYRO_SPAN_S.contains(&span_s).then(|| rotated_rad / span_s)
    });
    let by_gyro = by_gyro.filter(|rate_radps| rate_radps.is_finite());
    Twist2 { angular_radps: by_gyro.unwrap_or(wheels.angular_radps), ..wheels }
}

/// The estimate, and what it remembers of the frame before.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct CameraTime {
    latency_s: f64,
    variance_s2: f64,
    before: Option<FrameTime>,
}

/// The motion at the time of a frame.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct FrameTime {
    time_ns: u64,
    yaw_rate_radps: f64,
    /// By how much the heading was corrected for this frame, radians.
    corrected_rad: f64,
}

impl Default for CameraTime {
    fn default() -> Self {
        Self { latency_s: 0.0, variance_s2: FIRST_ERROR_S * FIRST_ERROR_S, before: None }
    }
}

impl CameraTime {
    /// Time from the exposure of a frame to its stamp, seconds.
    pub(super) fn latency_s(&self) -> f64 {
        self.latency_s
    }

    /// Standard deviation of [`latency_s`](Self::latency_s), seconds.
    pub(super) fn error_s(&self) -> f64 {
        self.variance_s2.sqrt()
    }

    /// Where the robot was when the frame was exposed that is stamped with the time of `t_odom_base`. `twist` is the robot's
    /// motion.
    pub(super) fn at_exposure(&self, t_odom_base: &Pose2, twist: &Twist2) -> Pose2 {
        let pose = t_odom_base.compose(&twist.integrate(-self.latency_s));
        if pose.is_finite() { pose } else { *t_odom_base }
    }

    /// Learns from a frame whose pose came from [`at_exposure`](Self::at_exposure). `yaw_error` is what image motion says of
    /// the yaw since the frame before; `None` when it says nothing. Returns what the frame says of the latency, in seconds, if a
    /// rotation starts or stops.
    pub(super) fn observe(
        &mut self,
        time_ns: u64,
        twist: &Twist2,
        yaw_error: Option<YawError>,
    ) -> Option<Sums<1>> {
        let yaw_rate_radps = twist.angular_radps;
        if !yaw_rate_radps.is_finite() {
            self.before = None;
            return None;
        }
        let corrected_rad = -self.latency_s * yaw_rate_radps;
        let now = FrameTime { time_ns, yaw_rate_radps, corrected_rad };
        let before = self.before.replace(now)?;
        let passed_s = time_ns.saturating_sub(before.time_ns) as f64 * 1e-9;
        self.variance_s2 += WALK_S * WALK_S * passed_s;
        let error = yaw_error.filter(|_| passed_s <= LONGEST_GAP_S)?;
        // Without correction, the yaw between the frames would be wrong by -latency * change.
        let change_radps = yaw_rate_radps - before.yaw_rate_radps;
        let uncorrected_rad = error.rad + corrected_rad - before.corrected_rad;
        let innovation_rad = uncorrected_rad + self.latency_s * change_radps;
        let yaw_rad = yaw_rate_radps.abs().max(before.yaw_rate_radps.abs()) * passed_s;
        let noise_rad2 =
            error.variance_rad2 + HEADING_ERROR_RAD.powi(2) + (HEADING_ERROR * yaw_rad).powi(2);
        let said = rotation_starts_or_stops(before.yaw_rate_radps, yaw_rate_radps)
            .then(|| Sums::of(Vector1::new(-change_radps), uncorrected_rad, noise_rad2));
        let total_rad2 = self.variance_s2 * change_radps * change_radps + noise_rad2;
        if innovation_rad * innovation_rad > GATE * GATE * total_rad2 {
            return said;
        }
        let gain = -self.variance_s2 * change_radps / total_rad2;
        self.latency_s = (self.latency_s + gain * innovation_rad).clamp(-LARGEST_S, LARGEST_S);
        self.variance_s2 *= noise_rad2 / total_rad2;
        said
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_robot::standing;
    use super::*;
    use crate::imu::ImuInput;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const TICK_S: f64 = 0.1;

    /// The yaw rate at the wheel feedback of a scan that is `age_s` old, during which the gyroscope has rotated by `rotated_rad`; the
    /// wheels say 0.5 rad/s.
    fn yaw_rate(age_s: f64, rotated_rad: f64) -> f64 {
        let mut recorded = standing(100, &Pose2::IDENTITY, Pose2::IDENTITY);
        recorded.wheel.twist.angular_radps = 0.5;
        let scan_ns = recorded.scan.as_ref().unwrap().middle_ns();
        recorded.wheel.time_ns = scan_ns + (age_s * 1e9) as u64;
        let imu =
            ImuInput { gaps: 0, yaw_rad: 2.0, yaw_at_scan_rad: 2.0 - rotated_rad, tilt_rad: None };
        recorded.imu = Some(imu);
        motion_now(&recorded.input().unwrap()).angular_radps
    }

    #[test]
    fn the_gyroscope_gives_the_yaw_rate_since_a_scan_of_a_moment_ago_and_the_wheels_give_it_otherwise()
     {
        assert!((yaw_rate(0.02, 0.014) - 0.7).abs() < 1e-6);
        for (age_s, rotated_rad) in [(0.004, 0.014), (0.061, 0.014), (0.02, f64::NAN)] {
            assert_eq!(yaw_rate(age_s, rotated_rad), 0.5, "{age_s} {rotated_rad}");
        }
    }

    /// Drives with yaw rates that change every half second, with a camera that is `latency_s` late. `noise_rad` is the error of
    /// image motion. Returns the filter.
    fn driven(latency_s: f64, noise_rad: f64, frames: u64) -> CameraTime {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let mut filter = CameraTime::default();
        let mut corrected_before = 0.0;
        for frame in 0..frames {
            let twist = Twist2 { linear_mps: 0.3, angular_radps: rate(frame) };
            let corrected = filter.at_exposure(&Pose2::IDENTITY, &twist).yaw_rad;
            let true_shift = -latency_s * (rate(frame) - rate(frame.saturating_sub(1)));
            let noise = noise_rad * random.random_range(-1.7..1.7);
            let error = true_shift - (corrected - corrected_before) + noise;
            corrected_before = corrected;
            let yaw_error = YawError { rad: error, variance_rad2: noise_rad * noise_rad };
            let time_ns = (frame as f64 * TICK_S * 1e9) as u64;
            filter.observe(time_ns, &twist, (frame > 0).then_some(yaw_error));
        }
        filter
    }

    fn rate(frame: u64) -> f64 {
        [0.0, 0.8, -0.5, 0.0, 1.0][(frame / 5 % 5) as usize]
    }

    proptest! {
        #[test]
        fn a_minute_of_driving_finds_the_latency_within_two_milliseconds(latency_s in -0.03..0.08_f64) {
            let filter = driven(latency_s, 0.001, 600);
            prop_assert!((filter.latency_s() - latency_s).abs() < 0.002, "{filter:?}");
            prop_assert!(filter.error_s() < 0.001);
        }
    }

    #[test]
    fn straight_driving_shows_nothing() {
        let mut filter = CameraTime::default();
        let twist = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
        for frame in 0..600_u64 {
            let error = YawError { rad: 0.003, variance_rad2: 1e-6 };
            filter.observe(frame * 100_000_000, &twist, Some(error));
        }
        assert_eq!(filter.latency_s().to_bits(), 0.0_f64.to_bits());
        assert!(filter.error_s() >= FIRST_ERROR_S);
    }

    #[test]
    fn only_the_beginning_and_the_end_of_a_rotation_say_something_of_the_latency() {
        let mut filter = CameraTime::default();
        let rates = [0.0, 0.02, 0.7, 0.5, 0.8, 0.0, -0.35, -0.3, 0.05];
        let says = rates.iter().enumerate().map(|(frame, rate)| {
            let twist = Twist2 { linear_mps: 0.0, angular_radps: *rate };
            let error = YawError { rad: 0.001, variance_rad2: 1e-6 };
            filter.observe(frame as u64 * 100_000_000, &twist, Some(error)).is_some()
        });
        let says: Vec<bool> = says.collect();
        assert_eq!(says, [false, false, true, false, false, true, true, false, true]);
    }

    #[test]
    fn one_wrong_rotation_after_a_minute_changes_nothing() {
        let mut filter = driven(0.02, 0.001, 600);
        let before = filter.latency_s();
        let twist = Twist2 { linear_mps: 0.0, angular_radps: -1.0 };
        let wrong = YawError { rad: 0.2, variance_rad2: 1e-6 };
        filter.observe(60_000_000_000, &twist, Some(wrong));
        assert_eq!(filter.latency_s().to_bits(), before.to_bits());
    }

    #[test]
    fn the_pose_at_the_exposure_lies_behind_on_the_arc() {
        let filter = driven(0.05, 0.0, 600);
        let twist = Twist2 { linear_mps: 0.4, angular_radps: 1.0 };
        let pose = filter.at_exposure(&Pose2::new(1.0, 2.0, 0.0), &twist);
        assert!((pose.x_m - 0.98).abs() < 0.002 && (pose.yaw_rad + 0.05).abs() < 0.003, "{pose:?}");
    }
}
