//! Time stamps of CAN adapters, brought to the monotonic clock.

/// Two crystals of 50 ppm each, in opposite directions.
const DRIFT: f64 = 100e-6;
/// A jump by more than this means that the adapter has started counting anew.
const RESTART_NS: i64 = 1_000_000_000;

/// Maps an adapter's own clock to ours. A frame's software stamp is late by a varying delay, its hardware stamp is not, so the
/// smallest distance seen between the two is the best estimate of the clocks' distance; it is let go at the rate at which
/// crystals drift.
#[derive(Debug, Clone, Copy, Default)]
pub struct HardwareClock {
    ahead_ns: Option<i64>,
    last_ns: u64,
}

impl HardwareClock {
    /// When a frame came, monotonic, from its hardware stamp and its software stamp, the latter monotonic already. Never later
    /// than the software stamp.
    pub fn monotonic_ns(&mut self, hardware_ns: u64, software_ns: u64) -> u64 {
        let seen = (software_ns as i64).wrapping_sub(hardware_ns as i64);
        let allowance = (software_ns.saturating_sub(self.last_ns) as f64 * DRIFT) as i64;
        let ahead = match self.ahead_ns {
            Some(known) if seen.saturating_sub(known).abs() < RESTART_NS => {
                seen.min(known + allowance)
            }
            _ => seen,
        };
        self.ahead_ns = Some(ahead);
        self.last_ns = software_ns;
        (hardware_ns as i64).wrapping_add(ahead).max(0) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_software_stamps_do_not_spoil_the_time() {
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
    fn an_adapter_that_counts_anew_is_followed() {
        let mut clock = HardwareClock::default();
        assert_eq!(clock.monotonic_ns(10_000_000_000, 20_000_000_000), 20_000_000_000);
        assert_eq!(clock.monotonic_ns(0, 21_000_000_000), 21_000_000_000);
    }
}
