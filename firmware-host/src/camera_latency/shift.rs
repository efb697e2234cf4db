//! How much later pictures are stamped than they were taken: by how much the turns that pictures show must be moved in time to
//! be those that the wheels have measured (as Kalibr does for cameras and gyroscopes; Rehder et al. 2016).

use hal::{WheelFeedback, wrap_angle};
use nalgebra::{Matrix2, Vector2};

use super::turn::Turned;

/// Latencies that are tried, seconds, and from one to the next.
const RANGE_S: (f64, f64) = (-0.1, 0.3);
const STEP_S: f64 = 0.01;
/// Robust scale of the difference between two turns, radians.
const SCALE_RAD: f64 = 0.005;
/// The recording is divided into so many parts, to see how much the result depends on one of them.
const PARTS: usize = 8;
/// Fewer turns than this in the whole say nothing, and less than this is no turning, radians.
const LEAST_TURNS: usize = 40;
const LEAST_TURN_RAD: f64 = 0.005;
/// Pictures that turn so many times as far as the wheels say are of a robot that is not as it is said to be. Near things seen
/// from in front of the axle explain a tenth.
const GAINS: (f64, f64) = (0.8, 1.25);
/// A result that is less certain than this is none, seconds.
const WORST_ERROR_S: f64 = 0.01;

/// Where the robot looked, as the wheels say.
#[derive(Debug, Default)]
pub(super) struct Heading {
    begin_ns: Option<u64>,
    /// Seconds since the first, unwrapped radians and radians a second, in order of time.
    knots: Vec<[f64; 3]>,
}

impl Heading {
    /// Adds a measurement; one that is not finite or not newer is left out.
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

    /// Since the first measurement.
    pub fn seconds(&mut self, time_ns: u64) -> f64 {
        let begin_ns = *self.begin_ns.get_or_insert(time_ns);
        (time_ns as f64 - begin_ns as f64) * 1e-9
    }

    /// Heading and rate at a time: a cubic that has the measured headings and rates (Hermite). At the ends, the nearest.
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
        let (rise, begin, end) = (y1 - y0, r0 * span, r1 * span);
        let (square, cube) = (3.0 * rise - 2.0 * begin - end, begin + end - 2.0 * rise);
        (
            y0 + x * (begin + x * (square + x * cube)),
            (begin + x * (2.0 * square + x * 3.0 * cube)) / span,
        )
    }
}

/// What fits best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    /// Pictures show what was so long before their stamps.
    pub latency_s: f64,
    /// Standard error of that, by leaving out an eighth of the recording at a time.
    pub error_s: f64,
    /// Nine of ten turns of pictures and wheels differ by no more than this with this latency, and with none, radians.
    pub off_rad: f64,
    pub off_without_rad: f64,
    /// Pairs of pictures between which the robot turned.
    pub turns: usize,
}

/// Why there is no latency to tell.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub(super) enum NoShift {
    #[error(
        "the robot turned between {turns} pairs of pictures only, {LEAST_TURNS} are needed; record a minute in which it turns to and fro, as with `--policy random`"
    )]
    Turns { turns: usize },
    #[error(
        "the latency is known to {:.0} ms only: turning at one speed does not show it, beginning and ending to turn does; record a minute with `--policy random`",
        1000.0 * error_s
    )]
    Change { error_s: f64 },
    #[error(
        "pictures turn {gain:.2} times as far as the wheels say, {} to {} is plausible; put that right first: `swap_wheels`, `invert_left`, `invert_right` and `track_m` in [devices.base], [devices.lens], the camera's mount in [camera]",
        GAINS.0, GAINS.1
    )]
    Gain { gain: f64 },
    #[error(
        "no latency between {:.0} and {:.0} ms explains what pictures and wheels say; are the camera's stamps of this computer's monotonic clock?",
        1000.0 * RANGE_S.0, 1000.0 * RANGE_S.1
    )]
    OutOfRange,
}

/// The latency under which the turns of pictures and wheels agree best.
pub(super) fn fit(heading: &Heading, turned: &[Turned]) -> Result<Shift, NoShift> {
    let turns = turned.iter().filter(|turned| turned.yaw_rad.abs() >= LEAST_TURN_RAD).count();
    if turns < LEAST_TURNS {
        return Err(NoShift::Turns { turns });
    }
    let (latency_s, gain) = best(heading, turned)?;
    if !(GAINS.0..=GAINS.1).contains(&gain) {
        return Err(NoShift::Gain { gain });
    }
    let without: Result<Vec<(f64, f64)>, NoShift> = (0..PARTS)
        .map(|part| {
            let (from, to) = (part * turned.len() / PARTS, (part + 1) * turned.len() / PARTS);
            best(heading, &[&turned[..from], &turned[to..]].concat())
        })
        .collect();
    // The jackknife (Efron and Stein 1981).
    let square: f64 = without?.iter().map(|(other_s, _)| (other_s - latency_s).powi(2)).sum();
    let error_s = (square * (PARTS - 1) as f64 / PARTS as f64).sqrt();
    if error_s > WORST_ERROR_S {
        return Err(NoShift::Change { error_s });
    }
    let off = |latency_s| {
        let mut off: Vec<f64> = turned
            .iter()
            .map(|turned| difference(heading, turned, latency_s, 1.0).0.abs())
            .collect();
        off.sort_by(f64::total_cmp);
        off.get(9 * off.len() / 10).copied().unwrap_or(0.0)
    };
    Ok(Shift { latency_s, error_s, off_rad: off(latency_s), off_without_rad: off(0.0), turns })
}

/// The best latency of all that are tried, refined, seconds, and how many times as far pictures turn as wheels: lens and track
/// are not quite as they are said to be, and the camera sits in front of the axle, so that what is near moves more.
fn best(heading: &Heading, turned: &[Turned]) -> Result<(f64, f64), NoShift> {
    let steps = ((RANGE_S.1 - RANGE_S.0) / STEP_S).round() as usize;
    let tried = (0..=steps).map(|step| {
        let latency_s = RANGE_S.0 + STEP_S * step as f64;
        let gain = median_gain(heading, turned, latency_s);
        let squares = turned
            .iter()
            .map(|turned| (difference(heading, turned, latency_s, gain).0 / SCALE_RAD).powi(2));
        (squares.map(|square| square / (1.0 + square)).sum::<f64>(), latency_s, gain)
    });
    // Where any latency explains it as well, none is known.
    let unknown = NoShift::Change { error_s: RANGE_S.1 - RANGE_S.0 };
    let (_, mut latency_s, mut gain) = tried.min_by(|a, b| a.0.total_cmp(&b.0)).ok_or(unknown)?;
    for _ in 0..10 {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for turned in turned {
            let (off_rad, slope) = difference(heading, turned, latency_s, gain);
            let weight = (1.0 + (off_rad / SCALE_RAD).powi(2)).powi(-2);
            normal += slope * slope.transpose() * weight;
            right += slope * off_rad * weight;
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

/// How many times as far pictures turn as wheels with this latency, in the median.
fn median_gain(heading: &Heading, turned: &[Turned], latency_s: f64) -> f64 {
    let gain = |turned| {
        let (off_rad, slope) = difference(heading, turned, latency_s, 1.0);
        (slope.y.abs() >= LEAST_TURN_RAD).then(|| 1.0 + off_rad / slope.y)
    };
    let mut gains: Vec<f64> = turned.iter().filter_map(gain).collect();
    gains.sort_by(f64::total_cmp);
    gains.get(gains.len() / 2).copied().unwrap_or(1.0)
}

/// By how much pictures turned farther than wheels, and how the wheels' turn answers to latency and gain.
fn difference(
    heading: &Heading,
    turned: &Turned,
    latency_s: f64,
    gain: f64,
) -> (f64, Vector2<f64>) {
    let (from, to) = (heading.at(turned.from_s - latency_s), heading.at(turned.to_s - latency_s));
    (turned.yaw_rad - gain * (to.0 - from.0), Vector2::new(-gain * (to.1 - from.1), to.0 - from.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{Pose2, Twist2};
    use proptest::prelude::*;

    /// A robot that turns to and fro, four times in ten seconds; heading and rate.
    fn swing(time_s: f64) -> (f64, f64) {
        (
            0.4 * (2.5 * time_s).sin() + 0.2 * (0.9 * time_s).sin(),
            (2.5 * time_s).cos() + 0.18 * (0.9 * time_s).cos(),
        )
    }

    /// Ten measurements a second for so long, and what pictures say that are so late; every fifteenth pair is nonsense.
    fn drive(
        swing: fn(f64) -> (f64, f64),
        latency_s: f64,
        gain: f64,
        seconds: usize,
    ) -> (Heading, Vec<Turned>) {
        let mut heading = Heading::default();
        let mut turned = Vec::new();
        for index in 0..10 * seconds {
            let time_s = 0.1 * index as f64;
            let (yaw_rad, angular_radps) = swing(time_s);
            heading.push(&WheelFeedback {
                time_ns: 5_000_000_000 + index as u64 * 100_000_000,
                odom: Pose2::new(0.0, 0.0, wrap_angle(yaw_rad)),
                twist: Twist2 { linear_mps: 0.0, angular_radps },
                contact: false,
            });
            let shown = |time_s: f64| gain * swing(time_s - latency_s).0;
            let yaw_rad = if index % 15 == 0 { 0.3 } else { shown(time_s) - shown(time_s - 0.1) };
            turned.push(Turned { from_s: time_s - 0.1, to_s: time_s, yaw_rad });
        }
        (heading, turned)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_latency_is_found_to_half_a_millisecond(latency_s in -0.08..0.28, gain in 0.9..1.1) {
            let (heading, turned) = drive(swing, latency_s, gain, 60);
            let shift = fit(&heading, &turned).unwrap();
            prop_assert!((shift.latency_s - latency_s).abs() < 5e-4, "{shift:?}");
            prop_assert!(shift.error_s < 5e-3, "{shift:?}");
        }
    }

    #[test]
    fn it_says_how_much_better_pictures_and_wheels_agree() {
        let (heading, turned) = drive(swing, 0.08, 1.0, 60);
        let shift = fit(&heading, &turned).unwrap();
        assert!(shift.off_rad < 0.1 * shift.off_without_rad, "{shift:?}");
    }

    #[test]
    fn a_robot_that_hardly_turned_or_only_at_one_speed_is_told_what_to_do() {
        let (heading, turned) = drive(|_| (0.0, 0.0), 0.08, 1.0, 20);
        let error = fit(&heading, &turned).unwrap_err();
        assert_eq!(error, NoShift::Turns { turns: 14 });
        let (heading, turned) = drive(|time_s| (0.5 * time_s, 0.5), 0.08, 1.0, 60);
        let error = fit(&heading, &turned).unwrap_err();
        assert!(matches!(error, NoShift::Change { .. }), "{error}");
    }

    #[test]
    fn swapped_wheels_and_another_lens_are_not_explained_by_a_latency() {
        for gain in [-1.0, 0.5, 1.4] {
            let (heading, turned) = drive(swing, 0.08, gain, 60);
            let error = fit(&heading, &turned).unwrap_err();
            assert!(
                matches!(error, NoShift::Gain { gain: found } if (found - gain).abs() < 0.01),
                "{gain}: {error}"
            );
        }
    }

    #[test]
    fn wheels_that_say_nothing_sensible_are_left_out() {
        let (mut heading, turned) = drive(swing, 0.08, 1.0, 60);
        let knots = heading.knots.len();
        heading.push(&WheelFeedback {
            time_ns: u64::MAX,
            odom: Pose2::new(0.0, 0.0, f64::NAN),
            ..WheelFeedback::default()
        });
        heading.push(&WheelFeedback { time_ns: 1, ..WheelFeedback::default() });
        assert_eq!(heading.knots.len(), knots);
        assert!(fit(&heading, &turned).is_ok());
    }
}
