//! The recent rotation of the robot by its gyroscope, integrated, for the times of frames and scans.

use std::collections::VecDeque;

use hal::ImuSample;
use nalgebra::Vector3;

use super::ImuInput;

/// Samples are kept for this long; the latency of cameras is lower.
const KEPT_NS: u64 = 1_000_000_000;
/// Samples that are nearer than this to the one before are left out, so that memory is bounded: no unit is faster than 1.6 kHz.
const LEAST_NS: u64 = 500_000;
/// A longer time between two samples is an interruption: the robot may have rotated meanwhile.
const GAP_NS: u64 = 50_000_000;
/// No robot of this kind rotates faster, rad/s. A unit that reports it is broken, or the robot is in the air.
const FASTEST_RADPS: f64 = 4.0;
/// The newest sample stands for at most this long after its time: a robot of this kind rotates by less than a degree in it more or less
/// than at its present rate.
const AHEAD_NS: u64 = 30_000_000;
/// Time constant of the mean specific force: long enough that bumps and the start of a drive do not tilt it, seconds.
const FORCE_S: f64 = 0.5;

/// An angle at a time.
#[derive(Debug, Clone, Copy)]
struct Angle {
    time_ns: u64,
    yaw_rad: f64,
}

/// Integrates samples that are in the axes of `base_link`.
#[derive(Debug, Clone, Default)]
pub struct ImuHistory {
    /// Oldest first.
    angles: VecDeque<Angle>,
    /// Time of the newest sample that was taken.
    newest_ns: Option<u64>,
    /// Rate of the newest sample, rad/s.
    rate_radps: f64,
    gaps: u32,
    /// Mean specific force, m/s2.
    force_mps2: Option<Vector3<f64>>,
}

impl ImuHistory {
    /// Adds the next sample. One that is not finite, or not newer than the last one, is left out. One that is faster than a robot
    /// interrupts the samples.
    pub fn push(&mut self, sample: &ImuSample) {
        let rate_radps = sample.angular_radps[2];
        let least_ns = self.newest_ns.map_or(0, |newest_ns| newest_ns.saturating_add(LEAST_NS));
        if !sample.is_finite() || sample.time_ns < least_ns {
            return;
        }
        let newest = self.angles.back().copied();
        self.average(sample);
        if rate_radps.abs() > FASTEST_RADPS {
            self.interrupt();
            return;
        }
        let time_ns = sample.time_ns;
        let mut yaw_rad = 0.0;
        match newest {
            Some(newest) if time_ns - newest.time_ns <= GAP_NS => {
                let seconds = (time_ns - newest.time_ns) as f64 * 1e-9;
                yaw_rad = newest.yaw_rad + 0.5 * (self.rate_radps + rate_radps) * seconds;
            }
            Some(_) => self.interrupt(),
            None => {}
        }
        self.rate_radps = rate_radps;
        self.angles.push_back(Angle { time_ns, yaw_rad });
        while self.angles.front().is_some_and(|oldest| time_ns - oldest.time_ns > KEPT_NS) {
            self.angles.pop_front();
        }
    }

    /// Angles from before cannot be compared with those to come.
    fn interrupt(&mut self) {
        if !self.angles.is_empty() {
            self.angles.clear();
            self.gaps += 1;
        }
    }

    /// Takes the specific force of a sample, also of one that is too fast.
    fn average(&mut self, sample: &ImuSample) {
        let before_ns = self.newest_ns.replace(sample.time_ns).unwrap_or(sample.time_ns);
        let seconds = (sample.time_ns - before_ns) as f64 * 1e-9;
        let Some(force) = sample.force_mps2.map(Vector3::from) else {
            self.force_mps2 = None;
            return;
        };
        let before = self.force_mps2.unwrap_or(force);
        let share = (seconds / FORCE_S).min(1.0);
        self.force_mps2 = Some(before + share * (force - before));
    }

    /// The input of a tick whose wheel feedback is of `wheel_ns`, and whose scan has its middle at `scan_ns`. `None` where there are no
    /// samples around these times.
    #[must_use]
    pub fn at(&self, wheel_ns: u64, scan_ns: Option<u64>) -> Option<ImuInput> {
        let yaw_rad = self.yaw_rad(wheel_ns)?;
        let yaw_at_scan_rad = match scan_ns {
            Some(scan_ns) => self.yaw_rad(scan_ns)?,
            None => yaw_rad,
        };
        Some(ImuInput { gaps: self.gaps, yaw_rad, yaw_at_scan_rad, tilt_rad: self.tilt_rad() })
    }

    /// The angle at `time_ns` since the last interruption: interpolated between two samples, and continued for a short time after
    /// the newest one. `None` where there are no samples.
    fn yaw_rad(&self, time_ns: u64) -> Option<f64> {
        let after = self.angles.partition_point(|angle| angle.time_ns <= time_ns);
        let before = self.angles.get(after.checked_sub(1)?)?;
        let since_ns = time_ns - before.time_ns;
        let Some(after) = self.angles.get(after) else {
            let seconds = since_ns as f64 * 1e-9;
            return (since_ns <= AHEAD_NS).then_some(before.yaw_rad + self.rate_radps * seconds);
        };
        let share = since_ns as f64 / (after.time_ns - before.time_ns) as f64;
        Some(before.yaw_rad + share * (after.yaw_rad - before.yaw_rad))
    }

    /// Angle between the vertical axis of the robot and the mean specific force; `None` without an accelerometer.
    fn tilt_rad(&self) -> Option<f64> {
        let force = self.force_mps2?;
        Some(force.xy().norm().atan2(force.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn sample(time_ns: u64, rate_radps: f64) -> ImuSample {
        ImuSample {
            time_ns,
            angular_radps: [0.0, 0.0, rate_radps],
            force_mps2: Some([0.0, 0.0, 9.81]),
        }
    }

    fn rotating(rate_radps: f64) -> ImuHistory {
        let mut history = ImuHistory::default();
        for index in 0..=100 {
            history.push(&sample(index * 10 * MS, rate_radps));
        }
        history
    }

    #[test]
    fn the_angle_is_the_integral_of_the_rate_at_any_time_between_samples() {
        let history = rotating(0.5);
        for time_ms in [0, 3, 10, 517, 999, 1000] {
            let expected = 0.5e-3 * time_ms as f64;
            let yaw_rad = history.yaw_rad(time_ms * MS).unwrap();
            assert!((yaw_rad - expected).abs() < 1e-12, "{time_ms} ms: {yaw_rad}");
        }
    }

    #[test]
    fn a_rate_that_grows_evenly_is_integrated_exactly() {
        let mut history = ImuHistory::default();
        for index in 0..=50 {
            history.push(&sample(index * 10 * MS, 0.02 * index as f64));
        }
        let quarter_of_a_second = history.yaw_rad(250 * MS).unwrap();
        assert!((quarter_of_a_second - 0.5 * 2.0 * 0.25 * 0.25).abs() < 1e-12);
    }

    #[test]
    fn the_newest_rate_stands_for_30_ms_and_then_there_is_no_angle() {
        let history = rotating(0.5);
        assert!((history.yaw_rad(1030 * MS).unwrap() - 0.515).abs() < 1e-12);
        assert_eq!(history.yaw_rad(1031 * MS), None);
    }

    #[test]
    fn an_interruption_is_counted_and_nothing_is_known_of_the_time_before_it() {
        let mut history = rotating(0.5);
        assert_eq!(history.gaps, 0);
        history.push(&sample(1051 * MS, 0.5));
        assert_eq!(history.gaps, 1);
        assert_eq!(history.yaw_rad(1000 * MS), None);
        assert_eq!(history.yaw_rad(1051 * MS), Some(0.0));
    }

    #[test]
    fn a_sample_that_is_not_finite_or_not_newer_changes_nothing() {
        let mut history = rotating(0.5);
        history.push(&sample(1010 * MS, f64::NAN));
        history.push(&sample(900 * MS, 0.1));
        history.push(&ImuSample { force_mps2: Some([f64::NAN; 3]), ..sample(1010 * MS, 0.5) });
        assert!((history.yaw_rad(1000 * MS).unwrap() - 0.5).abs() < 1e-12);
        assert!((history.yaw_rad(1010 * MS).unwrap() - 0.505).abs() < 1e-12);
    }

    #[test]
    fn a_rotation_faster_than_any_robot_is_an_interruption() {
        let mut history = rotating(0.5);
        history.push(&sample(1010 * MS, 20.0));
        history.push(&sample(1020 * MS, -30.0));
        assert_eq!((history.gaps, history.yaw_rad(1010 * MS)), (1, None));
        history.push(&sample(1030 * MS, 0.5));
        assert_eq!((history.gaps, history.yaw_rad(1030 * MS)), (1, Some(0.0)));
    }

    #[test]
    fn a_second_is_kept() {
        let mut history = rotating(0.5);
        (101..500).for_each(|index| history.push(&sample(index * 10 * MS, 0.5)));
        assert_eq!(history.yaw_rad(3980 * MS), None);
        assert!(history.yaw_rad(3990 * MS).is_some());
    }

    #[test]
    fn a_robot_on_a_slope_is_tilted_and_one_that_accelerates_for_a_moment_is_not() {
        let mut history = rotating(0.0);
        assert!(history.tilt_rad().unwrap() < 1e-9);
        let slope = 0.2_f64;
        let force = Some([-9.81 * slope.sin(), 0.0, 9.81 * slope.cos()]);
        let on =
            |index: u64| ImuSample { force_mps2: force, ..sample((100 + index) * 10 * MS, 0.0) };
        (1..=5).for_each(|index| history.push(&on(index)));
        assert!(history.tilt_rad().unwrap() < 0.03, "{:?}", history.tilt_rad());
        (6..=300).for_each(|index| history.push(&on(index)));
        assert!((history.tilt_rad().unwrap() - slope).abs() < 1e-3);
    }

    #[test]
    fn a_gyroscope_alone_says_nothing_about_tilt() {
        let mut history = ImuHistory::default();
        history.push(&ImuSample { force_mps2: None, ..sample(MS, 0.0) });
        assert_eq!(history.tilt_rad(), None);
    }
}
