//! The computer's monotonic clock.
#![forbid(unsafe_code)]

use hal::Clock;
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};

/// `CLOCK_MONOTONIC`: what the kernel stamps V4L2 buffers with, and what deadlines are counted on.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

/// Now on `CLOCK_MONOTONIC`, nanoseconds since boot.
#[must_use]
pub fn monotonic_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Monotonic))
}

/// How far `CLOCK_REALTIME` is ahead of `CLOCK_MONOTONIC`: brings time stamps of sockets, which count from 1970, to ours.
#[must_use]
pub fn realtime_ahead_ns() -> i64 {
    // Read between two readings of the other: a task switch in between spoils the difference by at most half its length.
    let before = monotonic_ns();
    let real = nanoseconds(clock_gettime(ClockId::Realtime));
    let after = monotonic_ns();
    real as i64 - (before + (after - before) / 2) as i64
}

fn nanoseconds(time: Timespec) -> u64 {
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

impl Clock for MonotonicClock {
    fn now_ns(&self) -> u64 {
        monotonic_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        let deadline = Timespec {
            tv_sec: (deadline_ns / 1_000_000_000) as i64,
            tv_nsec: (deadline_ns % 1_000_000_000) as i64,
        };
        // A signal ends the sleep early; an absolute deadline makes sleeping again safe.
        while clock_nanosleep_absolute(ClockId::Monotonic, &deadline)
            == Err(rustix::io::Errno::INTR)
        {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeps_until_the_deadline_and_not_at_all_when_it_has_passed() {
        let mut clock = MonotonicClock;
        let deadline_ns = clock.now_ns() + 3_000_000;
        clock.sleep_until_ns(deadline_ns);
        assert!(clock.now_ns() >= deadline_ns);
        clock.sleep_until_ns(0);
    }

    #[test]
    fn the_distance_between_the_two_clocks_stands_still() {
        assert!((realtime_ahead_ns() - realtime_ahead_ns()).abs() < 50_000_000);
    }
}
