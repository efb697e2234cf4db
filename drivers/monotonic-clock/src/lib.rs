//! The computer's monotonic clock as a [`hal::Clock`].
#![forbid(unsafe_code)]

use hal::Clock;
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};

/// `CLOCK_MONOTONIC`, with which the kernel also stamps V4L2 buffers.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

/// The current time of `CLOCK_MONOTONIC`, in nanoseconds since boot.
#[must_use]
pub fn monotonic_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Monotonic))
}

/// How far `CLOCK_REALTIME` is ahead of `CLOCK_MONOTONIC`. Subtract it from a socket's timestamp,
/// which counts from 1970, to get a monotonic one.
#[must_use]
pub fn realtime_ahead_ns() -> i64 {
    // Read between two readings of the other clock, so that a task switch in between falsifies the
    // difference by at most half of its length.
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
        // A signal ends the sleep early. Because the deadline is absolute, sleeping again is safe.
        while clock_nanosleep_absolute(ClockId::Monotonic, &deadline)
            == Err(rustix::io::Errno::INTR)
        {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_sleeps_until_the_deadline_and_returns_at_once_when_the_deadline_has_passed() {
        let mut clock = MonotonicClock;
        let deadline_ns = clock.now_ns() + 3_000_000;
        clock.sleep_until_ns(deadline_ns);
        assert!(clock.now_ns() >= deadline_ns);
        let before_ns = clock.now_ns();
        clock.sleep_until_ns(0);
        assert!(clock.now_ns() - before_ns < 1_000_000_000);
    }

    #[test]
    fn the_offset_between_the_two_clocks_is_constant() {
        assert!((realtime_ahead_ns() - realtime_ahead_ns()).abs() < 50_000_000);
    }
}
