//! Limits the rate of a transfer.

use hal::Clock;

/// Unused time older than this is forfeited, so that no long burst follows a pause.
const BURST_NS: u64 = 200_000_000;

/// Limits the rate by sleeping between reads: flow control then slows the sender down.
pub struct RateLimiter<'a> {
    clock: &'a mut dyn Clock,
    bytes_per_s: Option<u64>,
    /// The time at which the bytes received so far are allowed to be complete.
    due_ns: u64,
}

impl<'a> RateLimiter<'a> {
    /// Limits to `bytes_per_s` from now on; `None` for no limit.
    pub fn new(clock: &'a mut dyn Clock, bytes_per_s: Option<u64>) -> Self {
        Self { due_ns: clock.now_ns(), clock, bytes_per_s }
    }

    pub(super) fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// Call after receiving `bytes` bytes. Returns when the next ones may be read.
    pub fn wait_after(&mut self, bytes: usize) {
        let Some(limit) = self.bytes_per_s else { return };
        let earliest = self.clock.now_ns().saturating_sub(BURST_NS);
        let took_ns = (bytes as u64).saturating_mul(1_000_000_000) / limit.max(1);
        self.due_ns = self.due_ns.max(earliest).saturating_add(took_ns);
        self.clock.sleep_until_ns(self.due_ns);
    }
}

#[cfg(test)]
mod tests {
    use hal::VirtualClock;

    use super::*;

    #[test]
    fn a_limit_of_5_mb_per_s_passes_5_mb_in_one_second() {
        let mut clock = VirtualClock::default();
        let mut limiter = RateLimiter::new(&mut clock, Some(5_000_000));
        for _ in 0..500 {
            limiter.wait_after(10_000);
        }
        assert_eq!(clock.now_ns(), 1_000_000_000);
    }

    #[test]
    fn a_pause_does_not_allow_a_burst_afterwards() {
        let mut clock = VirtualClock::default();
        clock.sleep_until_ns(3_600_000_000_000);
        let start_ns = clock.now_ns();
        let mut limiter = RateLimiter::new(&mut clock, Some(1000));
        limiter.due_ns = 0;
        limiter.wait_after(10_000);
        assert!(clock.now_ns() - start_ns >= 10_000_000_000 - BURST_NS);
    }

    #[test]
    fn without_a_limit_there_is_no_waiting() {
        let mut clock = VirtualClock::default();
        RateLimiter::new(&mut clock, None).wait_after(usize::MAX);
        assert_eq!(clock.now_ns(), 0);
    }
}
