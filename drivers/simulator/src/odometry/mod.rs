//! Dead reckoning from wheels, with the errors that wheels make.

mod slip;

use hal::Pose2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::error::SceneError;
use crate::random::normal;
use slip::Slips;

/// Distance between the wheels for errors of one wheel alone, metres: the default of
/// `[devices.base] track_m`.
pub(crate) const TRACK_M: f64 = 0.24;

/// How wrong wheel odometry is. The random errors follow Thrun, Burgard and Fox, "Probabilistic
/// Robotics" (2005), 5.4, but with variances that grow with the distance, so that they do not depend
/// on the length of the simulation step. The systematic errors are those of Borenstein and Feng,
/// "Measurement and Correction of Systematic Odometry Errors in Mobile Robots" (1996): wheels that
/// are larger, smaller and farther apart than configured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryNoise {
    /// Standard deviation of the distance after one metre, as a fraction of it.
    pub translation: f64,
    /// Standard deviation of a rotation of one radian, as a fraction of it.
    pub rotation: f64,
    /// Standard deviation of the heading after one metre, rad; it grows with the square root of the
    /// distance (bumps, joints of tiles).
    pub heading_drift_rad: f64,
    /// Standard deviation, over robots, of a heading error that stays the same for each metre of a
    /// run, rad/m (unequal wheels, load on one side).
    pub heading_bias_rad_per_m: f64,
    /// Largest relative error of the configured wheel radius; uniformly distributed over robots.
    pub radius: f64,
    /// Largest relative error of the configured track; uniformly distributed over robots.
    pub track: f64,
    /// Mean number of slips of one wheel per 100 m of travel at the rim.
    pub slips_per_100m: f64,
    /// Largest distance that a wheel reports too much in one slip, metres. The smallest is a
    /// quarter.
    pub slip_m: f64,
    /// How the wheels really are.
    pub wheels: WheelErrors,
}

/// Known differences of the wheels from their configuration, beside those that are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelErrors {
    /// True radius of the left wheel over the configured one, minus 1.
    pub left: f64,
    /// True radius of the right wheel over the configured one, minus 1.
    pub right: f64,
    /// True distance between the wheels over the configured one, minus 1.
    pub track: f64,
}

impl WheelErrors {
    /// What a robot with such wheels believes of a motion.
    fn believed(&self, motion: &Pose2) -> Pose2 {
        if *self == Self::default() {
            return *motion;
        }
        let half_track_m = TRACK_M * (1.0 + self.track) / 2.0;
        let left_m = (motion.x_m - motion.yaw_rad * half_track_m) / (1.0 + self.left);
        let right_m = (motion.x_m + motion.yaw_rad * half_track_m) / (1.0 + self.right);
        Pose2::new((left_m + right_m) / 2.0, motion.y_m, (right_m - left_m) / TRACK_M)
    }
}

impl OdometryNoise {
    /// Odometry without any error.
    pub const NONE: Self = Self {
        translation: 0.0,
        rotation: 0.0,
        heading_drift_rad: 0.0,
        heading_bias_rad_per_m: 0.0,
        radius: 0.0,
        track: 0.0,
        slips_per_100m: 0.0,
        slip_m: 0.0,
        wheels: WheelErrors { left: 0.0, right: 0.0, track: 0.0 },
    };

    /// An ordinary indoor base.
    ///
    /// * 1 % of distances and 2 % of rotations: what a base with encoders reaches on hard floor.
    /// * 0.0035 rad after one metre: 0.2 degrees.
    /// * 0.03 rad/m of bias: two logs of real robots were measured, Intel Research Lab with
    ///   -0.065 rad/m and Freiburg building 079 with about -0.019 rad/m.
    /// * 1 % of radius and track: a radius measured with a tape and a tyre under load; Borenstein
    ///   and Feng found 0.1 % to 1 %.
    /// * Three slips per 100 m of 1 to 4 cm at one wheel, 2.4 to 9.5 degrees each (a threshold, the
    ///   edge of a carpet, a cable): our own choice.
    pub const ORDINARY: Self = Self {
        translation: 0.01,
        rotation: 0.02,
        heading_drift_rad: 0.0035,
        heading_bias_rad_per_m: 0.03,
        radius: 0.01,
        track: 0.01,
        slips_per_100m: 3.0,
        slip_m: 0.04,
        wheels: WheelErrors { left: 0.0, right: 0.0, track: 0.0 },
    };

    /// Checks the range of every field.
    ///
    /// # Errors
    /// Reports the first field that is not a number in its range.
    pub fn check(&self) -> Result<(), SceneError> {
        let fields = [
            ("odometry translation noise", self.translation),
            ("odometry rotation noise", self.rotation),
            ("odometry heading drift", self.heading_drift_rad),
            ("odometry heading bias", self.heading_bias_rad_per_m),
            ("odometry radius error", self.radius),
            ("odometry track error", self.track),
            ("odometry slip size", self.slip_m),
        ];
        let unit = fields.into_iter().map(|(option, value)| (option, value, 1.0));
        let rate = [("odometry slips per 100 m", self.slips_per_100m, 1000.0)];
        let WheelErrors { left, right, track } = self.wheels;
        if ![left, right, track].iter().all(|error| (-0.5..=0.5).contains(error)) {
            return Err(SceneError::Option {
                option: "wheel errors",
                value: format!("{:?}", self.wheels),
                allowed: "numbers from -0.5 to 0.5",
            });
        }
        match unit.chain(rate).find(|(_, value, max)| !(0.0..=*max).contains(value)) {
            Some((option, value, max)) => Err(SceneError::Option {
                option,
                value: value.to_string(),
                allowed: if max > 1.0 { "a number from 0 to 1000" } else { "a number from 0 to 1" },
            }),
            None => Ok(()),
        }
    }
}

impl Default for OdometryNoise {
    fn default() -> Self {
        Self::ORDINARY
    }
}

/// Integrates the motion that the wheels measure. It starts at the identity.
#[derive(Debug, Clone)]
pub struct Odometer {
    noise: OdometryNoise,
    rng: Pcg64Mcg,
    /// Measured by true distance, and measured by true rotation.
    distance_factor: f64,
    rotation_factor: f64,
    bias_rad_per_m: f64,
    slips: Slips,
    t_odom_base: Pose2,
}

impl Odometer {
    /// Creates an odometer at the identity. The same seed gives the same errors.
    #[must_use]
    pub fn new(noise: OdometryNoise, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let distance_factor = 1.0 + noise.radius * rng.random_range(-1.0..=1.0);
        let track_factor = 1.0 + noise.track * rng.random_range(-1.0..=1.0);
        let bias_rad_per_m = noise.heading_bias_rad_per_m * normal(&mut rng);
        let slips = Slips::new(noise.slips_per_100m, noise.slip_m, rng.random());
        Self {
            noise,
            rng,
            distance_factor,
            rotation_factor: distance_factor / track_factor,
            bias_rad_per_m,
            slips,
            t_odom_base: Pose2::IDENTITY,
        }
    }

    /// The wheels change: from now on they really are like this.
    pub(crate) fn set_wheels(&mut self, wheels: WheelErrors) {
        self.noise.wheels = wheels;
    }

    /// Adds a small true motion of the base, given in the base frame before the motion.
    pub fn advance(&mut self, t_before_after: &Pose2) {
        let length = t_before_after.x_m.hypot(t_before_after.y_m);
        let rotation = t_before_after.yaw_rad;
        let [stretch, skid, drift] = [(); 3].map(|()| normal(&mut self.rng));
        let factor = if length > 0.0 {
            self.distance_factor + self.noise.translation * stretch / length.sqrt()
        } else {
            0.0
        };
        // Unequal wheels bend a path to the other side when it is driven backwards.
        let forward_m = length.copysign(t_before_after.x_m);
        let yaw = rotation * self.rotation_factor
            + self.noise.rotation * skid * rotation.abs().sqrt()
            + self.noise.heading_drift_rad * drift * length.sqrt()
            + self.bias_rad_per_m * forward_m;
        let slip = self.slips.during(forward_m, rotation);
        let measured = Pose2::new(
            t_before_after.x_m * factor + slip.forward_m,
            t_before_after.y_m * factor,
            yaw + slip.yaw_rad,
        );
        self.t_odom_base = self.t_odom_base.compose(&self.noise.wheels.believed(&measured));
    }

    /// The measured pose `t_odom_base`.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        self.t_odom_base
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Twist2;
    use proptest::prelude::*;

    fn drive(noise: OdometryNoise, seed: u64, steps: usize, step: &Pose2) -> Pose2 {
        let mut odometer = Odometer::new(noise, seed);
        (0..steps).for_each(|_| odometer.advance(step));
        odometer.pose()
    }

    fn ends(noise: OdometryNoise, steps: usize, step: &Pose2) -> Vec<Pose2> {
        (0..400).map(|seed| drive(noise, seed, steps, step)).collect()
    }

    fn rms(error: &dyn Fn(&Pose2) -> f64, ends: &[Pose2]) -> f64 {
        (ends.iter().map(|end| error(end).powi(2)).sum::<f64>() / ends.len() as f64).sqrt()
    }

    proptest! {
        #[test]
        fn without_noise_odometry_is_the_truth(v in -1.0..1.0, w in -2.0..2.0, seed: u64) {
            let twist = Twist2 { linear_mps: v, angular_radps: w };
            let odom = drive(OdometryNoise::NONE, seed, 200, &twist.integrate(0.01));
            let truth = twist.integrate(2.0);
            prop_assert!(odom.distance_m(&truth) < 1e-9);
            prop_assert!(hal::wrap_angle(odom.yaw_rad - truth.yaw_rad).abs() < 1e-9);
        }
    }

    #[test]
    fn a_robot_with_a_large_left_wheel_believes_that_it_drives_less_far_and_bends_left() {
        let wheels = WheelErrors { left: 0.02, ..WheelErrors::default() };
        let noise = OdometryNoise { wheels, ..OdometryNoise::NONE };
        let straight = drive(noise, 1, 1, &Pose2::new(1.0, 0.0, 0.0));
        let left_m = 1.0 / 1.02;
        assert!((straight.yaw_rad - (1.0 - left_m) / TRACK_M).abs() < 1e-12);
        assert!((straight.x_m - (1.0 + left_m) / 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_robot_whose_wheels_are_farther_apart_than_it_knows_believes_that_it_rotates_more() {
        let wheels = WheelErrors { track: 0.05, ..WheelErrors::default() };
        let noise = OdometryNoise { wheels, ..OdometryNoise::NONE };
        let rotated = drive(noise, 1, 1, &Pose2::new(0.0, 0.0, 0.5));
        assert!((rotated.yaw_rad - 0.525).abs() < 1e-12 && rotated.x_m.abs() < 1e-12);
        let absurd = WheelErrors { track: f64::NAN, ..WheelErrors::default() };
        assert!(OdometryNoise { wheels: absurd, ..OdometryNoise::NONE }.check().is_err());
    }

    #[test]
    fn random_errors_have_the_stated_size_for_any_step_length() {
        let noise = OdometryNoise {
            translation: 0.02,
            rotation: 0.03,
            heading_drift_rad: 0.01,
            ..OdometryNoise::NONE
        };
        for cuts in [20, 500] {
            // After 4 m: 0.02 * sqrt(4), and the heading's 0.01 * sqrt(4).
            let straight = ends(noise, cuts, &Pose2::new(4.0 / cuts as f64, 0.0, 0.0));
            // The path bends, which shortens it by far less than it is wrong.
            assert!((rms(&|end| end.x_m - 4.0, &straight) / 0.04 - 1.0).abs() < 0.12);
            assert!((rms(&|end| end.yaw_rad, &straight) / 0.02 - 1.0).abs() < 0.12);
            let rotated = ends(noise, cuts, &Pose2::new(0.0, 0.0, 2.0 / cuts as f64));
            assert!(
                (rms(&|end| end.yaw_rad - 2.0, &rotated) / (0.03 * 2f64.sqrt()) - 1.0).abs() < 0.12
            );
        }
    }

    #[test]
    fn radius_and_track_are_wrong_by_up_to_the_stated_part_and_stay_so() {
        let noise = OdometryNoise { radius: 0.01, track: 0.01, ..OdometryNoise::NONE };
        let mut largest: f64 = 0.0;
        for seed in 0..300 {
            let metre = drive(noise, seed, 10, &Pose2::new(0.1, 0.0, 0.0)).x_m;
            let ten = drive(noise, seed, 100, &Pose2::new(0.1, 0.0, 0.0)).x_m;
            assert!((ten / metre - 10.0).abs() < 1e-9);
            let radian = drive(noise, seed, 10, &Pose2::new(0.0, 0.0, 0.1)).yaw_rad;
            // A larger track makes the same wheels rotate the robot less.
            let track = metre / radian;
            assert!((metre - 1.0).abs() <= 0.01 + 1e-12 && (track - 1.0).abs() <= 0.01 + 1e-12);
            largest = largest.max((metre - 1.0).abs());
        }
        assert!(largest > 0.009, "{largest}");
    }

    #[test]
    fn the_heading_bias_grows_with_every_metre_and_is_undone_by_driving_back() {
        let noise = OdometryNoise { heading_bias_rad_per_m: 0.03, ..OdometryNoise::NONE };
        let five = ends(noise, 500, &Pose2::new(0.01, 0.0, 0.0));
        assert!((rms(&|end| end.yaw_rad, &five) / 0.15 - 1.0).abs() < 0.12);
        let mut odometer = Odometer::new(noise, 7);
        (0..100).for_each(|_| odometer.advance(&Pose2::new(0.01, 0.0, 0.0)));
        assert!(odometer.pose().yaw_rad.abs() > 1e-3);
        (0..100).for_each(|_| odometer.advance(&Pose2::new(-0.01, 0.0, 0.0)));
        assert!(odometer.pose().yaw_rad.abs() < 1e-12);
        assert!(odometer.pose().distance_m(&Pose2::IDENTITY) < 1e-3);
    }

    #[test]
    fn standing_still_is_never_measured_as_motion() {
        assert_eq!(drive(OdometryNoise::ORDINARY, 3, 1000, &Pose2::IDENTITY), Pose2::IDENTITY);
    }

    #[test]
    fn the_seed_decides_the_errors() {
        let step = Pose2::new(0.03, 0.0, 0.01);
        let [first, again, other] =
            [1, 1, 2].map(|seed| drive(OdometryNoise::ORDINARY, seed, 100, &step));
        assert!(first == again && first != other);
    }

    #[test]
    fn noise_that_is_not_a_number_is_refused() {
        for bad in [f64::NAN, -0.1, 2.0] {
            assert!(OdometryNoise { rotation: bad, ..OdometryNoise::NONE }.check().is_err());
        }
        let rate = OdometryNoise { slips_per_100m: f64::INFINITY, ..OdometryNoise::NONE };
        assert!(rate.check().is_err());
        OdometryNoise::ORDINARY.check().unwrap();
    }
}
