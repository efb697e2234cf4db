//! Conversion of a CAN adapter's hardware timestamps to the monotonic clock.

/// Relative drift of two crystals of 50 ppm each, in opposite directions.
const DRIFT: f64 = 100e-6;
/// A larger jump means that the adapter restarted its clock.
const RESTART_NS: i64 = 1_000_000_000;

/// Maps an adapter's clock to the monotonic clock. A frame's software timestamp is late by a
/// varying delay, and its hardware timestamp is not. The smallest difference difference between the
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

#[cfg(test)]
mod tests {
    use super::*;

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
