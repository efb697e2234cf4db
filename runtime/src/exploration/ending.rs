//! Whether all floor that can be reached has been seen.
//!
//! A frontier is *open* while it can be reached and the robot has tried it less than twice: a place behind glass stays unknown
//! however often the robot drives there. Behind a doubtful obstacle one try is enough: the robot went to see whether the obstacle
//! is there, and it was. Exploration has ended when no frontier was open in several choices of a goal in a row,
//! between which the robot drives elsewhere.

use serde::{Deserialize, Serialize};

use super::blacklist::distance_m;
use super::choose::Candidate;
use super::goal::Goal;
use crate::event::GoalReason;

/// Goals that ended near a frontier without resolving it, after which it is not tried again for this.
const TRIES: u32 = 2;
/// Choices of a goal without an open frontier.
const CHOICES: u32 = 3;

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Tried {
    /// The place to observe, and the place to drive to: one of them may shift while the robot sees parts of the frontier.
    places_m: [[f64; 2]; 2],
    times: u32,
}

impl Tried {
    fn is_at(&self, places_m: [[f64; 2]; 2], radius_m: f64) -> bool {
        let mut pairs = self.places_m.iter().zip(&places_m);
        pairs.any(|(mine, other)| distance_m(*mine, *other) < radius_m)
    }
}

/// What the robot remembers of the frontiers that it has tried.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Ending {
    tried: Vec<Tried>,
    choices: u32,
    has_ended: bool,
}

impl Ending {
    /// A goal at a frontier has ended, and the frontier is still there. Frontiers are the same if the places to observe, or those to
    /// drive to, are within `radius_m`.
    pub(super) fn tried(&mut self, goal: &Goal, radius_m: f64) {
        let times = if goal.why == GoalReason::LookAgain { TRIES } else { 1 };
        let places_m = [goal.interest_m, goal.target_m];
        match self.tried.iter_mut().find(|tried| tried.is_at(places_m, radius_m)) {
            Some(tried) => tried.times += times,
            None => self.tried.push(Tried { places_m, times }),
        }
    }

    /// Whether one of the frontiers is open.
    pub(super) fn any_open(&self, frontiers: &[Candidate], radius_m: f64) -> bool {
        let is_exhausted = |one: &Candidate| {
            let mut exhausted = self.tried.iter().filter(|tried| tried.times >= TRIES);
            exhausted.any(|tried| tried.is_at([one.interest_m, one.target_m], radius_m))
        };
        frontiers.iter().any(|one| one.travel_m.is_some() && !is_exhausted(one))
    }

    /// A goal is chosen while a frontier is open, or none is. True once, when exploration has ended.
    pub(super) fn update(&mut self, is_open: bool) -> bool {
        self.choices = if is_open { 0 } else { self.choices.saturating_add(1) };
        let ends = self.choices >= CHOICES && !self.has_ended;
        self.has_ended |= ends;
        ends
    }

    /// Whether exploration has ended.
    pub(super) fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Moves every place, after the map was corrected.
    pub(super) fn move_places(&mut self, moved: impl Fn([f64; 2]) -> [f64; 2]) {
        for tried in &mut self.tried {
            tried.places_m = tried.places_m.map(&moved);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frontier(x_m: f64, travel_m: Option<f64>) -> Candidate {
        Candidate { target_m: [x_m, 0.0], interest_m: [x_m, 0.0], size_m: 1.0, travel_m }
    }

    fn goal(x_m: f64, why: GoalReason) -> Goal {
        Goal::new([x_m, 0.0], [x_m, 0.0], why, 0)
    }

    #[test]
    fn a_frontier_behind_a_doubtful_obstacle_is_open_until_it_was_tried_once() {
        let mut ending = Ending::default();
        let near = frontier(1.0, Some(1.0));
        ending.tried(&goal(1.2, GoalReason::LookAgain), 0.5);
        assert!(!ending.any_open(&[near], 0.5));
        assert!(ending.any_open(&[near, frontier(2.0, Some(2.0))], 0.5));
    }

    #[test]
    fn a_frontier_whose_centroid_has_moved_is_known_by_the_place_to_drive_to() {
        let mut ending = Ending::default();
        ending.tried(&goal(1.0, GoalReason::LookAgain), 0.5);
        let moved = Candidate { interest_m: [1.9, 0.0], ..frontier(1.2, Some(1.0)) };
        assert!(!ending.any_open(&[moved], 0.5));
    }

    #[test]
    fn a_frontier_is_open_until_it_was_tried_twice_and_if_it_can_be_reached() {
        let mut ending = Ending::default();
        let near = frontier(1.0, Some(1.0));
        assert!(ending.any_open(&[near], 0.5));
        ending.tried(&goal(1.2, GoalReason::Frontier), 0.5);
        assert!(ending.any_open(&[near], 0.5));
        ending.tried(&goal(0.9, GoalReason::Frontier), 0.5);
        assert!(!ending.any_open(&[near], 0.5));
        assert!(!ending.any_open(&[near, frontier(5.0, None)], 0.5));
        assert!(ending.any_open(&[near, frontier(5.0, Some(9.0))], 0.5));
    }

    #[test]
    fn exploration_ends_once_after_three_choices_in_a_row_without_an_open_frontier() {
        let mut ending = Ending::default();
        let ends: Vec<bool> =
            [false, false, true, false, false, false, false].map(|open| ending.update(open)).into();
        assert_eq!(ends, [false, false, false, false, false, true, false]);
        assert!(ending.has_ended());
    }
}
