//! Whether all floor that can be reached has been seen.
//!
//! A frontier is *open* while it can be reached and the robot has tried it less than twice: a place behind glass stays unknown
//! however often the robot drives there. Exploration has ended when no frontier was open in several choices of a goal in a row,
//! between which the robot drives elsewhere.

use serde::{Deserialize, Serialize};

use super::blacklist::distance_m;
use super::choose::Candidate;

/// Goals that ended near a frontier without resolving it, after which it is not tried again for this.
const TRIES: u32 = 2;
/// Choices of a goal without an open frontier.
const CHOICES: u32 = 3;

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Tried {
    place_m: [f64; 2],
    times: u32,
}

/// What the robot remembers of the frontiers that it has tried.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Ending {
    tried: Vec<Tried>,
    choices: u32,
    has_ended: bool,
}

impl Ending {
    /// A goal at this frontier has ended, and the frontier is still there. Frontiers within `radius_m` are the same.
    pub(super) fn tried(&mut self, place_m: [f64; 2], radius_m: f64) {
        match self.tried.iter_mut().find(|tried| distance_m(tried.place_m, place_m) < radius_m) {
            Some(tried) => tried.times += 1,
            None => self.tried.push(Tried { place_m, times: 1 }),
        }
    }

    /// Whether one of the frontiers is open.
    pub(super) fn any_open(&self, frontiers: &[Candidate], radius_m: f64) -> bool {
        let is_exhausted = |place_m: [f64; 2]| {
            let mut near = self.tried.iter().filter(|tried| tried.times >= TRIES);
            near.any(|tried| distance_m(tried.place_m, place_m) < radius_m)
        };
        frontiers.iter().any(|one| one.travel_m.is_some() && !is_exhausted(one.interest_m))
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
            tried.place_m = moved(tried.place_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frontier(x_m: f64, travel_m: Option<f64>) -> Candidate {
        Candidate { target_m: [x_m, 0.0], interest_m: [x_m, 0.0], size_m: 1.0, travel_m }
    }

    #[test]
    fn a_frontier_is_open_until_it_was_tried_twice_and_if_it_can_be_reached() {
        let mut ending = Ending::default();
        let near = frontier(1.0, Some(1.0));
        assert!(ending.any_open(&[near], 0.5));
        ending.tried([1.2, 0.0], 0.5);
        assert!(ending.any_open(&[near], 0.5));
        ending.tried([0.9, 0.0], 0.5);
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
