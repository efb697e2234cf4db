//! Limits of velocity, acceleration and jerk that preserve curvature: a command that is too fast is
//! followed more slowly on the same arc, never on another arc.

use hal::Twist2;

pub use super::config::LimitConfig;

/// Moves the current velocity towards the desired one within the limits, tick by tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limiter {
    config: LimitConfig,
    now: Twist2,
    /// Share of the full acceleration that the last step used.
    share: f64,
}

impl Limiter {
    #[must_use]
    pub fn new(config: LimitConfig) -> Self {
        Self { config, now: Twist2::ZERO, share: 0.0 }
    }

    #[must_use]
    pub fn velocity(&self) -> Twist2 {
        self.now
    }

    /// An emergency stop: the velocity becomes zero at once, regardless of the limits. The motors'
    /// current limits then determine the deceleration.
    pub fn stop(&mut self) {
        self.now = Twist2::ZERO;
        self.share = 0.0;
    }

    /// Returns the velocity after another `seconds` of the transition to `desired`. When a number is
    /// not finite or the time is not positive, returns `None` and changes nothing.
    pub fn step(&mut self, desired: &Twist2, seconds: f64) -> Option<Twist2> {
        let is_time = seconds > 0.0 && seconds.is_finite();
        if !(desired.is_finite() && is_time) {
            return None;
        }
        let target = desired.within(self.config.linear_mps, self.config.angular_radps);
        let dv = target.linear_mps - self.now.linear_mps;
        let dw = target.angular_radps - self.now.angular_radps;
        let (v_limit, v_slows) = acceleration_limit(
            self.now.linear_mps,
            dv,
            self.config.acceleration_mps2,
            self.config.deceleration_mps2,
        );
        let (w_limit, w_slows) = acceleration_limit(
            self.now.angular_radps,
            dw,
            self.config.angular_acceleration_radps2,
            self.config.angular_deceleration_radps2,
        );
        // Seconds at full acceleration until both have reached their target. Both change by the
        // same share of their difference, so that a robot that starts or stops stays on its arc.
        let needed = (dv.abs() / v_limit).max(dw.abs() / w_limit);
        if needed == 0.0 {
            self.share = 0.0;
            return Some(self.now);
        }
        let slows = (v_slows || dv == 0.0) && (w_slows || dw == 0.0);
        self.share = if slows { 1.0 } else { self.jerk_limited_share(needed, seconds) };
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

    /// The share of the full acceleration that the jerk limit permits. It rises over time and falls
    /// before the target is reached.
    fn jerk_limited_share(&self, needed_s: f64, seconds: f64) -> f64 {
        let rise_s = self.config.jerk_time_s;
        if rise_s <= 0.0 {
            return 1.0;
        }
        let rising = self.share + seconds / rise_s;
        // Falling from the share s to zero at 1/rise per second covers s² rise / 2 of the remaining
        // difference.
        let falling = (2.0 * needed_s / rise_s).sqrt();
        // The lower bound makes sure that the target is reached.
        rising.min(falling).clamp((seconds / rise_s).min(1.0), 1.0)
    }
}

/// The acceleration limit for a change of velocity, and whether the change reduces the speed.
fn acceleration_limit(now: f64, change: f64, up: f64, down: f64) -> (f64, bool) {
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

    fn ticks_until(limiter: &mut Limiter, desired: Twist2) -> usize {
        (1..10_000)
            .find(|_| limiter.step(&desired, DT).is_some_and(|now| now == desired))
            .expect("the velocity is reached")
    }

    proptest! {
        #[test]
        fn from_standstill_the_robot_stays_on_the_desired_arc(
            v in -1.0..1.0,
            w in -3.0..3.0,
            ticks in 1usize..200,
        ) {
            let mut limiter = Limiter::new(LimitConfig::default());
            for _ in 0..ticks {
                let now = limiter.step(&twist(v, w), DT).expect("finite");
                prop_assert!((now.linear_mps * w - now.angular_radps * v).abs() < 1e-9);
            }
            for _ in 0..ticks {
                let now = limiter.step(&Twist2::ZERO, DT).expect("finite");
                prop_assert!((now.linear_mps * w - now.angular_radps * v).abs() < 1e-9);
            }
        }

        #[test]
        fn no_limit_is_ever_exceeded(
            commands in proptest::collection::vec((-2.0..2.0, -6.0..6.0, 1usize..60), 1..10),
        ) {
            let config = LimitConfig::default();
            let mut limiter = Limiter::new(config);
            for (v, w, ticks) in commands {
                for _ in 0..ticks {
                    let before = limiter.velocity();
                    let now = limiter.step(&twist(v, w), DT).expect("finite");
                    prop_assert!(now.linear_mps.abs() <= config.linear_mps + 1e-12);
                    prop_assert!(now.angular_radps.abs() <= config.angular_radps + 1e-12);
                    let dv = (now.linear_mps - before.linear_mps).abs() / DT;
                    let dw = (now.angular_radps - before.angular_radps).abs() / DT;
                    prop_assert!(dv <= config.deceleration_mps2 + 1e-9);
                    prop_assert!(dw <= config.angular_deceleration_radps2 + 1e-9);
                    let is_faster = now.linear_mps.abs() > before.linear_mps.abs();
                    let keeps_direction = now.linear_mps * before.linear_mps >= 0.0;
                    let speeds_up = is_faster && keeps_direction;
                    prop_assert!(!speeds_up || dv <= config.acceleration_mps2 + 1e-9);
                }
            }
        }

        #[test]
        fn every_allowed_velocity_is_reached(
            v in -0.3..0.3,
            w in -1.0..1.0,
            v0 in -0.3..0.3,
            w0 in -1.0..1.0,
        ) {
            let mut limiter = Limiter::new(LimitConfig::default());
            ticks_until(&mut limiter, twist(v0, w0));
            prop_assert!(ticks_until(&mut limiter, twist(v, w)) < 300);
        }
    }

    #[test]
    fn the_robot_stops_faster_than_it_starts() {
        let mut limiter = Limiter::new(LimitConfig::default());
        let start = ticks_until(&mut limiter, twist(0.3, 0.0));
        let stop = ticks_until(&mut limiter, Twist2::ZERO);
        assert!(stop * 2 <= start, "start {start} ticks, stop {stop}");
    }

    #[test]
    fn acceleration_rises_no_faster_than_the_jerk_limit() {
        let config = LimitConfig::default();
        let mut limiter = Limiter::new(config);
        let mut speed = 0.0;
        let mut acceleration = 0.0;
        while limiter.velocity().linear_mps < 0.3 {
            let next_speed = limiter.step(&twist(0.3, 0.0), DT).expect("finite").linear_mps;
            let next_acceleration = (next_speed - speed) / DT;
            let rise = next_acceleration - acceleration;
            assert!(rise <= config.acceleration_mps2 / config.jerk_time_s * DT + 1e-9);
            speed = next_speed;
            acceleration = next_acceleration;
        }
    }

    #[test]
    fn a_command_that_is_not_finite_is_refused_and_changes_nothing() {
        let mut limiter = Limiter::new(LimitConfig::default());
        limiter.step(&twist(0.3, 0.0), DT);
        let before = limiter;
        assert_eq!(limiter.step(&twist(f64::NAN, 0.0), DT), None);
        assert_eq!(limiter.step(&twist(0.0, f64::INFINITY), DT), None);
        assert_eq!(limiter.step(&twist(0.1, 0.0), -1.0), None);
        assert_eq!(limiter, before);
    }

    #[test]
    fn an_emergency_stop_sets_the_velocity_to_zero_at_once() {
        let mut limiter = Limiter::new(LimitConfig::default());
        ticks_until(&mut limiter, twist(0.3, 1.0));
        limiter.stop();
        assert_eq!(limiter.velocity(), Twist2::ZERO);
    }
}
