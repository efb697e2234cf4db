//! The current goal, and whether the robot makes progress towards it.

use serde::{Deserialize, Serialize};

use super::config::ExplorationConfig;
use super::observations::Observations;
use crate::event::{DropReason, GoalReason};

/// The remaining path must become shorter by more than this to count as progress, metres.
const PROGRESS_M: f64 = 0.1;

/// A goal with the progress towards it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// Where to drive: free floor in `odom`, metres.
    pub target_m: [f64; 2],
    /// The place to observe from there (the frontier's centroid or where the frontier is approached, the inconsistent place), in
    /// `odom`, metres.
    pub interest_m: [f64; 2],
    pub why: GoalReason,
    chosen_ns: u64,
    nearest_m: f64,
    nearest_ns: u64,
    trips: u32,
}

impl Goal {
    /// A goal chosen at `now_ns`.
    #[must_use]
    pub fn new(target_m: [f64; 2], interest_m: [f64; 2], why: GoalReason, now_ns: u64) -> Self {
        Self {
            target_m,
            interest_m,
            why,
            chosen_ns: now_ns,
            nearest_m: f64::INFINITY,
            nearest_ns: now_ns,
            trips: 0,
        }
    }

    /// Whether the goal is a frontier, so that it is resolved once no unknown floor is left there.
    #[must_use]
    pub fn is_frontier(&self) -> bool {
        matches!(self.why, GoalReason::Frontier | GoalReason::DoubtfulFrontier)
    }

    /// Records that `left_m` metres of the path are left.
    pub fn record_distance(&mut self, left_m: f64, now_ns: u64) {
        if left_m < self.nearest_m - PROGRESS_M {
            self.nearest_m = left_m;
            self.nearest_ns = now_ns;
        }
    }

    /// Restarts the distance comparison because the path has changed: a detour may be longer. The
    /// time of the last progress stays.
    pub fn restart_progress(&mut self) {
        self.nearest_m = f64::INFINITY;
    }

    /// Counts a trip of the safety plane on the path; returns the number of trips so far.
    pub fn record_trip(&mut self) -> u32 {
        self.trips += 1;
        self.trips
    }

    /// Why the goal has to be given up now, if it has to. Counts the trip of this tick.
    pub(super) fn why_to_drop(
        &mut self,
        config: &ExplorationConfig,
        senses: &Observations<'_>,
    ) -> Option<DropReason> {
        let stalled_s = self.stalled_ns(senses.time_ns) as f64 * 1e-9;
        let age_s = self.age_ns(senses.time_ns) as f64 * 1e-9;
        if senses.bumped && self.record_trip() >= config.trips_per_goal {
            Some(DropReason::Blocked)
        } else if stalled_s > config.progress_timeout_s {
            Some(DropReason::NoProgress)
        } else if age_s > config.goal_timeout_s {
            Some(DropReason::Timeout)
        } else {
            None
        }
    }

    /// Time since the last progress.
    #[must_use]
    pub fn stalled_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.nearest_ns)
    }

    /// Time since the goal was chosen.
    #[must_use]
    pub fn age_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.chosen_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_clearly_shorter_path_resets_the_progress_clock() {
        let mut goal = Goal::new([1.0, 0.0], [1.0, 0.0], GoalReason::Frontier, 0);
        goal.record_distance(3.0, 10);
        goal.record_distance(2.95, 20);
        goal.record_distance(3.2, 30);
        assert_eq!(goal.stalled_ns(40), 30);
        goal.record_distance(2.5, 50);
        assert_eq!(goal.stalled_ns(60), 10);
        assert_eq!(goal.age_ns(60), 60);
    }

    #[test]
    fn trips_are_counted() {
        let mut goal = Goal::new([1.0, 0.0], [1.0, 0.0], GoalReason::Frontier, 0);
        assert_eq!((goal.record_trip(), goal.record_trip()), (1, 2));
    }
}
