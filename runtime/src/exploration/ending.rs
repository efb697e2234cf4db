//! Whether all floor that can be reached has been seen.
//!
//! A frontier is *open* while it can be reached and the robot has tried it less than twice: a place behind glass stays unknown
//! however often the robot drives there. Behind a doubtful obstacle one try is enough: the robot went to see whether the obstacle
//! is there, and it was. Exploration has ended when no frontier was open in several choices of a goal in a row, between which the
//! robot drives elsewhere; or when many goals in a row have added no floor to the map, because frontiers on windows and on noise
//! come back in other places.

use serde::{Deserialize, Serialize};

use super::blacklist::distance_m;
use super::choose::Candidate;
use super::goal::Goal;
use crate::event::GoalReason;

/// Goals that ended near a frontier without resolving it, after which it is not tried again for this.
const TRIES: u32 = 2;
/// Choices of a goal without an open frontier.
const CHOICES: u32 = 3;
/// Goals that add less floor than this, all together, are in vain, square metres: one cell of a frontier and its neighbours.
const GAIN_M2: f64 = 0.25;
/// Goals in vain, and their time, after which exploration has ended: more than one round of the `active` policy, so that it
/// tried frontiers too.
const IN_VAIN: u32 = 8;
const IN_VAIN_NS: u64 = 180_000_000_000;

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
    in_vain: InVain,
    has_ended: bool,
}

/// Goals since the floor in the map last grew.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct InVain {
    floor_m2: f64,
    since_ns: u64,
    goals: u32,
}

impl InVain {
    /// A goal is chosen. Returns whether enough of them were in vain.
    fn update(&mut self, floor_m2: f64, now_ns: u64) -> bool {
        // Cells that were free may become occupied: less floor is not growth to come.
        if floor_m2 > self.floor_m2 + GAIN_M2 {
            *self = Self { floor_m2, since_ns: now_ns, goals: 0 };
        }
        self.goals = self.goals.saturating_add(1);
        self.goals > IN_VAIN && now_ns.saturating_sub(self.since_ns) >= IN_VAIN_NS
    }
}

impl Ending {
    /// A goal at a frontier has ended, and the frontier is still there. Frontiers are the same if the places to observe, or those to
    /// drive to, are within `radius_m`.
    pub(super) fn tried(&mut self, goal: &Goal, radius_m: f64) {
        let times = if goal.why == GoalReason::DoubtfulFrontier { TRIES } else { 1 };
        let places_m = [goal.interest_m, goal.target_m];
        match self.tried.iter_mut().find(|tried| tried.is_at(places_m, radius_m)) {
            Some(tried) => tried.times += times,
            None => self.tried.push(Tried { places_m, times }),
        }
    }

    /// Whether one of the frontiers is open.
    pub(super) fn any_open(&self, frontiers: &[Candidate], radius_m: f64) -> bool {
        frontiers.iter().any(|one| one.travel_m.is_some() && !self.is_exhausted(one, radius_m))
    }

    fn is_exhausted(&self, one: &Candidate, radius_m: f64) -> bool {
        let mut exhausted = self.tried.iter().filter(|tried| tried.times >= TRIES);
        exhausted.any(|tried| tried.is_at([one.interest_m, one.target_m], radius_m))
    }

    /// A goal is chosen at `now_ns` while a frontier is open, or none is, and the map has this much free floor. True once, when
    /// exploration has ended.
    pub(super) fn update(&mut self, is_open: bool, floor_m2: f64, now_ns: u64) -> bool {
        self.choices = if is_open { 0 } else { self.choices.saturating_add(1) };
        let is_in_vain = self.in_vain.update(floor_m2, now_ns);
        let ends = (self.choices >= CHOICES || is_in_vain) && !self.has_ended;
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
        Candidate {
            target_m: [x_m, 0.0],
            interest_m: [x_m, 0.0],
            size_m: 1.0,
            unseen_m2: 1.0,
            travel_m,
        }
    }

    fn goal(x_m: f64, why: GoalReason) -> Goal {
        Goal::new([x_m, 0.0], [x_m, 0.0], why, 0)
    }

    #[test]
    fn a_frontier_behind_a_doubtful_obstacle_is_open_until_it_was_tried_once() {
        let mut ending = Ending::default();
        let near = frontier(1.0, Some(1.0));
        ending.tried(&goal(1.2, GoalReason::DoubtfulFrontier), 0.5);
        assert!(!ending.any_open(&[near], 0.5));
        assert!(ending.any_open(&[near, frontier(2.0, Some(2.0))], 0.5));
    }

    #[test]
    fn a_frontier_whose_centroid_has_moved_is_known_by_the_place_to_drive_to() {
        let mut ending = Ending::default();
        ending.tried(&goal(1.0, GoalReason::DoubtfulFrontier), 0.5);
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
        let ends: Vec<bool> = [false, false, true, false, false, false, false]
            .map(|open| ending.update(open, 0.0, 0))
            .into();
        assert_eq!(ends, [false, false, false, false, false, true, false]);
        assert!(ending.has_ended());
    }

    #[test]
    fn exploration_ends_when_goals_of_three_minutes_have_added_no_floor() {
        const GOAL_NS: u64 = 30_000_000_000;
        let mut ending = Ending::default();
        for goal in 0..20_u32 {
            assert!(!ending.update(true, f64::from(goal), u64::from(goal) * GOAL_NS));
        }
        let ends = (20..40).find(|goal| ending.update(true, 19.2, goal * GOAL_NS));
        // The 19th goal was the last that added floor.
        assert_eq!(ends, Some(19 + 8));
    }

    #[test]
    fn goals_in_vain_of_less_than_three_minutes_are_no_end_such_as_behind_a_person() {
        let mut ending = Ending::default();
        assert!((0..100).all(|goal| !ending.update(true, 5.0, goal * 1_000_000_000)));
    }
}
