//! Conversion of a CAN adapter's hardware timestamps to the monotonic clock.

/// Relative drift of two crystals of 50 ppm each, in opposite directions.
const DRIFT: f64 = 100e-6;
/// A larger jump means that the adapter restarted its clock.
const RESTART_NS: i64 = 1_000_000_000;

/// Maps an adapter's clock to the monotonic clock. A frame's software timestamp is late by a
/// varying delay, and its hardware timestamp is not. The smallest difference between the
/// two is therefore the best estimate of the clocks' offset. The estimate may grow at the rate at
/// which crystals drift.
#[derive(Debug, Clone, Copy, Default)]
pub struct HardwareClock {
    ahead_ns: Option<i64>,
    last_ns: u64,
}

impl HardwareClock {
    /// The monotonic reception time of a frame, from its hardware timestamp and its software
    /// timestamp, which is monotonic already. Never later than the software timestamp.
    pub fn monotonic_ns(&mut self, hardware_ns: u64, software_ns: u64) -> u64 {
        let difference = (software_ns as i64).wrapping_sub(hardware_ns as i64);
        let allowance = (software_ns.saturating_sub(self.last_ns) as f64 * DRIFT) as i64;
        let ahead = match self.ahead_ns {
            Some(known) if difference.saturating_sub(known).abs() < RESTART_NS => {
                difference.min(known + allowance)
            }
            _ => difference,
        };
        self.ahead_ns = Some(ahead);
        self.last_ns = software_ns;
        (hardware_ns as i64).wrapping_add(ahead).max(0) as u64
    }
}

/// The reception times of a bus that is read until it is empty in every tick.
///
/// The kernel stamps frames with the realtime clock, which may be set at any moment. Therefore a
/// stamp is only believed between two monotonic times that the reader knows: a frame cannot have
/// arrived before the queue was last seen empty, nor after it was read.
#[derive(Debug, Clone, Copy, Default)]
pub struct ReceiveClock {
    emptied_ns: u64,
    hardware: Option<HardwareClock>,
}

impl ReceiveClock {
    /// The clock of a bus whose queue is empty at `now_ns`.
    #[must_use]
    pub fn new(now_ns: u64, has_hardware_stamps: bool) -> Self {
        let hardware = has_hardware_stamps.then(HardwareClock::default);
        Self { emptied_ns: now_ns, hardware }
    }

    /// Records that the queue was empty at `now_ns`.
    pub fn emptied(&mut self, now_ns: u64) {
        self.emptied_ns = self.emptied_ns.max(now_ns);
    }

    /// The reception time of a frame that was read at `now_ns`. `software_ns` is the kernel's stamp
    /// converted to the monotonic clock; `hardware_ns` is on the adapter's own clock.
    pub fn time_ns(&mut self, software_ns: u64, hardware_ns: Option<u64>, now_ns: u64) -> u64 {
        let earliest_ns = self.emptied_ns.min(now_ns);
        let software_ns = software_ns.clamp(earliest_ns, now_ns);
        match (&mut self.hardware, hardware_ns) {
            (Some(clock), Some(hardware_ns)) => {
                clock.monotonic_ns(hardware_ns, software_ns).clamp(earliest_ns, now_ns)
            }
            _ => software_ns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_realtime_clock_that_is_set_while_frames_wait_makes_no_frame_older_than_a_tick() {
        let tick_ns = 10_000_000;
        let mut clock = ReceiveClock::new(1_000_000_000, true);
        for tick in 100..2000_u64 {
            let now_ns = tick * tick_ns;
            let arrived_ns = now_ns - 4_000_000;
            // At tick 200 the realtime clock was set forward by half a second after the frame had
            // been stamped, so its stamp seems to be half a second old.
            let software_ns = if tick == 200 { arrived_ns - 500_000_000 } else { arrived_ns };
            let time_ns = clock.time_ns(software_ns, Some(arrived_ns + 77), now_ns);
            let age_ns = now_ns - time_ns;
            assert!(age_ns <= tick_ns, "{age_ns} ns old in tick {tick}");
            clock.emptied(now_ns);
        }
    }

    #[test]
    fn late_software_timestamps_do_not_falsify_the_time() {
        let mut clock = HardwareClock::default();
        let true_ahead = 5_000_000_000u64;
        let mut worst = 0;
        for k in 0..1000u64 {
            let hardware = k * 10_000_000;
            let delay = if k % 7 == 0 { 20_000 } else { 900_000 + k * 100 };
            let time = clock.monotonic_ns(hardware, hardware + true_ahead + delay);
            worst = worst.max(time - (hardware + true_ahead));
        }
        assert!(worst < 40_000, "at most the smallest delay and 70 ms of drift, was {worst} ns");
    }

    #[test]
    fn an_adapter_that_restarts_its_clock_is_followed() {
        let mut clock = HardwareClock::default();
        assert_eq!(clock.monotonic_ns(10_000_000_000, 20_000_000_000), 20_000_000_000);
        assert_eq!(clock.monotonic_ns(0, 21_000_000_000), 21_000_000_000);
    }
}
