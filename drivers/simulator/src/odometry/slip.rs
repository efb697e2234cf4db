//! Slip events: over a short distance, one wheel reports more travel than it rolled.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::TRACK_M;

/// Travel at the rim over which one slip is spread, metres: half a second at an ordinary speed.
const SLIP_TRAVEL_M: f64 = 0.2;

/// The excess that the wheels report in one motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Excess {
    pub forward_m: f64,
    pub yaw_rad: f64,
}

/// Draws slips at random positions along the path. Positions and sizes do not depend on the length of the simulation
/// steps.
#[derive(Debug, Clone)]
pub(super) struct Slips {
    rng: Pcg64Mcg,
    /// Mean travel between two slips, metres; infinite without slips.
    every_m: f64,
    largest_m: f64,
    /// Travel that is left until the next slip.
    until_m: f64,
    /// Travel that is left of the present slip.
    left_m: f64,
    /// Excess of one wheel for each metre of travel, and the side: 1 for right, -1 for left.
    excess: f64,
    side: f64,
}

impl Slips {
    pub fn new(per_100m: f64, largest_m: f64, seed: u64) -> Self {
        let every_m = 100.0 / per_100m;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let until_m = exponential(every_m, &mut rng);
        Self { rng, every_m, largest_m, until_m, left_m: 0.0, excess: 0.0, side: 1.0 }
    }

    /// The excess during a motion of the base.
    pub fn during(&mut self, forward_m: f64, rotation_rad: f64) -> Excess {
        let mut travel_m = forward_m.abs() + rotation_rad.abs() * TRACK_M / 2.0;
        let mut slipped_m = 0.0;
        let mut yaw_m = 0.0;
        while travel_m > 0.0 {
            let part_m = if self.left_m > 0.0 {
                let part_m = travel_m.min(self.left_m);
                slipped_m += part_m * self.excess;
                yaw_m += part_m * self.excess * self.side;
                self.left_m -= part_m;
                part_m
            } else {
                let part_m = travel_m.min(self.until_m);
                self.until_m -= part_m;
                if self.until_m <= 0.0 {
                    self.begin();
                }
                part_m
            };
            travel_m -= part_m;
        }
        // The wheel spins in the direction in which it is driven.
        let direction = if forward_m < 0.0 { -1.0 } else { 1.0 };
        Excess { forward_m: direction * slipped_m / 2.0, yaw_rad: direction * yaw_m / TRACK_M }
    }

    fn begin(&mut self) {
        let size_m = self.largest_m * self.rng.random_range(0.25..=1.0);
        self.side = if self.rng.random_bool(0.5) { 1.0 } else { -1.0 };
        self.excess = size_m / SLIP_TRAVEL_M;
        self.left_m = SLIP_TRAVEL_M;
        self.until_m = exponential(self.every_m, &mut self.rng);
    }
}

/// Travel to the next event of a Poisson process. The random number is drawn for an infinite mean
/// as well, so that switching slips off does not change other numbers.
fn exponential(mean: f64, rng: &mut Pcg64Mcg) -> f64 {
    // 1 - [0, 1) is never 0.
    let drawn = -(1.0 - rng.random::<f64>()).ln();
    if mean.is_finite() { (mean * drawn).max(f64::MIN_POSITIVE) } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn total(slips: &mut Slips, steps: usize, step_m: f64) -> Vec<Excess> {
        (0..steps).map(|_| slips.during(step_m, 0.0)).collect()
    }

    #[test]
    fn slips_come_at_their_rate_and_have_their_size() {
        let mut slips = Slips::new(3.0, 0.04, 1);
        let excess = total(&mut slips, 1_000_000, 0.01);
        let slipped_m: f64 = excess.iter().map(|part| 2.0 * part.forward_m).sum();
        // 10 km with one slip every 33.5 m, of 2.5 cm on average.
        let expected_m = 10_000.0 / (100.0 / 3.0 + SLIP_TRAVEL_M) * 0.025;
        assert!((slipped_m / expected_m - 1.0).abs() < 0.15, "{slipped_m} for {expected_m}");
        let left: f64 = excess.iter().map(|part| part.yaw_rad.min(0.0)).sum();
        let right: f64 = excess.iter().map(|part| part.yaw_rad.max(0.0)).sum();
        assert!((0.5..2.0).contains(&(right / -left)), "both wheels slip: {left} and {right}");
    }

    #[test]
    fn places_and_sizes_do_not_depend_on_the_step() {
        let fine: f64 = total(&mut Slips::new(30.0, 0.04, 2), 20_000, 0.005)
            .iter()
            .map(|part| part.yaw_rad)
            .sum();
        let coarse: f64 =
            total(&mut Slips::new(30.0, 0.04, 2), 1_000, 0.1).iter().map(|part| part.yaw_rad).sum();
        assert!(fine.abs() > 0.01 && (fine - coarse).abs() < 1e-9, "{fine} and {coarse}");
    }

    #[test]
    fn a_wheel_that_slips_always_reports_more_than_happened() {
        let mut slips = Slips::new(500.0, 0.04, 3);
        assert!(total(&mut slips, 1000, 0.02).iter().all(|part| part.forward_m >= 0.0));
        assert!(total(&mut slips, 1000, -0.02).iter().all(|part| part.forward_m <= 0.0));
    }

    #[test]
    fn without_slips_and_standing_still_there_is_no_excess() {
        let mut never = Slips::new(0.0, 0.04, 4);
        assert!(total(&mut never, 1000, 1.0).iter().all(|part| *part == Excess::default()));
        assert_eq!(Slips::new(500.0, 0.04, 4).during(0.0, 0.0), Excess::default());
    }
}
