//! Choice of the goal among the candidates.

use std::collections::VecDeque;

use rand::seq::IndexedRandom;
use rand_pcg::Pcg64Mcg;

use super::blacklist::{Blacklist, distance_m};
use super::config::{ExplorationConfig, GoalChoice};
use crate::event::NoGoalReason;
use hal::{Pose2, wrap_angle};

/// One metre of frontier makes up for this many metres of path.
const FRONTIER_BONUS: f64 = 0.5;
/// Frontier length beyond this does not count, metres.
const LONGEST_FRONTIER_M: f64 = 4.0;
/// This is added to the effort of each goal, metres of path, so that a few cells beside the robot are not worth more than a room. The
/// paths of five of six simulated drives were the same with 0.3, 1 and 2 m.
const SHORTEST_EFFORT_M: f64 = 1.0;
/// A rotation by one radian costs as much as this many metres of path: at 0.3 m/s and 40 degrees/s
/// it takes as long.
const ROTATION_COST_M: f64 = 0.43;

/// A place that the robot might choose as its goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    /// Where to drive: free floor in `odom`, metres.
    pub target_m: [f64; 2],
    /// The place to observe, in `odom`, metres.
    pub interest_m: [f64; 2],
    /// Length of the frontier, metres.
    pub size_m: f64,
    /// Unknown floor that might be seen from the frontier, square metres; 0 if there is no path.
    pub unseen_m2: f64,
    /// Length of the path to the target, metres; `None` if there is no path.
    pub travel_m: Option<f64>,
}

/// The best candidate that can be reached and is not on the blacklist.
///
/// # Errors
/// The reason why there is no such candidate; `none` if there are no candidates at all.
pub(super) fn select_best(
    candidates: &[Candidate],
    pose: &Pose2,
    blacklist: &Blacklist,
    config: &ExplorationConfig,
    rng: &mut Pcg64Mcg,
    none: NoGoalReason,
) -> Result<Candidate, NoGoalReason> {
    if candidates.is_empty() {
        return Err(none);
    }
    let allowed: Vec<&Candidate> = candidates
        .iter()
        .filter(|candidate| {
            !blacklist.is_listed(candidate.interest_m, config.blacklist_radius_m)
                && !blacklist.is_listed(candidate.target_m, config.blacklist_radius_m)
        })
        .collect();
    if allowed.is_empty() {
        return Err(NoGoalReason::AllBlacklisted);
    }
    let reachable: Vec<(Candidate, f64)> = allowed
        .into_iter()
        .filter_map(|candidate| Some((*candidate, candidate.travel_m?)))
        .collect();
    let chosen = match config.goal_choice {
        GoalChoice::Unseen => reachable
            .iter()
            .max_by(|a, b| unseen_per_m(&a.0, a.1, pose).total_cmp(&unseen_per_m(&b.0, b.1, pose)))
            .map(|(candidate, _)| *candidate),
        GoalChoice::Nearest => reachable
            .iter()
            .min_by(|a, b| cost_m(&a.0, a.1, pose).total_cmp(&cost_m(&b.0, b.1, pose)))
            .map(|(candidate, _)| *candidate),
        GoalChoice::Paper => reachable
            .choose_weighted(rng, |(_, travel_m)| *travel_m + 1e-3)
            .ok()
            .map(|(one, _)| *one),
    };
    chosen.ok_or(NoGoalReason::AllUnreachable)
}

/// Unknown floor that might be seen from a candidate, for every metre of path, m2/m.
fn unseen_per_m(candidate: &Candidate, travel_m: f64, pose: &Pose2) -> f64 {
    candidate.unseen_m2 / (effort_m(candidate, travel_m, pose) + SHORTEST_EFFORT_M)
}

/// Cost of a candidate in metres of path, minus the bonus for a long frontier.
fn cost_m(candidate: &Candidate, travel_m: f64, pose: &Pose2) -> f64 {
    effort_m(candidate, travel_m, pose) - FRONTIER_BONUS * candidate.size_m.min(LONGEST_FRONTIER_M)
}

/// Path length and initial rotation, in metres of path.
fn effort_m(candidate: &Candidate, travel_m: f64, pose: &Pose2) -> f64 {
    let bearing = (candidate.target_m[1] - pose.y_m).atan2(candidate.target_m[0] - pose.x_m);
    let rotation_rad = wrap_angle(bearing - pose.yaw_rad).abs();
    travel_m + ROTATION_COST_M * rotation_rad
}

/// Of the reachable places, the one that is farthest from the robot's recent positions and not on
/// the blacklist.
pub(super) fn select_revisit(
    places_m: &[[f64; 2]],
    recent_positions_m: &VecDeque<[f64; 2]>,
    blacklist: &Blacklist,
    config: &ExplorationConfig,
) -> Option<[f64; 2]> {
    places_m
        .iter()
        .copied()
        .filter(|place| !blacklist.is_listed(*place, config.blacklist_radius_m))
        .max_by(|a, b| {
            distance_from_all_m(recent_positions_m, *a)
                .total_cmp(&distance_from_all_m(recent_positions_m, *b))
        })
}

/// Distance of a place from the nearest of the positions, metres.
fn distance_from_all_m(positions_m: &VecDeque<[f64; 2]>, place_m: [f64; 2]) -> f64 {
    positions_m.iter().map(|position| distance_m(*position, place_m)).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn at(x_m: f64, size_m: f64, travel_m: Option<f64>) -> Candidate {
        let place_m = [x_m, 0.0];
        Candidate { target_m: place_m, interest_m: place_m, size_m, unseen_m2: 0.0, travel_m }
    }

    /// A frontier at this distance from which so much floor might be seen.
    fn before(x_m: f64, unseen_m2: f64) -> Candidate {
        Candidate { unseen_m2, ..at(x_m, 1.0, Some(x_m.abs())) }
    }

    fn choose(
        candidates: &[Candidate],
        blacklist: &Blacklist,
        goal_choice: GoalChoice,
    ) -> Result<f64, NoGoalReason> {
        let config = ExplorationConfig { goal_choice, ..ExplorationConfig::default() };
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        select_best(
            candidates,
            &Pose2::IDENTITY,
            blacklist,
            &config,
            &mut rng,
            NoGoalReason::NoFrontier,
        )
        .map(|c| c.target_m[0])
    }

    #[test]
    fn the_nearer_of_two_equal_frontiers_is_chosen_and_a_much_larger_one_is_worth_a_detour() {
        let none = Blacklist::default();
        let near = at(1.0, 0.6, Some(1.0));
        assert_eq!(choose(&[at(3.0, 0.6, Some(3.0)), near], &none, GoalChoice::Nearest), Ok(1.0));
        assert_eq!(choose(&[at(2.0, 4.0, Some(2.0)), near], &none, GoalChoice::Nearest), Ok(2.0));
    }

    #[test]
    fn of_two_equally_long_paths_the_one_ahead_is_chosen() {
        let none = Blacklist::default();
        let equal = [at(-1.0, 1.0, Some(1.0)), at(1.0, 1.0, Some(1.0))];
        assert_eq!(choose(&equal, &none, GoalChoice::Nearest), Ok(1.0));
        let equal = [before(-1.0, 3.0), before(1.0, 3.0)];
        assert_eq!(choose(&equal, &none, GoalChoice::Unseen), Ok(1.0));
    }

    #[test]
    fn the_frontier_that_shows_most_floor_for_each_metre_of_path_is_chosen() {
        let none = Blacklist::default();
        let corner = before(0.2, 0.3);
        let room = before(2.0, 5.0);
        assert_eq!(choose(&[corner, room], &none, GoalChoice::Unseen), Ok(2.0));
        let far_room = before(9.0, 5.0);
        assert_eq!(choose(&[far_room, room], &none, GoalChoice::Unseen), Ok(2.0));
        let near_room = before(1.0, 4.0);
        assert_eq!(choose(&[near_room, room], &none, GoalChoice::Unseen), Ok(1.0));
    }

    #[test]
    fn a_frontier_from_which_nothing_new_can_be_seen_is_still_a_goal() {
        let none = Blacklist::default();
        assert_eq!(choose(&[before(1.0, 0.0)], &none, GoalChoice::Unseen), Ok(1.0));
    }

    #[test]
    fn each_cause_of_having_no_goal_has_its_own_reason() {
        let mut list = Blacklist::default();
        assert_eq!(choose(&[], &list, GoalChoice::Nearest), Err(NoGoalReason::NoFrontier));
        assert_eq!(
            choose(&[at(1.0, 1.0, None)], &list, GoalChoice::Nearest),
            Err(NoGoalReason::AllUnreachable)
        );
        list.add([1.0, 0.0], 10);
        assert_eq!(
            choose(&[at(1.0, 1.0, Some(1.0))], &list, GoalChoice::Nearest),
            Err(NoGoalReason::AllBlacklisted)
        );
    }

    #[test]
    fn the_papers_choice_is_proportional_to_the_distance() {
        let candidates = [at(1.0, 1.0, Some(1.0)), at(3.0, 1.0, Some(3.0))];
        let config =
            ExplorationConfig { goal_choice: GoalChoice::Paper, ..ExplorationConfig::default() };
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let none = Blacklist::default();
        let far = (0..1000)
            .filter(|_| {
                select_best(
                    &candidates,
                    &Pose2::IDENTITY,
                    &none,
                    &config,
                    &mut rng,
                    NoGoalReason::NoFrontier,
                )
                .is_ok_and(|chosen| chosen.target_m[0] > 2.0)
            })
            .count();
        assert!((far as f64 / 1000.0 - 0.75).abs() < 0.05, "{far}");
    }

    #[test]
    fn a_revisit_goes_to_the_place_farthest_from_the_recent_positions() {
        let places: Vec<[f64; 2]> = (0..20).map(|i| [f64::from(i), 0.0]).collect();
        let config = ExplorationConfig::default();
        let mut list = Blacklist::default();
        let been = VecDeque::from([[0.0, 0.0], [1.0, 0.0]]);
        assert_eq!(select_revisit(&places, &been, &list, &config), Some([19.0, 0.0]));
        list.add([19.0, 0.0], 10);
        assert_eq!(select_revisit(&places, &been, &list, &config), Some([18.0, 0.0]));
        assert_eq!(select_revisit(&[], &been, &list, &config), None);
    }
}
