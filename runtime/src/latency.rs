//! Percentiles of durations, in memory of constant size. The runtime reads no clock, so the caller
//! measures the durations.

use serde::{Deserialize, Serialize};

/// Median, 99th percentile and maximum, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    pub p50: f64,
    pub p99: f64,
    /// The exact maximum.
    pub max: f64,
}

/// Counts durations in log-linear buckets like HdrHistogram, with 64 buckets per octave. A
/// percentile is within 0.8 % of the exact one.
#[derive(Debug, Clone)]
pub struct LatencyHistogram {
    counts: Vec<u64>,
    total: u64,
    max_ns: u64,
}

const BITS: u32 = 6;
const PER_OCTAVE: u64 = 1 << BITS;
/// Durations above this (18 minutes) are counted as this.
const LONGEST_NS: u64 = (1 << 40) - 1;

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self { counts: vec![0; bucket(LONGEST_NS) + 1], total: 0, max_ns: 0 }
    }
}

impl LatencyHistogram {
    /// Adds one duration, nanoseconds. It does not allocate.
    pub fn record(&mut self, duration_ns: u64) {
        self.counts[bucket(duration_ns.min(LONGEST_NS))] += 1;
        self.total += 1;
        self.max_ns = self.max_ns.max(duration_ns);
    }

    /// The duration, nanoseconds, that a share `quantile` of all durations does not exceed (nearest
    /// rank); `None` if no duration was recorded.
    #[must_use]
    pub fn quantile_ns(&self, quantile: f64) -> Option<u64> {
        let rank = ((quantile * self.total as f64).ceil() as u64).clamp(1, self.total.max(1));
        let mut seen = 0;
        let index = self.counts.iter().position(|count| {
            seen += count;
            seen >= rank
        })?;
        Some(middle_ns(index).min(self.max_ns))
    }

    /// `None` if no duration was recorded.
    #[must_use]
    pub fn percentiles(&self) -> Option<Percentiles> {
        Some(Percentiles {
            p50: milliseconds(self.quantile_ns(0.5)?),
            p99: milliseconds(self.quantile_ns(0.99)?),
            max: milliseconds(self.max_ns),
        })
    }
}

fn milliseconds(ns: u64) -> f64 {
    ns as f64 / 1e6
}

/// Index of a duration's bucket. Durations below 64 ns have one bucket each; above, each octave has
/// 64 equal buckets.
fn bucket(ns: u64) -> usize {
    if ns < PER_OCTAVE {
        return ns as usize;
    }
    let shift = ns.ilog2() - BITS;
    (u64::from(shift) * PER_OCTAVE + (ns >> shift)) as usize
}

/// The duration in the middle of a bucket, nanoseconds.
fn middle_ns(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    if bucket < 2 * PER_OCTAVE {
        return bucket;
    }
    let shift = bucket / PER_OCTAVE - 1;
    let low = (bucket - shift * PER_OCTAVE) << shift;
    low + (1 << shift) / 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_quantile_is_within_one_percent_of_the_exact_one(
            exponents in proptest::collection::vec(0.0..38.0f64, 1..400), quantile in 0.0..=1.0f64,
        ) {
            let mut durations: Vec<u64> = exponents.iter().map(|exponent| exponent.exp2() as u64).collect();
            let mut histogram = LatencyHistogram::default();
            durations.iter().for_each(|duration| histogram.record(*duration));
            durations.sort_unstable();
            let rank = (quantile * durations.len() as f64).ceil() as usize;
            let exact = durations[rank.max(1) - 1];
            let measured = histogram.quantile_ns(quantile).unwrap();
            prop_assert!(measured.abs_diff(exact) as f64 <= 0.01 * exact as f64, "{} for {}", measured, exact);
        }

        #[test]
        fn a_longer_duration_is_never_in_an_earlier_bucket(ns in 0..LONGEST_NS) {
            prop_assert!(bucket(ns + 1) == bucket(ns) || bucket(ns + 1) == bucket(ns) + 1);
        }
    }

    #[test]
    fn without_durations_there_are_no_percentiles() {
        assert_eq!(LatencyHistogram::default().percentiles(), None);
    }

    #[test]
    fn the_maximum_is_exact_even_beyond_the_last_bucket() {
        let mut histogram = LatencyHistogram::default();
        histogram.record(u64::MAX);
        histogram.record(1_234_567);
        let percentiles = histogram.percentiles().unwrap();
        assert!((percentiles.max - u64::MAX as f64 / 1e6).abs() < 1.0);
        assert!((percentiles.p50 - 1.234_567).abs() < 0.013);
    }
}
