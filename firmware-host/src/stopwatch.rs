//! Measures how long each stage of a tick takes. The runtime has no clock and calls this one.

use std::time::Instant;

use runtime::robot::{Stage as RobotStage, StageTimer};

use crate::report::latency::{Latencies, Stage};

/// Measures the time between consecutive calls.
#[derive(Debug)]
pub struct Stopwatch {
    latencies: Latencies,
    last: Instant,
}

impl Default for Stopwatch {
    fn default() -> Self {
        Self { latencies: Latencies::default(), last: Instant::now() }
    }
}

impl Stopwatch {
    /// Starts the time that the next call of [`lap`](Self::lap) counts.
    pub fn start(&mut self) {
        self.last = Instant::now();
    }

    /// Counts the time since the last call for `stage`.
    pub fn lap(&mut self, stage: Stage) {
        let now = Instant::now();
        self.latencies.record(stage, (now - self.last).as_nanos() as u64);
        self.last = now;
    }

    /// Counts the time since `since` for `stage`, including the times of other stages in between.
    pub fn since(&mut self, since: Instant, stage: Stage) {
        self.last = Instant::now();
        self.latencies.record(stage, (self.last - since).as_nanos() as u64);
    }

    /// The measured latencies.
    #[must_use]
    pub fn latencies(&self) -> &Latencies {
        &self.latencies
    }
}

impl StageTimer for Stopwatch {
    fn ended(&mut self, stage: RobotStage) {
        self.lap(match stage {
            RobotStage::Coarse => Stage::Coarse,
            RobotStage::Dense => Stage::Dense,
            RobotStage::Network => Stage::Network,
            RobotStage::Map => Stage::Map,
            RobotStage::Plan => Stage::Plan,
        });
    }
}
