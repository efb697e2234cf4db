//! A drive for calibration: straight lines, arcs and rotations in both directions with many stops, away from what is near.

use hal::{LaserScan, Twist2};
use rand::{Rng, RngExt};

/// Speed of the default robot, m/s.
const SPEED_MPS: f64 = 0.3;
/// Angular rates of rotations, rad/s: the largest is the default limit of `[devices.base.limits]`.
const RATES_RADPS: [f64; 3] = [0.35, 0.7, 1.0];
const ARC_RADPS: f64 = 0.4;
/// The robot drives on while this much ahead of it is free, metres: its radius, and what it needs to stop.
const FREE_M: f32 = 0.45;
/// Beams within this angle of the direction count as ahead, radians.
const AHEAD_RAD: f64 = 0.9;

/// What the robot does for some ticks.
pub struct Pattern {
    twist: Twist2,
    ticks: u32,
}

impl Pattern {
    pub fn new() -> Self {
        Self { twist: Twist2::ZERO, ticks: 5 }
    }

    /// The velocity of the next tick.
    pub fn next(&mut self, scan: &LaserScan, rng: &mut impl Rng) -> Twist2 {
        let is_blocked = self.twist.linear_mps > 0.0 && !is_free(scan);
        if self.ticks == 0 || is_blocked {
            self.begin(!is_free(scan), rng);
        }
        self.ticks = self.ticks.saturating_sub(1);
        self.twist
    }

    fn begin(&mut self, must_rotate: bool, rng: &mut impl Rng) {
        let was_moving = self.twist != Twist2::ZERO;
        let chance = rng.random::<f64>();
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let rotates = must_rotate || chance < 0.5;
        (self.twist, self.ticks) = if was_moving && chance > 0.8 {
            (Twist2::ZERO, rng.random_range(2..6))
        } else if rotates {
            let rate = RATES_RADPS[rng.random_range(0..RATES_RADPS.len())];
            (Twist2 { linear_mps: 0.0, angular_radps: side * rate }, rng.random_range(5..35))
        } else {
            let angular_radps = if rng.random_bool(0.4) { side * ARC_RADPS } else { 0.0 };
            (Twist2 { linear_mps: SPEED_MPS, angular_radps }, rng.random_range(5..40))
        };
    }
}

/// Whether nothing is near in the direction of travel. A beam without a return says nothing.
fn is_free(scan: &LaserScan) -> bool {
    scan.hits().all(|(angle_rad, range_m)| angle_rad.abs() > AHEAD_RAD || range_m > FREE_M)
}
