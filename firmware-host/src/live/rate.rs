//! Limits of rates, in the computer's time: a simulation may run faster than the clients can look.

use std::time::{Duration, Instant};

use hal::Clock;
use monotonic_clock::MonotonicClock;

/// Lets something happen at most so often.
#[derive(Debug, Clone)]
pub struct Pulse {
    period: Duration,
    due: Option<Instant>,
}

impl Pulse {
    /// At most `hz` times a second.
    pub fn of_hz(hz: f64) -> Self {
        Self { period: Duration::from_secs_f64(1.0 / hz.max(1e-3)), due: None }
    }

    /// Whether it is due at `now`. A tenth of a period early is soon enough, because ticks jitter.
    pub fn is_due(&mut self, now: Instant) -> bool {
        let due = *self.due.get_or_insert(now);
        if now + self.period / 10 < due {
            return false;
        }
        // After a pause the schedule begins anew.
        let is_late = now > due + self.period;
        self.due = Some(if is_late { now } else { due } + self.period);
        true
    }
}

/// Sleeps for `duration` on the monotonic clock.
pub fn pause(duration: Duration) {
    let mut clock = MonotonicClock;
    clock.sleep_until_ns(clock.now_ns() + duration.as_nanos() as u64);
}

/// Allows a burst, and then a rate.
#[derive(Debug)]
pub struct Bucket {
    per_s: f64,
    most: f64,
    left: f64,
    filled: Option<Instant>,
}

impl Bucket {
    /// `most` at once, and `per_s` a second.
    pub fn new(per_s: f64, most: f64) -> Self {
        Self { per_s, most, left: most, filled: None }
    }

    /// Takes one, if there is one at `now`.
    pub fn take(&mut self, now: Instant) -> bool {
        let since = self.filled.replace(now).map_or(Duration::ZERO, |then| now - then);
        self.left = (self.left + since.as_secs_f64() * self.per_s).min(self.most);
        let has = self.left >= 1.0;
        if has {
            self.left -= 1.0;
        }
        has
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::after_ms;
    use super::*;

    #[test]
    fn a_pulse_is_as_frequent_as_its_rate_and_no_burst_follows_a_pause() {
        let began = Instant::now();
        let mut pulse = Pulse::of_hz(5.0);
        let due = (0..20).filter(|tick| pulse.is_due(after_ms(began, tick * 100))).count();
        assert_eq!(due, 10);
        assert!(pulse.is_due(after_ms(began, 60_000)));
        assert!(!pulse.is_due(after_ms(began, 60_050)));
    }

    #[test]
    fn jitter_of_the_ticks_does_not_halve_the_rate() {
        let began = Instant::now();
        let mut pulse = Pulse::of_hz(10.0);
        let jitter = [0, 4, 1, 3, 0, 5, 2, 0, 1, 0];
        let due = jitter.iter().enumerate().filter(|(tick, late)| {
            pulse.is_due(began + Duration::from_millis(100 * *tick as u64 + **late))
        });
        assert_eq!(due.count(), 10);
    }

    #[test]
    fn a_bucket_allows_a_burst_and_then_its_rate() {
        let began = Instant::now();
        let mut bucket = Bucket::new(2.0, 3.0);
        assert_eq!((0..10).filter(|_| bucket.take(began)).count(), 3);
        let later = began + Duration::from_secs(1);
        assert_eq!((0..10).filter(|_| bucket.take(later)).count(), 2);
    }
}
