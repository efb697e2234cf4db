//! A simulated clock that runs no faster than the wall's, so that a person can watch the run and stop it.

use hal::Clock;
use monotonic_clock::MonotonicClock;

/// The simulation may catch up this much after a slow tick; what is slower than that stays behind.
const CATCHES_UP_NS: u64 = 200_000_000;

/// A clock that sleeps while another one is asked to.
#[derive(Debug, Clone)]
pub struct PacedClock<K> {
    inner: K,
    /// The computer's time when the simulated time was 0; `None` to run as fast as possible.
    began_ns: Option<u64>,
}

impl<K: Clock> PacedClock<K> {
    /// Paces `inner`, or not.
    pub fn new(inner: K, real_time: bool) -> Self {
        let began_ns = MonotonicClock.now_ns().saturating_sub(inner.now_ns());
        Self { inner, began_ns: real_time.then_some(began_ns) }
    }
}

impl<K: Clock> Clock for PacedClock<K> {
    fn now_ns(&self) -> u64 {
        self.inner.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.inner.sleep_until_ns(deadline_ns);
        let Some(began_ns) = &mut self.began_ns else { return };
        let due_ns = *began_ns + deadline_ns;
        let mut clock = MonotonicClock;
        let late_ns = clock.now_ns().saturating_sub(due_ns);
        *began_ns += late_ns.saturating_sub(CATCHES_UP_NS);
        clock.sleep_until_ns(due_ns);
    }
}
