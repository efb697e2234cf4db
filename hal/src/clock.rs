//! The monotonic clock on which all times of this workspace are measured.

/// Monotonic time in nanoseconds. The epoch is arbitrary but fixed for the life of the clock.
pub trait Clock {
    /// The current time. It never decreases.
    fn now_ns(&self) -> u64;

    /// Returns at `deadline_ns`, or as soon after it as the scheduler allows. Returns at once when
    /// the deadline has passed. This is the only method of this crate that may block. A
    /// [`VirtualClock`] jumps to the deadline instead.
    fn sleep_until_ns(&mut self, deadline_ns: u64);
}

/// A clock for simulation and tests. Its time advances only when a caller sleeps, so runs are as
/// fast as the machine allows and repeatable.
#[derive(Debug, Clone, Default)]
pub struct VirtualClock {
    now_ns: u64,
}

impl VirtualClock {
    /// A clock whose current time is `now_ns`.
    #[must_use]
    pub fn starting_at_ns(now_ns: u64) -> Self {
        Self { now_ns }
    }
}

impl Clock for VirtualClock {
    fn now_ns(&self) -> u64 {
        self.now_ns
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.now_ns = self.now_ns.max(deadline_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_time_jumps_to_the_deadline_and_never_goes_back() {
        let mut clock = VirtualClock::starting_at_ns(5);
        clock.sleep_until_ns(10);
        assert_eq!(clock.now_ns(), 10);
        clock.sleep_until_ns(7);
        assert_eq!(clock.now_ns(), 10);
    }
}
