//! How a base really moves while its wheels rotate: they slip, and are not quite as large and as far
//! apart as configured.

use hal::{Twist2, wrap_angle};
use simulator::odometry::{Odometer, OdometryNoise};

/// The wheels of one base on the floor of one home.
pub(super) struct Wheels {
    errors: Odometer,
}

impl Wheels {
    /// Wheels with these errors, drawn by the seed.
    pub fn new(noise: OdometryNoise, seed: u64) -> Self {
        Self { errors: Odometer::new(noise, seed) }
    }

    /// The true velocity of the base while its wheels measure `measured` for `seconds`.
    ///
    /// The simulator's odometer gives the measurement of a true motion. Here the measurement is
    /// given: to the first order, the true motion is smaller by the error that the odometer would
    /// make.
    pub fn on_floor(&mut self, measured: &Twist2, seconds: f64) -> Twist2 {
        let motion = measured.integrate(seconds);
        if seconds <= 0.0 || !motion.is_finite() {
            return Twist2::ZERO;
        }
        let before = self.errors.pose();
        self.errors.advance(&motion);
        let wrong = before.inverse().compose(&self.errors.pose());
        let forward_m = wrong.x_m - motion.x_m;
        let yaw_rad = wrap_angle(wrong.yaw_rad - motion.yaw_rad);
        Twist2 {
            linear_mps: measured.linear_mps - forward_m / seconds,
            angular_radps: measured.angular_radps - yaw_rad / seconds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Pose2;

    /// The end pose of a base that measures 10 m straight ahead, in steps of 2 ms.
    fn after_ten_metres(noise: OdometryNoise, seed: u64) -> Pose2 {
        let mut wheels = Wheels::new(noise, seed);
        let measured = Twist2 { linear_mps: 0.5, angular_radps: 0.0 };
        (0..10_000).fold(Pose2::IDENTITY, |pose, _| {
            pose.compose(&wheels.on_floor(&measured, 0.002).integrate(0.002))
        })
    }

    #[test]
    fn exact_wheels_take_the_base_where_they_measure() {
        let end = after_ten_metres(OdometryNoise::NONE, 1);
        assert!(end.distance_m(&Pose2::new(10.0, 0.0, 0.0)) < 1e-9, "{end:?}");
    }

    #[test]
    fn wheels_that_are_larger_than_configured_by_one_percent_take_it_further_and_all_seeds_differ()
    {
        let noise = OdometryNoise { radius: 0.01, ..OdometryNoise::NONE };
        let ends: Vec<f64> = (0..40).map(|seed| after_ten_metres(noise, seed).x_m).collect();
        assert!(ends.iter().all(|x_m| (x_m - 10.0).abs() < 0.1001), "{ends:?}");
        assert!(ends.iter().any(|x_m| *x_m > 10.03) && ends.iter().any(|x_m| *x_m < 9.97));
    }

    #[test]
    fn an_ordinary_base_does_not_drive_straight() {
        let mean_rad = (0..40)
            .map(|seed| after_ten_metres(OdometryNoise::ORDINARY, seed).yaw_rad.abs())
            .sum::<f64>()
            / 40.0;
        // The mean of |N(0, sigma)| is 0.8 sigma, and the bias alone has 0.3 rad after 10 m.
        assert!((0.12..0.4).contains(&mean_rad), "{mean_rad}");
    }

    #[test]
    fn a_base_that_stands_does_not_drift() {
        let mut wheels = Wheels::new(OdometryNoise::ORDINARY, 3);
        for _ in 0..1000 {
            let twist = wheels.on_floor(&Twist2::ZERO, 0.002);
            assert_eq!((twist.linear_mps, twist.angular_radps), (0.0, 0.0));
        }
    }
}
