//! What the gyroscope reports, and what it gets wrong.
//!
//! A gyroscope measures short rotations ten times better than wheels and scans do, but it rotates while it stands (bias), and reports
//! each rotation a little too large or too small (scale). Scans say both, because what they measure does not drift.

use hal::{Pose2, wrap_angle};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::LocalizationConfig;
use super::wheel_model::{Motion, bent_chord};
use super::yaw_errors::{MAX_SURPRISE, YawErrors};

/// Before anything is learnt: standard deviations of bias and scale. Data sheets: a BMI160 rotates by up to 3 degrees per second while it
/// stands, an LSM6DSOX by 1, both are wrong by 1 to 3 % of a rotation.
const FIRST_BIAS_RADPS: f64 = 0.05;
const FIRST_SCALE: f64 = 0.03;
/// Random walk of the bias, rad/s after one second: its temperature changes by a degree in five minutes, with 0.05 degrees per second
/// for each degree.
const BIAS_WALK_RADPS: f64 = 5e-5;
/// Change of the scale over one radian.
const SCALE_WALK: f64 = 0.0005;
/// The numbers are learnt from stretches of this length: a second, or a rotation by this angle.
const LEG_S: f64 = 1.0;
const LEG_RAD: f64 = 0.3;
/// A stretch that took longer, as while no scan fits, says little.
const LONGEST_LEG_S: f64 = 60.0;
/// After this many surprises without an agreeing rotation in between, what was learnt is wrong.
const MAX_SURPRISES: u32 = 3;
/// Standard deviation of the bias from which it is then learnt again: an MPU-6050 rotates by up to 20 degrees per second while it stands.
const ANY_BIAS_RADPS: f64 = 0.5;
/// Rotations that agree with the scans end a row of surprises; straight stretches do not, because a unit with the wrong sign agrees there.
const ROTATION_RAD: f64 = 0.2;
/// A unit that had to be learnt again this often measures something else than the yaw of the robot: its axis or its sign is wrong. It is not
/// used any more.
const MAX_RESETS: u32 = 3;
/// After this many agreeing rotations one after the other, the unit counts as one that never had to be learnt again.
const AGREEING_ROTATIONS: u32 = 20;

/// An integrated angle of the gyroscope.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct GyroAngle {
    pub time_ns: u64,
    /// Angles with other counts cannot be compared with this one.
    pub gaps: u32,
    pub yaw_rad: f64,
}

/// A rotation that the gyroscope measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rotation {
    pub yaw_rad: f64,
    /// rad^2.
    pub variance: f64,
}

/// The learnt numbers, and the stretch that is being measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct GyroModel {
    /// Standard deviation of the angle after one second, rad.
    noise: f64,
    /// Per second, and per radian.
    errors: YawErrors,
    surprises: u32,
    resets: u32,
    /// Rotations that agreed since the last surprise.
    agreeing: u32,
    last: Option<GyroAngle>,
    /// Yaw by the scans at the beginning of the stretch, and its variance.
    from: Option<(f64, f64)>,
    seconds: f64,
    yaw_rad: f64,
}

impl GyroModel {
    pub(crate) fn new(config: &LocalizationConfig) -> Self {
        Self {
            noise: config.gyro_noise,
            errors: YawErrors::new([FIRST_BIAS_RADPS, FIRST_SCALE]),
            surprises: 0,
            resets: 0,
            agreeing: 0,
            last: None,
            from: None,
            seconds: 0.0,
            yaw_rad: 0.0,
        }
    }

    /// The rotation since the last angle; `None` without one, and after an interruption.
    pub(crate) fn advance(&mut self, now: Option<GyroAngle>) -> Option<Rotation> {
        let reported = self.since_last(now);
        self.last = now;
        let reported = reported.filter(|_| !self.is_refused());
        let Some(reported) = reported else {
            self.forget_leg();
            return None;
        };
        let bias_change = BIAS_WALK_RADPS * BIAS_WALK_RADPS * reported.x.abs();
        let scale_change = SCALE_WALK * SCALE_WALK * reported.y.abs();
        self.errors.forget([bias_change, scale_change]);
        self.seconds += reported.x;
        self.yaw_rad += reported.y;
        Some(self.correct(&reported))
    }

    /// As [`advance`](Self::advance), without moving on.
    pub(crate) fn rotation(&self, now: Option<GyroAngle>) -> Option<Rotation> {
        let reported = self.since_last(now).filter(|_| !self.is_refused())?;
        Some(self.correct(&reported))
    }

    /// The unit contradicts the scans again and again, and is not used any more.
    pub(crate) fn is_refused(&self) -> bool {
        self.resets >= MAX_RESETS
    }

    /// Seconds and radians since the last angle. Both are negative where the scan is older than the wheels before it.
    fn since_last(&self, now: Option<GyroAngle>) -> Option<Vector2<f64>> {
        let now = now?;
        let last = self.last.filter(|last| last.gaps == now.gaps)?;
        let seconds = if now.time_ns >= last.time_ns {
            (now.time_ns - last.time_ns) as f64
        } else {
            -((last.time_ns - now.time_ns) as f64)
        };
        Some(Vector2::new(seconds * 1e-9, now.yaw_rad - last.yaw_rad))
    }

    fn correct(&self, reported: &Vector2<f64>) -> Rotation {
        Rotation {
            yaw_rad: reported.y + self.errors.unreported(reported),
            variance: self.errors.variance(reported)
                + self.noise * self.noise * reported.x.abs()
                + 1e-10,
        }
    }

    /// The scans say that the robot has this yaw, with this variance.
    pub(crate) fn observe(&mut self, yaw_rad: f64, variance: f64) {
        let Some((from_rad, from_variance)) = self.from else {
            self.begin_leg(yaw_rad, variance);
            return;
        };
        if self.seconds < LEG_S && self.yaw_rad.abs() < LEG_RAD {
            return;
        }
        if self.seconds > LONGEST_LEG_S {
            self.begin_leg(yaw_rad, variance);
            return;
        }
        let reported = Vector2::new(self.seconds, self.yaw_rad);
        let unreported_rad = wrap_angle(yaw_rad - from_rad - self.yaw_rad);
        let noise = variance + from_variance + self.noise * self.noise * self.seconds.abs();
        let is_learnt = self.errors.learn(&reported, unreported_rad, noise);
        self.judge(is_learnt);
        self.begin_leg(yaw_rad, variance);
    }

    /// Takes note whether a stretch agreed with what was learnt.
    fn judge(&mut self, agrees: bool) {
        let rotates = self.yaw_rad.abs() > ROTATION_RAD;
        if !agrees {
            self.agreeing = 0;
            self.surprises = self.surprises.saturating_add(1);
            // The bias is as uncertain as at the start, so that wheels count more until it is known again.
            self.errors.forget([FIRST_BIAS_RADPS * FIRST_BIAS_RADPS, 0.0]);
        } else if rotates {
            self.surprises = 0;
            self.agreeing = self.agreeing.saturating_add(1);
        }
        if self.agreeing >= AGREEING_ROTATIONS {
            self.resets = 0;
        }
        if self.surprises >= MAX_SURPRISES {
            self.errors = YawErrors::new([ANY_BIAS_RADPS, FIRST_SCALE]);
            self.surprises = 0;
            self.resets = self.resets.saturating_add(1);
        }
    }

    fn begin_leg(&mut self, yaw_rad: f64, variance: f64) {
        self.forget_leg();
        self.from = Some((yaw_rad, variance));
    }

    /// The present stretch says nothing: a scan did not fit, or the robot was carried.
    pub(crate) fn forget_leg(&mut self) {
        self.from = None;
        self.seconds = 0.0;
        self.yaw_rad = 0.0;
    }

    /// Radians per second, and radians per radian, that the gyroscope does not report.
    pub(crate) fn errors(&self) -> [f64; 2] {
        self.errors.numbers()
    }
}

/// A motion by the wheels, with the yaw of both sensors: each counts by its variance. Where they contradict each other, wheels slip or the
/// robot is rotated by hand, and the gyroscope counts alone.
pub(crate) fn join(motion: &Motion, rotation: &Rotation) -> Motion {
    let by_wheels = motion.covariance[(2, 2)];
    let both = by_wheels + rotation.variance;
    let difference = wrap_angle(rotation.yaw_rad - motion.pose.yaw_rad);
    let mut covariance = motion.covariance;
    let mut correction = difference;
    if difference * difference > MAX_SURPRISE * MAX_SURPRISE * both {
        covariance[(2, 2)] = rotation.variance;
    } else {
        correction *= by_wheels / both;
        covariance[(2, 2)] = by_wheels * rotation.variance / both;
    }
    let [x_m, y_m] = bent_chord(&motion.pose, correction);
    Motion { pose: Pose2::new(x_m, y_m, motion.pose.yaw_rad + correction), covariance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    const TICK_S: f64 = 0.1;

    /// A robot that rotates to and fro and stands, and its gyroscope.
    struct Bench {
        model: GyroModel,
        time_ns: u64,
        truth_rad: f64,
        reported_rad: f64,
        gaps: u32,
    }

    impl Bench {
        fn new() -> Self {
            Self {
                model: GyroModel::new(&LocalizationConfig::default()),
                time_ns: 0,
                truth_rad: 0.0,
                reported_rad: 0.0,
                gaps: 0,
            }
        }

        fn angle(&self) -> GyroAngle {
            GyroAngle { time_ns: self.time_ns, gaps: self.gaps, yaw_rad: self.reported_rad }
        }

        /// One tick with this true rotation, measured with a bias and a scale.
        fn tick(&mut self, yaw_rad: f64, bias_radps: f64, scale: f64) -> Option<Rotation> {
            self.time_ns += (TICK_S * 1e9) as u64;
            self.truth_rad += yaw_rad;
            self.reported_rad += yaw_rad * scale + bias_radps * TICK_S;
            let rotation = self.model.advance(Some(self.angle()));
            self.model.observe(wrap_angle(self.truth_rad), 1e-6);
            rotation
        }

        fn drive(&mut self, ticks: u32, bias_radps: f64, scale: f64) {
            for tick in 0..ticks {
                let yaw_rad = [0.0, 0.07, 0.0, -0.07][(tick / 20 % 4) as usize];
                self.tick(yaw_rad, bias_radps, scale);
            }
        }
    }

    #[test]
    fn bias_and_scale_are_learnt_from_scans() {
        for [bias_radps, scale] in [[0.05, 1.02], [-0.02, 0.97], [0.0, 1.0]] {
            let mut bench = Bench::new();
            bench.drive(600, bias_radps, scale);
            let rotation = bench.tick(0.07, bias_radps, scale).unwrap();
            assert!((rotation.yaw_rad - 0.07).abs() < 3e-4, "{bias_radps} {scale}: {rotation:?}");
            assert!(rotation.variance.sqrt() < 3e-4, "{rotation:?}");
        }
    }

    #[test]
    fn before_anything_is_learnt_the_rotation_is_uncertain_by_the_bias_of_such_sensors() {
        let mut bench = Bench::new();
        bench.model.advance(Some(bench.angle()));
        bench.time_ns += 1_000_000_000;
        let rotation = bench.model.advance(Some(bench.angle())).unwrap();
        assert!((rotation.variance.sqrt() - FIRST_BIAS_RADPS).abs() < 1e-3, "{rotation:?}");
    }

    #[test]
    fn a_bias_that_jumps_is_learnt_again() {
        let mut bench = Bench::new();
        bench.drive(600, 0.02, 1.0);
        bench.drive(300, -0.3, 1.0);
        let rotation = bench.tick(0.0, -0.3, 1.0).unwrap();
        assert!(rotation.yaw_rad.abs() < 1e-3, "{rotation:?}");
    }

    #[test]
    fn across_an_interruption_there_is_no_rotation_and_nothing_is_learnt() {
        let mut bench = Bench::new();
        bench.drive(600, 0.02, 1.0);
        let learnt = bench.model.errors();
        bench.gaps = 1;
        bench.reported_rad = 0.0;
        assert_eq!(bench.tick(0.07, 0.02, 1.0), None);
        assert_eq!(bench.model.advance(None), None);
        assert_eq!(bench.tick(0.07, 0.02, 1.0), None);
        assert_eq!(bench.model.errors(), learnt);
        let rotation = bench.tick(0.07, 0.02, 1.0).unwrap();
        assert!((rotation.yaw_rad - 0.07).abs() < 3e-4);
    }

    #[test]
    fn a_scan_older_than_the_wheels_before_it_takes_a_rotation_back() {
        let mut bench = Bench::new();
        bench.drive(600, 0.02, 1.0);
        let later = bench.angle();
        let earlier = GyroAngle {
            time_ns: later.time_ns - 50_000_000,
            yaw_rad: later.yaw_rad - 0.035 - 0.001,
            ..later
        };
        let back = bench.model.advance(Some(earlier)).unwrap();
        assert!((back.yaw_rad + 0.035).abs() < 1e-4, "{back:?}");
        let forth = bench.model.advance(Some(later)).unwrap();
        assert!((back.yaw_rad + forth.yaw_rad).abs() < 1e-12);
    }

    fn motion(yaw_rad: f64, yaw_std: f64) -> Motion {
        let variances = Vector3::new(1e-6, 1e-6, yaw_std * yaw_std);
        Motion {
            pose: Pose2::new(0.03, 0.0, yaw_rad),
            covariance: Matrix3::from_diagonal(&variances),
        }
    }

    #[test]
    fn of_wheels_and_gyroscope_the_surer_one_counts_more() {
        let rotation = Rotation { yaw_rad: 0.011, variance: 1e-8 };
        let joined = join(&motion(0.010, 3e-4), &rotation);
        assert!((joined.pose.yaw_rad - 0.0109).abs() < 1e-9, "{:?}", joined.pose);
        assert!((joined.covariance[(2, 2)] - 0.9e-8).abs() < 1e-12);
        // The chord of the arc rotates by half of the correction.
        assert!((joined.pose.y_m - 0.03 * 0.00045).abs() < 1e-9, "{:?}", joined.pose);
    }

    #[test]
    fn wheels_that_report_a_rotation_which_the_gyroscope_denies_are_not_believed() {
        let rotation = Rotation { yaw_rad: 0.0, variance: 1e-8 };
        let joined = join(&motion(0.07, 3e-3), &rotation);
        assert!(joined.pose.yaw_rad.abs() < 1e-12);
        assert!((joined.covariance[(2, 2)] - 1e-8).abs() < 1e-15);
    }
}
