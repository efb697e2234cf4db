//! How long each stage of the loop takes.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// A part of the loop whose time is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// One whole turn of the robot's loop, without simulator, recording and reports.
    Total,
    /// Coarse depth from ego-motion.
    Coarse,
    /// The depth network.
    Network,
    /// The map update.
    Map,
    /// Goal choice, path search and following.
    Plan,
    /// Rendering one simulated camera frame and scan.
    Simulator,
    /// Handing one turn to the recording.
    Record,
}

impl Stage {
    const ALL: [Self; 7] =
        [Self::Total, Self::Coarse, Self::Network, Self::Map, Self::Plan, Self::Simulator, Self::Record];

    /// As in the summary.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Total => "total",
            Self::Coarse => "coarse",
            Self::Network => "network",
            Self::Map => "map",
            Self::Plan => "plan",
            Self::Simulator => "simulator",
            Self::Record => "record",
        }
    }
}

/// Median, 99th percentile and maximum, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum, exact.
    pub max: f64,
}

/// One histogram a stage.
#[derive(Debug, Clone)]
pub struct Latencies {
    stages: Vec<LatencyHistogram>,
}

impl Default for Latencies {
    fn default() -> Self {
        Self { stages: vec![LatencyHistogram::default(); Stage::ALL.len()] }
    }
}

impl Latencies {
    /// Adds one measurement, nanoseconds. Does not allocate.
    pub fn record(&mut self, stage: Stage, duration_ns: u64) {
        // `stages` is as long as `ALL`, which holds every stage in its order.
        self.stages[stage as usize].record(duration_ns);
    }

    /// Percentiles of every stage that was measured.
    #[must_use]
    pub fn percentiles(&self) -> BTreeMap<Stage, Percentiles> {
        Stage::ALL
            .into_iter()
            .zip(&self.stages)
            .filter_map(|(stage, times)| Some((stage, times.percentiles()?)))
            .collect()
    }
}

/// Counts durations in log-linear buckets, as in HdrHistogram: 64 buckets an octave, so a percentile is within 0.8 % of the
/// exact one, in memory that never grows.
#[derive(Debug, Clone)]
pub struct LatencyHistogram {
    counts: Vec<u64>,
    total: u64,
    max_ns: u64,
}

const BITS: u32 = 6;
const PER_OCTAVE: u64 = 1 << BITS;
/// Longer durations (18 minutes) count as this.
const LONGEST_NS: u64 = (1 << 40) - 1;

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self { counts: vec![0; bucket(LONGEST_NS) + 1], total: 0, max_ns: 0 }
    }
}

impl LatencyHistogram {
    /// Adds one duration, nanoseconds. Does not allocate.
    pub fn record(&mut self, duration_ns: u64) {
        self.counts[bucket(duration_ns.min(LONGEST_NS))] += 1;
        self.total += 1;
        self.max_ns = self.max_ns.max(duration_ns);
    }

    /// The duration, nanoseconds, that a share `quantile` of all durations does not exceed (nearest rank); `None` when
    /// nothing was recorded.
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

    /// `None` when nothing was recorded.
    #[must_use]
    pub fn percentiles(&self) -> Option<Percentiles> {
        let ms = |ns: u64| ns as f64 / 1e6;
        let p50 = ms(self.quantile_ns(0.5)?);
        let p99 = ms(self.quantile_ns(0.99)?);
        Some(Percentiles { p50, p99, max: ms(self.max_ns) })
    }
}

/// Durations below 64 ns have a bucket each; above, every octave has 64 equal ones.
fn bucket(ns: u64) -> usize {
    if ns < PER_OCTAVE {
        return ns as usize;
    }
    let shift = ns.ilog2() - BITS;
    (u64::from(shift) * PER_OCTAVE + (ns >> shift)) as usize
}

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
    fn nothing_recorded_is_nothing_reported() {
        assert_eq!(LatencyHistogram::default().percentiles(), None);
        assert!(Latencies::default().percentiles().is_empty());
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

    #[test]
    fn stages_are_kept_apart() {
        let mut latencies = Latencies::default();
        latencies.record(Stage::Map, 2_000_000);
        latencies.record(Stage::Total, 8_000_000);
        let percentiles = latencies.percentiles();
        assert_eq!(percentiles.keys().copied().collect::<Vec<_>>(), [Stage::Total, Stage::Map]);
        assert!((percentiles[&Stage::Map].p50 - 2.0).abs() < 0.02);
    }

    #[test]
    fn every_stage_stands_at_its_place_and_is_named_as_in_the_summary() {
        for (index, stage) in Stage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, index);
            assert_eq!(serde_json::to_value(stage).unwrap(), stage.name());
        }
    }
}
