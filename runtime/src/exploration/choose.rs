//! Which of many places to go to.

use std::collections::VecDeque;

use rand::seq::IndexedRandom;
use rand_pcg::Pcg64Mcg;

use super::blacklist::{Blacklist, distance_m};
use super::config::{ExplorationConfig, GoalChoice};
use crate::event::NoGoalReason;
use hal::{Pose2, wrap_angle};

/// How many metres of way one metre of frontier is worth.
const FRONTIER_WORTH: f64 = 0.5;
/// A frontier is not worth more for being longer than this, metres.
const LONGEST_FRONTIER_M: f64 = 4.0;
/// How many metres of way a turn by one radian is worth: at 0.3 m/s and 20 degrees/s, a radian takes as long as 0.86 m.
const TURN_WORTH_M: f64 = 0.86;

/// A place that the robot could go to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    /// Free floor to drive to, in `odom`, metres.
    pub target_m: [f64; 2],
    /// What there is to see, in `odom`, metres.
    pub interest_m: [f64; 2],
    /// Its size, metres of frontier.
    pub size_m: f64,
    /// Length of the way there, metres; `None`: no way.
    pub travel_m: Option<f64>,
}

/// The best of the candidates that have a way and are not on the blacklist.
///
/// # Errors
/// Why there is none; `none` when there are no candidates at all.
pub(super) fn best(
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
    let allowed = |candidate: &&Candidate| {
        !blacklist.holds(candidate.interest_m, config.blacklist_radius_m)
            && !blacklist.holds(candidate.target_m, config.blacklist_radius_m)
    };
    let listed = candidates.iter().filter(allowed).count();
    if listed == 0 {
        return Err(NoGoalReason::AllBlacklisted);
    }
    let ways: Vec<(Candidate, f64)> = candidates
        .iter()
        .filter(allowed)
        .filter_map(|candidate| Some((*candidate, candidate.travel_m?)))
        .collect();
    let chosen = match config.goal_choice {
        GoalChoice::Nearest => ways
            .iter()
            .min_by(|a, b| cost(&a.0, a.1, pose).total_cmp(&cost(&b.0, b.1, pose)))
            .map(|(candidate, _)| *candidate),
        GoalChoice::Paper => {
            ways.choose_weighted(rng, |(_, travel_m)| *travel_m + 1e-3).ok().map(|(one, _)| *one)
        }
    };
    chosen.ok_or(NoGoalReason::AllUnreachable)
}

fn cost(candidate: &Candidate, travel_m: f64, pose: &Pose2) -> f64 {
    let bearing = (candidate.target_m[1] - pose.y_m).atan2(candidate.target_m[0] - pose.x_m);
    let turn_rad = wrap_angle(bearing - pose.yaw_rad).abs();
    travel_m + TURN_WORTH_M * turn_rad - FRONTIER_WORTH * candidate.size_m.min(LONGEST_FRONTIER_M)
}

/// Of some reachable places, the one to look at again: furthest from where the robot has been lately.
pub(super) fn revisit(
    places_m: &[[f64; 2]],
    recent_m: &VecDeque<[f64; 2]>,
    blacklist: &Blacklist,
    config: &ExplorationConfig,
) -> Option<[f64; 2]> {
    let far_from_recent = |place: [f64; 2]| {
        recent_m.iter().map(|been| distance_m(*been, place)).fold(f64::INFINITY, f64::min)
    };
    places_m
        .iter()
        .copied()
        .filter(|place| !blacklist.holds(*place, config.blacklist_radius_m))
        .max_by(|a, b| far_from_recent(*a).total_cmp(&far_from_recent(*b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn at(x_m: f64, size_m: f64, travel_m: Option<f64>) -> Candidate {
        Candidate { target_m: [x_m, 0.0], interest_m: [x_m, 0.0], size_m, travel_m }
    }

    fn choose(
        candidates: &[Candidate],
        blacklist: &Blacklist,
        goal_choice: GoalChoice,
    ) -> Result<f64, NoGoalReason> {
        let config = ExplorationConfig { goal_choice, ..ExplorationConfig::default() };
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        best(candidates, &Pose2::IDENTITY, blacklist, &config, &mut rng, NoGoalReason::NoFrontier)
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
    fn of_two_equal_ways_the_one_ahead_is_chosen() {
        let none = Blacklist::default();
        assert_eq!(
            choose(
                &[at(-1.0, 1.0, Some(1.0)), at(1.0, 1.0, Some(1.0))],
                &none,
                GoalChoice::Nearest
            ),
            Ok(1.0)
        );
    }

    #[test]
    fn every_way_of_having_no_goal_has_its_reason() {
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
    fn the_papers_choice_prefers_far_frontiers_in_proportion() {
        let candidates = [at(1.0, 1.0, Some(1.0)), at(3.0, 1.0, Some(3.0))];
        let config =
            ExplorationConfig { goal_choice: GoalChoice::Paper, ..ExplorationConfig::default() };
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let none = Blacklist::default();
        let far = (0..1000)
            .filter(|_| {
                best(
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
    fn a_revisit_goes_where_the_robot_has_not_been_lately() {
        let places: Vec<[f64; 2]> = (0..20).map(|i| [f64::from(i), 0.0]).collect();
        let config = ExplorationConfig::default();
        let mut list = Blacklist::default();
        let been = VecDeque::from([[0.0, 0.0], [1.0, 0.0]]);
        assert_eq!(revisit(&places, &been, &list, &config), Some([19.0, 0.0]));
        list.add([19.0, 0.0], 10);
        assert_eq!(revisit(&places, &been, &list, &config), Some([18.0, 0.0]));
        assert_eq!(revisit(&[], &been, &list, &config), None);
    }
}
