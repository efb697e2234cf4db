//! Dead reckoning from wheels, with the errors that wheels make.

use hal::Pose2;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::error::SceneError;
use crate::random::normal;

/// How wrong the wheels are. Standard deviations; the same model as in Thrun, Burgard and Fox, "Probabilistic Robotics" (2005),
/// 5.4, but with variances that grow with the way, so that the errors do not depend on how finely a motion is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryNoise {
    /// Of the length of the way: as a factor that is drawn once (wheel radius), and in metres after one metre (slip).
    pub translation: f64,
    /// Of turns: as a factor that is drawn once (wheel distance), and in radians after one radian (slip).
    pub rotation: f64,
    /// Of the heading after one metre, radians (wheels that are not alike, bumps).
    pub heading_drift_rad: f64,
}

impl OdometryNoise {
    /// Odometry that is the truth.
    pub const NONE: Self = Self { translation: 0.0, rotation: 0.0, heading_drift_rad: 0.0 };

    /// Checks every number.
    ///
    /// # Errors
    /// For the first that is not a number from 0 to 1.
    pub fn check(&self) -> Result<(), SceneError> {
        let fields = [
            ("odometry translation noise", self.translation),
            ("odometry rotation noise", self.rotation),
            ("odometry heading drift", self.heading_drift_rad),
        ];
        match fields.into_iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            Some((option, value)) => Err(SceneError::Option {
                option,
                value: value.to_string(),
                allowed: "a number from 0 to 1",
            }),
            None => Ok(()),
        }
    }
}

impl Default for OdometryNoise {
    /// A well-calibrated indoor base: half a percent of the way and of turns, 0.2 degrees a metre.
    fn default() -> Self {
        Self { translation: 0.005, rotation: 0.005, heading_drift_rad: 0.0035 }
    }
}

/// Adds up what the wheels measure. Starts at the identity.
#[derive(Debug, Clone)]
pub struct Odometer {
    noise: OdometryNoise,
    rng: Pcg64Mcg,
    translation_factor: f64,
    rotation_factor: f64,
    t_odom_base: Pose2,
}

impl Odometer {
    /// The same seed makes the same errors.
    #[must_use]
    pub fn new(noise: OdometryNoise, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let translation_factor = 1.0 + noise.translation * normal(&mut rng);
        let rotation_factor = 1.0 + noise.rotation * normal(&mut rng);
        Self { noise, rng, translation_factor, rotation_factor, t_odom_base: Pose2::IDENTITY }
    }

    /// Takes in a small true motion of the base, in its own frame.
    pub fn advance(&mut self, t_before_after: &Pose2) {
        let length = t_before_after.x_m.hypot(t_before_after.y_m);
        let turn = t_before_after.yaw_rad;
        let [slip, skid, drift] = [(); 3].map(|()| normal(&mut self.rng));
        let stretch = if length > 0.0 {
            self.translation_factor + self.noise.translation * slip / length.sqrt()
        } else {
            0.0
        };
        let yaw = turn * self.rotation_factor
            + self.noise.rotation * skid * turn.abs().sqrt()
            + self.noise.heading_drift_rad * drift * length.sqrt();
        let measured = Pose2::new(t_before_after.x_m * stretch, t_before_after.y_m * stretch, yaw);
        self.t_odom_base = self.t_odom_base.compose(&measured);
    }

    /// `t_odom_base` by the wheels.
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
    fn errors_have_the_stated_size_however_finely_a_motion_is_cut() {
        let noise = OdometryNoise { translation: 0.02, rotation: 0.0, heading_drift_rad: 0.01 };
        for cuts in [20, 500] {
            let step = Pose2::new(4.0 / cuts as f64, 0.0, 0.0);
            let ends: Vec<Pose2> = (0..400).map(|seed| drive(noise, seed, cuts, &step)).collect();
            let spread = |error: &dyn Fn(&Pose2) -> f64| {
                (ends.iter().map(|end| error(end).powi(2)).sum::<f64>() / ends.len() as f64).sqrt()
            };
            // 4 m: the factor's 0.02 * 4, and the slip's 0.02 * sqrt(4), in quadrature; the heading's 0.01 * sqrt(4).
            assert!((spread(&|end| end.x_m - 4.0) / 0.0894 - 1.0).abs() < 0.12);
            assert!((spread(&|end| end.yaw_rad) / 0.02 - 1.0).abs() < 0.12);
        }
    }

    #[test]
    fn standing_still_is_never_a_motion() {
        assert_eq!(drive(OdometryNoise::default(), 3, 1000, &Pose2::IDENTITY), Pose2::IDENTITY);
    }

    #[test]
    fn the_seed_decides_the_errors() {
        let run = |seed| drive(OdometryNoise::default(), seed, 100, &Pose2::new(0.03, 0.0, 0.01));
        assert!(run(1) == run(1) && run(1) != run(2));
    }

    #[test]
    fn noise_that_is_not_a_number_is_refused() {
        for bad in [f64::NAN, -0.1, 2.0] {
            assert!(OdometryNoise { rotation: bad, ..OdometryNoise::NONE }.check().is_err());
        }
        OdometryNoise::default().check().unwrap();
    }
}
