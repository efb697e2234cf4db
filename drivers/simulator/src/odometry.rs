//! Dead reckoning from wheels, with the errors that wheels make.

use hal::Pose2;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::error::SceneError;
use crate::random::normal;

/// Wheel odometry error, as standard deviations. The model is that of Thrun, Burgard and Fox,
/// "Probabilistic Robotics" (2005), 5.4, but with variances that grow with the distance, so that
/// the errors do not depend on the length of the simulation step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryNoise {
    /// Error of the distance: as a factor that is drawn once (wheel radius), and in metres after
    /// one metre (slip).
    pub translation: f64,
    /// Error of rotations: as a factor that is drawn once (wheel distance), and in radians after
    /// one radian (slip).
    pub rotation: f64,
    /// Error of the heading after one metre, radians (unequal wheels, bumps).
    pub heading_drift_rad: f64,
}

impl OdometryNoise {
    /// Odometry without error.
    pub const NONE: Self = Self { translation: 0.0, rotation: 0.0, heading_drift_rad: 0.0 };

    /// Checks the range of every field.
    ///
    /// # Errors
    /// Reports the first field that is not a number from 0 to 1.
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
    /// A well-calibrated indoor base: 0.5 percent of distances and of rotations, 0.2 degrees per
    /// metre.
    fn default() -> Self {
        Self { translation: 0.005, rotation: 0.005, heading_drift_rad: 0.0035 }
    }
}

/// Integrates the motion that the wheels measure. It starts at the identity.
#[derive(Debug, Clone)]
pub struct Odometer {
    noise: OdometryNoise,
    rng: Pcg64Mcg,
    translation_factor: f64,
    rotation_factor: f64,
    t_odom_base: Pose2,
}

impl Odometer {
    /// Creates an odometer at the identity. The same seed gives the same errors.
    #[must_use]
    pub fn new(noise: OdometryNoise, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let translation_factor = 1.0 + noise.translation * normal(&mut rng);
        let rotation_factor = 1.0 + noise.rotation * normal(&mut rng);
        Self { noise, rng, translation_factor, rotation_factor, t_odom_base: Pose2::IDENTITY }
    }

    /// Adds a small true motion of the base, given in the base frame before the motion.
    pub fn advance(&mut self, t_before_after: &Pose2) {
        let length = t_before_after.x_m.hypot(t_before_after.y_m);
        let rotation = t_before_after.yaw_rad;
        let [slip, skid, drift] = [(); 3].map(|()| normal(&mut self.rng));
        let stretch = if length > 0.0 {
            self.translation_factor + self.noise.translation * slip / length.sqrt()
        } else {
            0.0
        };
        let yaw = rotation * self.rotation_factor
            + self.noise.rotation * skid * rotation.abs().sqrt()
            + self.noise.heading_drift_rad * drift * length.sqrt();
        let measured = Pose2::new(t_before_after.x_m * stretch, t_before_after.y_m * stretch, yaw);
        self.t_odom_base = self.t_odom_base.compose(&measured);
    }

    /// Measured pose `t_odom_base`.
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
    fn errors_have_the_stated_size_for_any_step_length() {
        let noise = OdometryNoise { translation: 0.02, rotation: 0.0, heading_drift_rad: 0.01 };
        for cuts in [20, 500] {
            let step = Pose2::new(4.0 / cuts as f64, 0.0, 0.0);
            let ends: Vec<Pose2> = (0..400).map(|seed| drive(noise, seed, cuts, &step)).collect();
            // After 4 m: the factor's 0.02 * 4 and the slip's 0.02 * sqrt(4), in quadrature; the
            // heading's 0.01 * sqrt(4).
            assert!((rms(&|end| end.x_m - 4.0, &ends) / 0.0894 - 1.0).abs() < 0.12);
            assert!((rms(&|end| end.yaw_rad, &ends) / 0.02 - 1.0).abs() < 0.12);
        }
    }

    fn rms(error: &dyn Fn(&Pose2) -> f64, ends: &[Pose2]) -> f64 {
        (ends.iter().map(|end| error(end).powi(2)).sum::<f64>() / ends.len() as f64).sqrt()
    }

    #[test]
    fn standing_still_is_never_measured_as_motion() {
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
