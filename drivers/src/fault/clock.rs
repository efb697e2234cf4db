//! Injects late wake-ups into a control loop.

use hal::Clock;

use super::injector::{Faults, Injector};
use super::kind::{Device, Kind};

/// Wraps a clock and wakes its sleepers late.
pub struct FaultyClock<C> {
    inner: C,
    injector: Injector,
}

impl<C: Clock> FaultyClock<C> {
    pub fn new(inner: C, faults: &Faults) -> Self {
        Self { inner, injector: faults.for_device(Device::Clock) }
    }

    /// The wrapped clock.
    pub fn inner(&self) -> &C {
        &self.inner
    }

    /// Removes the wrapper.
    pub fn into_inner(self) -> C {
        self.inner
    }

    /// The wrapped clock.
    pub fn inner_mut(&mut self) -> &mut C {
        &mut self.inner
    }
}

impl<C: Clock> Clock for FaultyClock<C> {
    fn now_ns(&self) -> u64 {
        self.inner.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        let late_ns =
            self.injector.active(Kind::Slow).map_or(0, |fault| (fault.amount() * 1e6) as u64);
        self.inner.sleep_until_ns(deadline_ns.saturating_add(late_ns));
    }
}
