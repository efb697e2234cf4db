//! A place to go to, and whether we are getting there.

use serde::{Deserialize, Serialize};

use crate::event::GoalReason;

/// Coming nearer by less than this is not progress, metres.
const PROGRESS_M: f64 = 0.1;

/// A goal and the record of the way to it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// Where to drive, in `odom`, metres: on free floor.
    pub target_m: [f64; 2],
    /// What is worth looking at there (the frontier's middle, the inconsistent place), in `odom`, metres.
    pub interest_m: [f64; 2],
    /// Why it was chosen.
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

    /// Whether there is something unknown to see.
    #[must_use]
    pub fn is_frontier(&self) -> bool {
        matches!(self.why, GoalReason::Frontier | GoalReason::LookAgain)
    }

    /// Notes that `left_m` of the way are left.
    pub fn note_distance(&mut self, left_m: f64, now_ns: u64) {
        if left_m < self.nearest_m - PROGRESS_M {
            self.nearest_m = left_m;
            self.nearest_ns = now_ns;
        }
    }

    /// The way has become another one (a detour may be longer): progress is counted anew, the clock is not.
    pub fn note_new_way(&mut self) {
        self.nearest_m = f64::INFINITY;
    }

    /// Notes that the bumper tripped on the way; returns how often it has.
    pub fn note_trip(&mut self) -> u32 {
        self.trips += 1;
        self.trips
    }

    /// Time since the last progress.
    #[must_use]
    pub fn stalled_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.nearest_ns)
    }

    /// Time since it was chosen.
    #[must_use]
    pub fn age_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.chosen_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coming_nearer_resets_the_progress_clock_and_wobbling_does_not() {
        let mut goal = Goal::new([1.0, 0.0], [1.0, 0.0], GoalReason::Frontier, 0);
        goal.note_distance(3.0, 10);
        goal.note_distance(2.95, 20);
        goal.note_distance(3.2, 30);
        assert_eq!(goal.stalled_ns(40), 30);
        goal.note_distance(2.5, 50);
        assert_eq!(goal.stalled_ns(60), 10);
        assert_eq!(goal.age_ns(60), 60);
    }

    #[test]
    fn trips_are_counted() {
        let mut goal = Goal::new([1.0, 0.0], [1.0, 0.0], GoalReason::Frontier, 0);
        assert_eq!((goal.note_trip(), goal.note_trip()), (1, 2));
    }
}
