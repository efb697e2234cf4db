//! What the wheels report of a motion.

use hal::Pose2;
use rand_pcg::Pcg64Mcg;

use crate::random::normal;

/// Noise of wheel odometry: independent errors that grow with the square root of the way, as those of many small slips do.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OdometryNoise {
    /// Standard deviation of the distance after one metre, metres.
    pub distance: f64,
    /// Standard deviation of the heading after one radian of turning, radians.
    pub turn: f64,
    /// Standard deviation of the heading after one metre of driving, radians.
    pub turn_per_metre: f64,
}

impl OdometryNoise {
    /// The motion `t_before_after` as the wheels report it.
    #[must_use]
    pub fn report(&self, motion: &Pose2, rng: &mut Pcg64Mcg) -> Pose2 {
        let [along, about, across] = [(); 3].map(|()| normal(rng));
        let way_m = motion.x_m.hypot(motion.y_m);
        if way_m == 0.0 && motion.yaw_rad == 0.0 {
            return *motion;
        }
        let stretch = if way_m > 0.0 { 1.0 + self.distance * way_m.sqrt() * along / way_m } else { 1.0 };
        let twist = self.turn * motion.yaw_rad.abs().sqrt() * about + self.turn_per_metre * way_m.sqrt() * across;
        Pose2::new(motion.x_m * stretch, motion.y_m * stretch, motion.yaw_rad + twist)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    const STEP: Pose2 = Pose2 { x_m: 0.03, y_m: 0.0, yaw_rad: 0.0 };

    #[test]
    fn without_noise_the_wheels_report_the_motion_to_the_last_bit() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let motion = Pose2::new(0.03, 0.001, 0.02);
        assert_eq!(OdometryNoise::default().report(&motion, &mut rng), motion);
    }

    #[test]
    fn standing_still_reports_standing_still() {
        let noise = OdometryNoise { distance: 0.1, turn: 0.1, turn_per_metre: 0.1 };
        assert_eq!(noise.report(&Pose2::IDENTITY, &mut Pcg64Mcg::seed_from_u64(1)), Pose2::IDENTITY);
    }

    #[test]
    fn errors_grow_with_the_square_root_of_the_way_whatever_the_length_of_a_step() {
        let noise = OdometryNoise { distance: 0.05, ..OdometryNoise::default() };
        let deviation = |steps: usize, step_m: f64| {
            let runs = 400;
            let sum: f64 = (0..runs)
                .map(|seed| {
                    let mut rng = Pcg64Mcg::seed_from_u64(seed);
                    let motion = Pose2::new(step_m, 0.0, 0.0);
                    let way: f64 = (0..steps).map(|_| noise.report(&motion, &mut rng).x_m).sum();
                    (way - steps as f64 * step_m).powi(2)
                })
                .sum();
            (sum / runs as f64).sqrt()
        };
        let fine = deviation(400, 0.01);
        let coarse = deviation(40, 0.1);
        assert!((fine / coarse - 1.0).abs() < 0.15, "{fine} and {coarse}");
        assert!((fine / (0.05 * 2.0) - 1.0).abs() < 0.15, "4 m: {fine}");
    }

    #[test]
    fn the_same_seed_reports_the_same() {
        let noise = OdometryNoise { distance: 0.05, turn: 0.05, turn_per_metre: 0.01 };
        let report = |seed| noise.report(&STEP, &mut Pcg64Mcg::seed_from_u64(seed));
        assert_eq!(report(7), report(7));
        assert_ne!(report(7), report(8));
    }
}
