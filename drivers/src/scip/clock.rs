//! Conversion of a sensor's timestamps to the monotonic clock. Sensors stamp their scans with a
//! millisecond clock of their own, which wraps every 2^24 ms and drifts.

/// The sensor's clock wraps after this many milliseconds.
const WRAP_MS: i64 = 1 << 24;
const MS: i64 = 1_000_000;

/// One request for the sensor's time (`TM1`) and its response.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimeProbe {
    /// Monotonic time at which the request was sent.
    pub sent_ns: u64,
    /// Monotonic time at which the response arrived.
    pub received_ns: u64,
    /// The time of the sensor's clock.
    pub sensor_ms: u32,
}

/// Converts the sensor's timestamps to the monotonic clock.
///
/// The initial offset is taken from the request with the shortest round trip, half of which bounds
/// the error. After that, the shortest delay between timestamp and arrival is measured in windows
/// of [`WINDOW`](Self::WINDOW) scans. It changes only when one clock drifts against the other, so
/// its change corrects the offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClockSync {
    /// The monotonic clock minus the sensor's clock.
    offset_ns: i64,
    /// Bound of the offset's error at the time of the requests.
    uncertainty_ns: u64,
    /// The shortest delay of the first window.
    reference_delay_ns: Option<i64>,
    window_delay_ns: i64,
    window_scans: u32,
}

impl ClockSync {
    /// Number of scans after which the offset is corrected: 1 s at 40 Hz, in which a clock with an
    /// error of 500 ppm drifts by 0.5 ms.
    pub const WINDOW: u32 = 40;

    /// Computes the offset from time requests. `None` without any.
    #[must_use]
    pub fn from_probes(probes: &[TimeProbe]) -> Option<Self> {
        let best =
            probes.iter().min_by_key(|probe| probe.received_ns.saturating_sub(probe.sent_ns))?;
        let round_trip_ns = best.received_ns.saturating_sub(best.sent_ns);
        // The sensor's clock shows whole milliseconds. On average the true time is half a
        // millisecond later.
        let sensor_ns = i64::from(best.sensor_ms) * MS + MS / 2;
        Some(Self::new(
            (best.sent_ns + round_trip_ns / 2) as i64 - sensor_ns,
            round_trip_ns / 2 + MS as u64 / 2,
        ))
    }

    /// The clock of a sensor that does not report its time. It assumes that a scan arrives one
    /// period after its start.
    #[must_use]
    pub fn from_scan(stamp_ms: u32, arrival_ns: u64, period_ns: u64) -> Self {
        Self::new(arrival_ns as i64 - period_ns as i64 - i64::from(stamp_ms) * MS, period_ns)
    }

    fn new(offset_ns: i64, uncertainty_ns: u64) -> Self {
        Self {
            offset_ns,
            uncertainty_ns,
            reference_delay_ns: None,
            window_delay_ns: i64::MAX,
            window_scans: 0,
        }
    }

    /// Bound of the error of the offset when it was measured.
    #[must_use]
    pub fn uncertainty_ns(&self) -> u64 {
        self.uncertainty_ns
    }

    /// The monotonic start time of a scan with this timestamp that arrived at `arrival_ns`. `None`
    /// when the timestamp is in the future or more than `oldest_ns` in the past, which means that
    /// the sensor's clock was reset.
    pub fn scan_start_ns(&mut self, stamp_ms: u32, arrival_ns: u64, oldest_ns: u64) -> Option<u64> {
        let arrival = arrival_ns as i64;
        let delay = arrival - self.nearest_host_ns(stamp_ms, arrival);
        let slack = self.uncertainty_ns as i64 + MS;
        if delay < -slack || delay > oldest_ns as i64 + slack {
            return None;
        }
        self.correct_drift(delay);
        Some((arrival - delay.max(0)).max(0) as u64)
    }

    /// The sensor's clock wraps, so a timestamp corresponds to several monotonic times. Returns the
    /// one nearest to `near_ns`.
    fn nearest_host_ns(&self, stamp_ms: u32, near_ns: i64) -> i64 {
        let expected_ms = (near_ns - self.offset_ns).div_euclid(MS);
        let ahead_ms =
            (i64::from(stamp_ms) - expected_ms + WRAP_MS / 2).rem_euclid(WRAP_MS) - WRAP_MS / 2;
        (expected_ms + ahead_ms) * MS + self.offset_ns
    }

    fn correct_drift(&mut self, delay_ns: i64) {
        self.window_delay_ns = self.window_delay_ns.min(delay_ns);
        self.window_scans += 1;
        if self.window_scans < Self::WINDOW {
            return;
        }
        match self.reference_delay_ns {
            None => self.reference_delay_ns = Some(self.window_delay_ns),
            Some(reference) => {
                // Up to one millisecond is due to rounding in the sensor.
                let drift = self.window_delay_ns - reference;
                self.offset_ns += drift - drift.clamp(-MS, MS);
            }
        }
        self.window_delay_ns = i64::MAX;
        self.window_scans = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_NS: u64 = 25_000_000;

    fn probe(sent_ms: u64, round_trip_ms: u64, sensor_ms: u32) -> TimeProbe {
        TimeProbe {
            sent_ns: sent_ms * 1_000_000,
            received_ns: (sent_ms + round_trip_ms) * 1_000_000,
            sensor_ms,
        }
    }

    #[test]
    fn the_offset_is_that_of_the_fastest_response() {
        let slow = probe(1000, 80, 579);
        let fast = probe(1100, 2, 600);
        let mut sync = ClockSync::from_probes(&[slow, fast, slow]).unwrap();
        assert_eq!(sync.uncertainty_ns(), 1_500_000);
        let start = sync.scan_start_ns(700, 1_226_000_000, PERIOD_NS).unwrap();
        assert!(start.abs_diff(1_201_000_000) <= 500_000, "{start}");
        assert_eq!(ClockSync::from_probes(&[]), None);
    }

    #[test]
    fn a_timestamp_in_the_future_or_far_in_the_past_is_refused() {
        let mut sync = ClockSync::from_probes(&[probe(0, 0, 0)]).unwrap();
        assert!(sync.scan_start_ns(1000, 1_025_000_000, 2 * PERIOD_NS).is_some());
        assert_eq!(sync.scan_start_ns(1000, 900_000_000, 2 * PERIOD_NS), None);
        assert_eq!(sync.scan_start_ns(0, 1_025_000_000, 2 * PERIOD_NS), None);
    }

    proptest! {
        #[test]
        fn a_clock_that_wraps_does_not_falsify_the_time(
            start_ms in 0..1_u32 << 24,
            scans in 1..2000_u64,
        ) {
            let mut sync = ClockSync::from_probes(&[probe(5000, 0, start_ms)]).unwrap();
            let passed_ms = scans * 3_600_000 / 2000 * 12;
            let stamp = ((u64::from(start_ms) + passed_ms) % (1 << 24)) as u32;
            let begun_ns = (5000 + passed_ms) * 1_000_000;
            let found = sync.scan_start_ns(stamp, begun_ns + PERIOD_NS, 2 * PERIOD_NS).unwrap();
            prop_assert!(found.abs_diff(begun_ns) <= 1_000_000);
        }

        #[test]
        fn a_drifting_clock_is_followed_within_four_milliseconds(ppm in -500.0..500.0_f64) {
            let mut sync = ClockSync::from_probes(&[probe(0, 0, 0)]).unwrap();
            for scan in 1..40_000_u64 {
                let begun_ns = scan * PERIOD_NS;
                let stamp_ms = (begun_ns as f64 * (1.0 + ppm * 1e-6) / 1e6) as u32;
                let arrival_ns = begun_ns + PERIOD_NS + scan * 7919 % 2_000_000;
                let found = sync.scan_start_ns(stamp_ms, arrival_ns, 2 * PERIOD_NS).unwrap();
                prop_assert!(found.abs_diff(begun_ns) < 4_000_000, "scan {scan}: {found} for \
                    {begun_ns}");
            }
        }
    }
}
