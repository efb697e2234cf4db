//! Not faster than allowed.

use hal::Clock;

/// After a pause of this long, the time that was not used is lost: no burst follows.
const BURST_NS: u64 = 200_000_000;

/// Holds a stream back; what is not read, the link does not send.
pub struct Pace<'a> {
    clock: &'a mut dyn Clock,
    bytes_per_s: Option<u64>,
    /// When what came so far should have come.
    due_ns: u64,
}

impl<'a> Pace<'a> {
    /// From now on, so many bytes a second; `None` for as fast as it goes.
    pub fn new(clock: &'a mut dyn Clock, bytes_per_s: Option<u64>) -> Self {
        Self { due_ns: clock.now_ns(), clock, bytes_per_s }
    }

    pub(super) fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// So many bytes came; returns when the next ones may.
    pub fn came(&mut self, bytes: usize) {
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
    fn a_limit_of_five_megabytes_lets_five_megabytes_through_in_a_second() {
        let mut clock = VirtualClock::default();
        let mut pace = Pace::new(&mut clock, Some(5_000_000));
        for _ in 0..500 {
            pace.came(10_000);
        }
        assert_eq!(clock.now_ns(), 1_000_000_000);
    }

    #[test]
    fn a_pause_is_no_credit() {
        let mut clock = VirtualClock::default();
        clock.sleep_until_ns(3_600_000_000_000);
        let start_ns = clock.now_ns();
        let mut pace = Pace::new(&mut clock, Some(1000));
        pace.due_ns = 0;
        pace.came(10_000);
        assert!(clock.now_ns() - start_ns >= 10_000_000_000 - BURST_NS);
    }

    #[test]
    fn without_a_limit_nothing_waits() {
        let mut clock = VirtualClock::default();
        Pace::new(&mut clock, None).came(usize::MAX);
        assert_eq!(clock.now_ns(), 0);
    }
}
