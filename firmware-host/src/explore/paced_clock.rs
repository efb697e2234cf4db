//! A simulated clock that runs no faster than the wall's, so that a person can watch the run and stop it.

use std::time::{Duration, Instant};

use hal::Clock;

/// The simulation may catch up this much after a slow tick; what is slower than that stays behind.
const CATCHES_UP: Duration = Duration::from_millis(200);

/// A clock that sleeps while another one is asked to.
#[derive(Debug, Clone)]
pub struct PacedClock<K> {
    inner: K,
    /// When the simulated time was 0; `None` to run as fast as possible.
    began: Option<Instant>,
}

impl<K: Clock> PacedClock<K> {
    /// Paces `inner`, or not.
    pub fn new(inner: K, real_time: bool) -> Self {
        let elapsed = Duration::from_nanos(inner.now_ns());
        let began = Instant::now().checked_sub(elapsed).filter(|_| real_time);
        Self { inner, began }
    }
}

impl<K: Clock> Clock for PacedClock<K> {
    fn now_ns(&self) -> u64 {
        self.inner.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.inner.sleep_until_ns(deadline_ns);
        let Some(began) = &mut self.began else { return };
        let due = *began + Duration::from_nanos(deadline_ns);
        let now = Instant::now();
        if now < due {
            std::thread::sleep(due - now);
        } else if now - due > CATCHES_UP {
            *began += now - due - CATCHES_UP;
        }
    }
}
