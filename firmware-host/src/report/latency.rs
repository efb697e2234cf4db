//! Time taken by each stage of the control loop.

use std::collections::BTreeMap;

use runtime::latency::{LatencyHistogram, Percentiles};
use serde::{Deserialize, Serialize};

/// A part of the control loop whose time is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// One tick of the control loop, without simulator, recording and reports.
    Total,
    /// Computation of coarse depth.
    Coarse,
    /// Completion of coarse depth to dense depth.
    Dense,
    /// Inference of the depth network.
    Network,
    /// Update of the map.
    Map,
    /// Choice of a goal, path search and path following.
    Plan,
    /// Rendering one simulated camera frame and scan.
    Simulator,
    /// Handing the data of one tick to the recorder.
    Record,
    /// Copying the data of one tick for the live view.
    Live,
    /// Lateness of the ticks of the safety loop, on a real robot.
    SafetyLate,
}

impl Stage {
    const ALL: [Self; 10] = [
        Self::Total,
        Self::Coarse,
        Self::Dense,
        Self::Network,
        Self::Map,
        Self::Plan,
        Self::Simulator,
        Self::Record,
        Self::Live,
        Self::SafetyLate,
    ];

    /// The name in the summary.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Total => "total",
            Self::Coarse => "coarse",
            Self::Dense => "dense",
            Self::Network => "network",
            Self::Map => "map",
            Self::Plan => "plan",
            Self::Simulator => "simulator",
            Self::Record => "record",
            Self::Live => "live",
            Self::SafetyLate => "safety_late",
        }
    }
}

/// One latency histogram per stage.
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
    /// Adds one measurement in nanoseconds. Does not allocate.
    pub fn record(&mut self, stage: Stage, duration_ns: u64) {
        // `stages` has one element for each element of `ALL`, which lists the stages in their
        // order.
        self.stages[stage as usize].record(duration_ns);
    }

    /// Percentiles, in milliseconds, of every stage with at least one measurement.
    #[must_use]
    pub fn percentiles(&self) -> BTreeMap<Stage, Percentiles> {
        Stage::ALL
            .into_iter()
            .zip(&self.stages)
            .filter_map(|(stage, times)| Some((stage, times.percentiles()?)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_measurements_there_are_no_percentiles() {
        assert!(Latencies::default().percentiles().is_empty());
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
    fn every_stage_has_its_index_and_the_name_in_the_summary() {
        for (index, stage) in Stage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, index);
            assert_eq!(serde_json::to_value(stage).unwrap(), stage.name());
        }
    }
}
