//! When a revolution ended, and whether the motor rotates as it should.

/// The longest revolution that is accepted, as a multiple of the configured one. The safety plane
/// reckons with it.
pub const SLOWER: f64 = 1.15;
/// A revolution that took longer than this multiple of the longest one may hold measurements of two
/// revolutions, because data was lost: 1.84 nominal periods.
const BROKEN: f64 = 1.6;
/// The rate is measured over this many revolutions, so that a computer that reads one of them late
/// does not count as a slow motor.
const REVOLUTIONS: usize = 4;

/// What the arrival of a revolution's last measurement says about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RevolutionTime {
    /// It is whole, and ended at this time or earlier.
    Whole {
        /// Latest time at which it can have ended, on the monotonic clock.
        end_ns: u64,
    },
    /// The scanner was switched on within it, or data was lost.
    Partial,
    /// The motor is too slow.
    TooSlow {
        /// Measured rate, revolutions per second.
        hz: f64,
    },
}

/// Follows the revolutions of one scanner.
#[derive(Debug, Clone)]
pub struct RevolutionClock {
    longest_ns: u64,
    /// Arrivals of the last revolutions, the newest last.
    arrivals_ns: Vec<u64>,
    /// No revolution ended later than this.
    end_ns: u64,
    /// The revolution before this one was partial, too.
    was_partial: bool,
}

impl RevolutionClock {
    /// A clock for a scanner with this nominal period.
    #[must_use]
    pub fn new(period_ns: u64) -> Self {
        Self {
            longest_ns: (SLOWER * period_ns as f64).round() as u64,
            arrivals_ns: Vec::with_capacity(REVOLUTIONS + 1),
            end_ns: 0,
            was_partial: false,
        }
    }

    /// Records that a revolution ended, and that its last byte arrived at this time.
    pub fn end_revolution(&mut self, arrival_ns: u64) -> RevolutionTime {
        let Some(before_ns) = self.arrivals_ns.last().copied() else {
            self.restart(arrival_ns);
            return RevolutionTime::Partial;
        };
        let duration_ns = arrival_ns.saturating_sub(before_ns);
        if duration_ns as f64 > BROKEN * self.longest_ns as f64 {
            let is_again = std::mem::replace(&mut self.was_partial, true);
            self.restart(arrival_ns);
            let hz = 1e9 / duration_ns.max(1) as f64;
            return if is_again { RevolutionTime::TooSlow { hz } } else { RevolutionTime::Partial };
        }
        self.was_partial = false;
        // A computer that is busy reads late. The revolution itself took no longer than the longest.
        self.end_ns = arrival_ns.min(self.end_ns + self.longest_ns);
        if self.arrivals_ns.len() > REVOLUTIONS {
            self.arrivals_ns.remove(0);
        }
        self.arrivals_ns.push(arrival_ns);
        match self.mean_ns() {
            Some(mean_ns) if mean_ns > self.longest_ns => {
                RevolutionTime::TooSlow { hz: 1e9 / mean_ns as f64 }
            }
            _ => RevolutionTime::Whole { end_ns: self.end_ns },
        }
    }

    fn restart(&mut self, arrival_ns: u64) {
        self.arrivals_ns.clear();
        self.arrivals_ns.push(arrival_ns);
        self.end_ns = arrival_ns;
    }

    /// The mean duration of the last revolutions, if there were enough.
    fn mean_ns(&self) -> Option<u64> {
        let oldest_ns =
            self.arrivals_ns.first().filter(|_| self.arrivals_ns.len() > REVOLUTIONS)?;
        Some((self.arrivals_ns.last()? - oldest_ns) / REVOLUTIONS as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const PERIOD_NS: u64 = 100 * MS;

    fn after(durations_ms: &[u64]) -> Vec<RevolutionTime> {
        let mut clock = RevolutionClock::new(PERIOD_NS);
        let mut now_ns = 5_000 * MS;
        let mut times = vec![clock.end_revolution(now_ns)];
        for ms in durations_ms {
            now_ns += ms * MS;
            times.push(clock.end_revolution(now_ns));
        }
        times
    }

    #[test]
    fn the_revolution_in_which_the_scanner_was_switched_on_is_partial() {
        let times = after(&[100]);
        assert_eq!(times, [RevolutionTime::Partial, RevolutionTime::Whole { end_ns: 5_100 * MS }]);
    }

    #[test]
    fn one_revolution_that_is_read_late_is_neither_slow_nor_newer_than_it_is() {
        let times = after(&[100, 150, 50, 100, 100]);
        assert_eq!(times[2], RevolutionTime::Whole { end_ns: 5_215 * MS }, "not 5,250");
        assert_eq!(times[3], RevolutionTime::Whole { end_ns: 5_300 * MS });
        assert!(times[1..].iter().all(|time| matches!(time, RevolutionTime::Whole { .. })));
    }

    #[test]
    fn a_motor_that_slows_down_by_a_fifth_is_named_with_its_rate() {
        let times = after(&[120; 6]);
        let Some(RevolutionTime::TooSlow { hz }) = times.last() else { panic!("{times:?}") };
        assert!((hz - 8.33).abs() < 0.01, "{hz}");
        assert!(
            after(&[110; 20]).iter().all(|time| !matches!(time, RevolutionTime::TooSlow { .. }))
        );
    }

    #[test]
    fn a_revolution_that_took_two_periods_lost_data_and_a_second_one_is_a_slow_motor() {
        let times = after(&[100, 200, 100, 250, 250]);
        assert_eq!(times[2], RevolutionTime::Partial);
        assert!(matches!(times[3], RevolutionTime::Whole { .. }));
        assert_eq!(times[4..], [RevolutionTime::Partial, RevolutionTime::TooSlow { hz: 4.0 }]);
    }
}
