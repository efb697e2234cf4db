//! Estimates the latency of the camera: the time shift with which the rotations measured between
//! frames agree best with the wheel odometry (as Kalibr does for cameras and gyroscopes; Rehder et
//! al. 2016).

use hal::{WheelFeedback, wrap_angle};
use nalgebra::{Matrix2, Vector2};

use super::rotation::FrameRotation;

/// Range and step of the latencies that are tried, seconds.
const RANGE_S: (f64, f64) = (-0.1, 0.3);
const STEP_S: f64 = 0.01;
/// Robust scale of the difference between two rotations, radians.
const SCALE_RAD: f64 = 0.005;
/// Number of parts into which the recording is divided for the standard error (jackknife).
const PARTS: usize = 8;
/// Minimum number of rotations in a recording, and the smallest yaw that counts as one, radians.
const LEAST_ROTATIONS: usize = 40;
const LEAST_ROTATION_RAD: f64 = 0.005;
/// Plausible range of the ratio of the rotation in frames to that of the wheels. Outside of it the
/// robot is configured wrongly. Near objects seen from in front of the axle explain a deviation of
/// a tenth.
const GAINS: (f64, f64) = (0.8, 1.25);
/// Largest acceptable standard error, seconds.
const MAX_ERROR_S: f64 = 0.01;

/// Heading of the robot over time, by the wheel odometry.
#[derive(Debug, Default)]
pub(super) struct Heading {
    begin_ns: Option<u64>,
    /// Time since the first measurement (s), unwrapped heading (rad) and yaw rate (rad/s), in time
    /// order.
    knots: Vec<[f64; 3]>,
}

impl Heading {
    /// Adds a measurement. A measurement that is not finite or not newer is ignored.
    pub fn push(&mut self, wheel: &WheelFeedback) {
        let time_s = self.seconds(wheel.time_ns);
        let last = self.knots.last().copied();
        if !wheel.odom.is_finite()
            || !wheel.twist.angular_radps.is_finite()
            || last.is_some_and(|[then_s, ..]| then_s >= time_s)
        {
            return;
        }
        let yaw_rad = last.map_or(wheel.odom.yaw_rad, |[_, yaw_rad, _]| {
            yaw_rad + wrap_angle(wheel.odom.yaw_rad - yaw_rad)
        });
        self.knots.push([time_s, yaw_rad, wheel.twist.angular_radps]);
    }

    /// Time since the first measurement, seconds.
    pub fn seconds(&mut self, time_ns: u64) -> f64 {
        let begin_ns = *self.begin_ns.get_or_insert(time_ns);
        (time_ns as f64 - begin_ns as f64) * 1e-9
    }

    /// Heading (rad) and yaw rate (rad/s) at a time, by cubic Hermite interpolation of the measured
    /// headings and rates. Outside of the recording, the nearest heading and rate 0.
    fn at(&self, time_s: f64) -> (f64, f64) {
        let after = self.knots.partition_point(|[then_s, ..]| *then_s <= time_s);
        let pair = after
            .checked_sub(1)
            .and_then(|before| self.knots.get(before))
            .zip(self.knots.get(after));
        let Some(([t0, y0, r0], [t1, y1, r1])) = pair else {
            let end = if after == 0 { self.knots.first() } else { self.knots.last() };
            return end.map_or((0.0, 0.0), |[_, yaw_rad, _]| (*yaw_rad, 0.0));
        };
        let span = t1 - t0;
        let x = (time_s - t0) / span;
        let rise = y1 - y0;
        let begin = r0 * span;
        let end = r1 * span;
        let square = 3.0 * rise - 2.0 * begin - end;
        let cube = begin + end - 2.0 * rise;
        (
            y0 + x * (begin + x * (square + x * cube)),
            (begin + x * (2.0 * square + x * 3.0 * cube)) / span,
        )
    }
}

/// The best estimate of the latency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    /// Time from the capture of a frame to its time stamp, seconds, in addition to the configured
    /// latency.
    pub latency_s: f64,
    /// Standard error of the latency, from leaving out an eighth of the recording at a time.
    pub error_s: f64,
    /// 90th percentile of the difference between frames and wheels with this latency and without
    /// it, radians.
    pub residual_rad: f64,
    pub residual_without_rad: f64,
    /// Number of frame pairs between which the robot rotated.
    pub rotations: usize,
}

/// Why the latency cannot be estimated.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub(super) enum NoShift {
    #[error(
        "the robot rotated between only {rotations} pairs of frames, but {LEAST_ROTATIONS} are needed; record a minute in which it rotates left and right, for example with `--policy random`"
    )]
    Rotations { rotations: usize },
    #[error(
        "the standard error of the latency is {:.0} ms, because rotation at a constant rate does not reveal it; record a minute in which the rotation starts and stops often, for example with `--policy random`",
        1000.0 * error_s
    )]
    Uncertain { error_s: f64 },
    #[error(
        "the rotation in frames is {gain:.2} times that of the wheel odometry, but {} to {} is plausible; correct the configuration first: `swap_wheels`, `invert_left`, `invert_right` and `track_m` in [devices.base], [devices.lens], or the camera's mount in [camera]",
        GAINS.0, GAINS.1
    )]
    Gain { gain: f64 },
    #[error(
        "no latency between {:.0} and {:.0} ms makes frames and wheel odometry agree; check that the camera's time stamps use this computer's monotonic clock",
        1000.0 * RANGE_S.0, 1000.0 * RANGE_S.1
    )]
    OutOfRange,
}

/// Estimates the latency with which the rotations of frames and wheels agree best.
pub(super) fn fit(heading: &Heading, measured: &[FrameRotation]) -> Result<Shift, NoShift> {
    let rotations =
        measured.iter().filter(|rotation| rotation.yaw_rad.abs() >= LEAST_ROTATION_RAD).count();
    if rotations < LEAST_ROTATIONS {
        return Err(NoShift::Rotations { rotations });
    }
    let (latency_s, gain) = best(heading, measured)?;
    if !(GAINS.0..=GAINS.1).contains(&gain) {
        return Err(NoShift::Gain { gain });
    }
    let without: Result<Vec<(f64, f64)>, NoShift> = (0..PARTS)
        .map(|part| {
            let from = part * measured.len() / PARTS;
            let to = (part + 1) * measured.len() / PARTS;
            best(heading, &[&measured[..from], &measured[to..]].concat())
        })
        .collect();
    // The jackknife (Efron and Stein 1981).
    let square: f64 = without?.iter().map(|(other_s, _)| (other_s - latency_s).powi(2)).sum();
    let error_s = (square * (PARTS - 1) as f64 / PARTS as f64).sqrt();
    if error_s > MAX_ERROR_S {
        return Err(NoShift::Uncertain { error_s });
    }
    Ok(Shift {
        latency_s,
        error_s,
        residual_rad: residual_rad(heading, measured, latency_s),
        residual_without_rad: residual_rad(heading, measured, 0.0),
        rotations,
    })
}

/// 90th percentile of the difference between frames and wheels, radians.
fn residual_rad(heading: &Heading, measured: &[FrameRotation], latency_s: f64) -> f64 {
    let mut residuals: Vec<f64> = measured
        .iter()
        .map(|rotation| difference(heading, rotation, latency_s, 1.0).0.abs())
        .collect();
    residuals.sort_by(f64::total_cmp);
    residuals.get(9 * residuals.len() / 10).copied().unwrap_or(0.0)
}

/// The best latency in seconds, and the gain: the ratio of the rotation in frames to that of the
/// wheels. The gain differs from 1 because of calibration errors of lens and track, and because the
/// camera is in front of the axle, so that near objects move more. The best of all tried latencies
/// is refined by robust least squares.
fn best(heading: &Heading, measured: &[FrameRotation]) -> Result<(f64, f64), NoShift> {
    let steps = ((RANGE_S.1 - RANGE_S.0) / STEP_S).round() as usize;
    let tried = (0..=steps).map(|step| {
        let latency_s = RANGE_S.0 + STEP_S * step as f64;
        let gain = median_gain(heading, measured, latency_s);
        let squares = measured
            .iter()
            .map(|rotation| (difference(heading, rotation, latency_s, gain).0 / SCALE_RAD).powi(2));
        (squares.map(|square| square / (1.0 + square)).sum::<f64>(), latency_s, gain)
    });
    // The error if all latencies fit equally well.
    let unknown = NoShift::Uncertain { error_s: RANGE_S.1 - RANGE_S.0 };
    let (_, mut latency_s, mut gain) = tried.min_by(|a, b| a.0.total_cmp(&b.0)).ok_or(unknown)?;
    for _ in 0..10 {
        let mut normal = Matrix2::zeros();
        let mut right = Vector2::zeros();
        for rotation in measured {
            let (residual_rad, slope) = difference(heading, rotation, latency_s, gain);
            let weight = (1.0 + (residual_rad / SCALE_RAD).powi(2)).powi(-2);
            normal += slope * slope.transpose() * weight;
            right += slope * residual_rad * weight;
        }
        let step = normal.cholesky().ok_or(unknown)?.solve(&right);
        latency_s += step.x.clamp(-STEP_S, STEP_S);
        gain += step.y;
    }
    if latency_s > RANGE_S.0 && latency_s < RANGE_S.1 {
        Ok((latency_s, gain))
    } else {
        Err(NoShift::OutOfRange)
    }
}

/// Median ratio of the rotation in frames to that of the wheels, for a given latency.
fn median_gain(heading: &Heading, measured: &[FrameRotation], latency_s: f64) -> f64 {
    let mut gains: Vec<f64> = measured
        .iter()
        .map(|rotation| difference(heading, rotation, latency_s, 1.0))
        .filter(|(_, slope)| slope.y.abs() >= LEAST_ROTATION_RAD)
        .map(|(residual_rad, slope)| 1.0 + residual_rad / slope.y)
        .collect();
    gains.sort_by(f64::total_cmp);
    gains.get(gains.len() / 2).copied().unwrap_or(1.0)
}

/// Difference of the rotation in frames and that of the wheels (rad), and the derivative of the
/// wheels' rotation by latency and gain.
fn difference(
    heading: &Heading,
    rotation: &FrameRotation,
    latency_s: f64,
    gain: f64,
) -> (f64, Vector2<f64>) {
    let (from_rad, from_radps) = heading.at(rotation.from_s - latency_s);
    let (to_rad, to_radps) = heading.at(rotation.to_s - latency_s);
    let residual_rad = rotation.yaw_rad - gain * (to_rad - from_rad);
    (residual_rad, Vector2::new(-gain * (to_radps - from_radps), to_rad - from_rad))
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{Pose2, Twist2};
    use proptest::prelude::*;

    /// Heading and yaw rate of a robot that rotates left and right, four times in ten seconds.
    fn swing(time_s: f64) -> (f64, f64) {
        (
            0.4 * (2.5 * time_s).sin() + 0.2 * (0.9 * time_s).sin(),
            (2.5 * time_s).cos() + 0.18 * (0.9 * time_s).cos(),
        )
    }

    /// Wheel odometry at 10 Hz and the rotations in frames with the given latency and gain. Every
    /// fifteenth rotation is an outlier.
    fn drive(
        swing: fn(f64) -> (f64, f64),
        latency_s: f64,
        gain: f64,
        seconds: usize,
    ) -> (Heading, Vec<FrameRotation>) {
        let mut heading = Heading::default();
        let mut measured = Vec::new();
        for index in 0..10 * seconds {
            let time_s = 0.1 * index as f64;
            let (yaw_rad, angular_radps) = swing(time_s);
            heading.push(&WheelFeedback {
                time_ns: 5_000_000_000 + index as u64 * 100_000_000,
                odom: Pose2::new(0.0, 0.0, wrap_angle(yaw_rad)),
                twist: Twist2 { linear_mps: 0.0, angular_radps },
                contact: false,
                cliff: false,
            });
            let after_rad = gain * swing(time_s - latency_s).0;
            let before_rad = gain * swing(time_s - 0.1 - latency_s).0;
            let yaw_rad = if index % 15 == 0 { 0.3 } else { after_rad - before_rad };
            measured.push(FrameRotation { from_s: time_s - 0.1, to_s: time_s, yaw_rad });
        }
        (heading, measured)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_latency_is_found_to_half_a_millisecond(latency_s in -0.08..0.28, gain in 0.9..1.1) {
            let (heading, measured) = drive(swing, latency_s, gain, 60);
            let shift = fit(&heading, &measured).unwrap();
            prop_assert!((shift.latency_s - latency_s).abs() < 5e-4, "{shift:?}");
            prop_assert!(shift.error_s < 5e-3, "{shift:?}");
        }
    }

    #[test]
    fn the_residual_is_smaller_with_the_latency_than_without() {
        let (heading, measured) = drive(swing, 0.08, 1.0, 60);
        let shift = fit(&heading, &measured).unwrap();
        assert!(shift.residual_rad < 0.1 * shift.residual_without_rad, "{shift:?}");
    }

    #[test]
    fn too_few_rotations_or_a_constant_rate_are_refused() {
        let (heading, measured) = drive(|_| (0.0, 0.0), 0.08, 1.0, 20);
        let error = fit(&heading, &measured).unwrap_err();
        assert_eq!(error, NoShift::Rotations { rotations: 14 });
        let (heading, measured) = drive(|time_s| (0.5 * time_s, 0.5), 0.08, 1.0, 60);
        let error = fit(&heading, &measured).unwrap_err();
        assert!(matches!(error, NoShift::Uncertain { .. }), "{error}");
    }

    #[test]
    fn swapped_wheels_and_another_lens_are_not_explained_by_a_latency() {
        for gain in [-1.0, 0.5, 1.4] {
            let (heading, measured) = drive(swing, 0.08, gain, 60);
            let error = fit(&heading, &measured).unwrap_err();
            assert!(
                matches!(error, NoShift::Gain { gain: found } if (found - gain).abs() < 0.01),
                "{gain}: {error}"
            );
        }
    }

    #[test]
    fn invalid_and_old_wheel_feedback_is_ignored() {
        let (mut heading, measured) = drive(swing, 0.08, 1.0, 60);
        let knots = heading.knots.len();
        heading.push(&WheelFeedback {
            time_ns: u64::MAX,
            odom: Pose2::new(0.0, 0.0, f64::NAN),
            ..WheelFeedback::default()
        });
        heading.push(&WheelFeedback { time_ns: 1, ..WheelFeedback::default() });
        assert_eq!(heading.knots.len(), knots);
        assert!(fit(&heading, &measured).is_ok());
    }
}
