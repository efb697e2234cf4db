//! Limits of velocity, acceleration and jerk that keep the curve: what is too fast becomes slower on the same arc, never a
//! different arc.

use hal::Twist2;

pub use super::config::LimitConfig;

/// Brings the present velocity towards the wanted one, turn by turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limiter {
    config: LimitConfig,
    now: Twist2,
    /// Share of the full acceleration that the last turn used.
    share: f64,
}

impl Limiter {
    /// At a stand.
    #[must_use]
    pub fn new(config: LimitConfig) -> Self {
        Self { config, now: Twist2::ZERO, share: 0.0 }
    }

    /// The present velocity.
    #[must_use]
    pub fn velocity(&self) -> Twist2 {
        self.now
    }

    /// An emergency stop: zero at once, whatever the limits say. The motors' own current limits then decide how fast.
    pub fn stop(&mut self) {
        self.now = Twist2::ZERO;
        self.share = 0.0;
    }

    /// The velocity `seconds` later on the way to `wanted`; `None`, and nothing changes, when a number is not finite or the time
    /// is not positive.
    pub fn step(&mut self, wanted: &Twist2, seconds: f64) -> Option<Twist2> {
        let is_time = seconds > 0.0 && seconds.is_finite();
        if !(wanted.is_finite() && is_time) {
            return None;
        }
        let target = self.slowed(wanted);
        let (dv, dw) = (
            target.linear_mps - self.now.linear_mps,
            target.angular_radps - self.now.angular_radps,
        );
        let (v_limit, v_slows) = rate(
            self.now.linear_mps,
            dv,
            self.config.acceleration_mps2,
            self.config.deceleration_mps2,
        );
        let (w_limit, w_slows) = rate(
            self.now.angular_radps,
            dw,
            self.config.angular_acceleration_radps2,
            self.config.angular_deceleration_radps2,
        );
        // Seconds at full acceleration until both are there. Both change by the same share of their way, so that a robot that
        // starts or stops stays on its arc.
        let needed = (dv.abs() / v_limit).max(dw.abs() / w_limit);
        if needed == 0.0 {
            self.share = 0.0;
            return Some(self.now);
        }
        let slows = (v_slows || dv == 0.0) && (w_slows || dw == 0.0);
        self.share = if slows { 1.0 } else { self.eased(needed, seconds) };
        let part = (self.share * seconds / needed).min(1.0);
        self.now.linear_mps += dv * part;
        self.now.angular_radps += dw * part;
        if part >= 1.0 {
            self.now = target;
        }
        if slows {
            self.share = 0.0;
        }
        Some(self.now)
    }

    /// The share of full acceleration that the jerk limit leaves: it grows with time, and shrinks before the goal.
    fn eased(&self, needed_s: f64, seconds: f64) -> f64 {
        let rise_s = self.config.jerk_time_s;
        if rise_s <= 0.0 {
            return 1.0;
        }
        let rising = self.share + seconds / rise_s;
        // From share s, coming down to zero at 1/rise per second covers s² rise / 2 of the way that is left.
        let falling = (2.0 * needed_s / rise_s).sqrt();
        // Never so small that the end is not reached.
        rising.min(falling).clamp((seconds / rise_s).min(1.0), 1.0)
    }

    /// On the same arc, no faster than allowed.
    fn slowed(&self, wanted: &Twist2) -> Twist2 {
        let over_v = wanted.linear_mps.abs() / self.config.linear_mps;
        let over_w = wanted.angular_radps.abs() / self.config.angular_radps;
        let scale = over_v.max(over_w).max(1.0).recip();
        Twist2 {
            linear_mps: wanted.linear_mps * scale,
            angular_radps: wanted.angular_radps * scale,
        }
    }
}

/// The limit for a change, and whether the change slows.
fn rate(now: f64, change: f64, up: f64, down: f64) -> (f64, bool) {
    let slows = now * change < 0.0;
    (if slows { down } else { up }, slows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DT: f64 = 0.01;

    fn twist(linear_mps: f64, angular_radps: f64) -> Twist2 {
        Twist2 { linear_mps, angular_radps }
    }

    fn turns_until(limiter: &mut Limiter, wanted: Twist2) -> usize {
        (1..10_000)
            .find(|_| limiter.step(&wanted, DT).is_some_and(|now| now == wanted))
            .expect("it arrives")
    }

    proptest! {
        #[test]
        fn from_a_stand_the_robot_stays_on_the_wanted_arc(v in -1.0..1.0, w in -3.0..3.0, turns in 1usize..200) {
            let mut limiter = Limiter::new(LimitConfig::default());
            for _ in 0..turns {
                let now = limiter.step(&twist(v, w), DT).expect("finite");
                prop_assert!((now.linear_mps * w - now.angular_radps * v).abs() < 1e-9);
            }
            for _ in 0..turns {
                let now = limiter.step(&Twist2::ZERO, DT).expect("finite");
                prop_assert!((now.linear_mps * w - now.angular_radps * v).abs() < 1e-9);
            }
        }

        #[test]
        fn no_limit_is_ever_passed(wishes in proptest::collection::vec((-2.0..2.0, -6.0..6.0, 1usize..60), 1..10)) {
            let config = LimitConfig::default();
            let mut limiter = Limiter::new(config);
            for (v, w, turns) in wishes {
                for _ in 0..turns {
                    let before = limiter.velocity();
                    let now = limiter.step(&twist(v, w), DT).expect("finite");
                    prop_assert!(now.linear_mps.abs() <= config.linear_mps + 1e-12);
                    prop_assert!(now.angular_radps.abs() <= config.angular_radps + 1e-12);
                    let dv = (now.linear_mps - before.linear_mps).abs() / DT;
                    let dw = (now.angular_radps - before.angular_radps).abs() / DT;
                    prop_assert!(dv <= config.deceleration_mps2 + 1e-9 && dw <= config.angular_deceleration_radps2 + 1e-9);
                    let speeds_up = now.linear_mps.abs() > before.linear_mps.abs() && now.linear_mps * before.linear_mps >= 0.0;
                    prop_assert!(!speeds_up || dv <= config.acceleration_mps2 + 1e-9);
                }
            }
        }

        #[test]
        fn every_wish_is_reached(v in -0.3..0.3, w in -1.0..1.0, v0 in -0.3..0.3, w0 in -1.0..1.0) {
            let mut limiter = Limiter::new(LimitConfig::default());
            turns_until(&mut limiter, twist(v0, w0));
            prop_assert!(turns_until(&mut limiter, twist(v, w)) < 300);
        }
    }

    #[test]
    fn the_robot_stops_faster_than_it_starts() {
        let mut limiter = Limiter::new(LimitConfig::default());
        let start = turns_until(&mut limiter, twist(0.3, 0.0));
        let stop = turns_until(&mut limiter, Twist2::ZERO);
        assert!(stop * 2 <= start, "start {start} turns, stop {stop}");
    }

    #[test]
    fn acceleration_rises_no_faster_than_the_jerk_limit() {
        let config = LimitConfig::default();
        let mut limiter = Limiter::new(config);
        let (mut before, mut last) = (0.0, 0.0);
        while limiter.velocity().linear_mps < 0.3 {
            let now = limiter.step(&twist(0.3, 0.0), DT).expect("finite").linear_mps;
            let acceleration = (now - before) / DT;
            assert!(
                acceleration - last <= config.acceleration_mps2 / config.jerk_time_s * DT + 1e-9
            );
            (before, last) = (now, acceleration);
        }
    }

    #[test]
    fn what_is_not_finite_is_refused_and_changes_nothing() {
        let mut limiter = Limiter::new(LimitConfig::default());
        limiter.step(&twist(0.3, 0.0), DT);
        let before = limiter;
        assert_eq!(limiter.step(&twist(f64::NAN, 0.0), DT), None);
        assert_eq!(limiter.step(&twist(0.0, f64::INFINITY), DT), None);
        assert_eq!(limiter.step(&twist(0.1, 0.0), -1.0), None);
        assert_eq!(limiter, before);
    }

    #[test]
    fn an_emergency_stop_is_zero_at_once() {
        let mut limiter = Limiter::new(LimitConfig::default());
        turns_until(&mut limiter, twist(0.3, 1.0));
        limiter.stop();
        assert_eq!(limiter.velocity(), Twist2::ZERO);
    }
}
