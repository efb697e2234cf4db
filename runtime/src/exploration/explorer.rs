//! A policy at work: chooses goals, plans ways, follows them, gives up, and says why.

use std::collections::VecDeque;

use hal::Pose2;
use rand_pcg::Pcg64Mcg;

use super::blacklist::{Blacklist, distance_m};
use super::blind::BlindPolicy;
use super::choose::{self, Candidate};
use super::config::{ExplorationConfig, PolicyKind};
use super::goal::Goal;
use super::navigator::Navigator;
use crate::event::{DropReason, Event, GoalReason, NoGoalReason};
use crate::mapping::{CellState, OccupancyGrid, SingleFrameMap};
use crate::planning::{
    ConfigError, Follower, FollowerConfig, NoPath, PlanConfig, Primitive, Progress,
};
use crate::snapshot::remembers;

/// Ticks of heuristic walking when there is no goal: one of its moves.
const FILL_IN_TICKS: u64 = 16;
/// Ticks between two notes of where the robot has been, and how many are kept: the last 100 s at 10 Hz.
const TRAIL_EVERY_TICKS: u64 = 10;
const TRAIL_LENGTH: usize = 100;
/// A frontier is still there while unknown floor meets free floor this near to its middle, metres.
const FRONTIER_REACH_M: f64 = 0.45;
/// Places drawn at random when nothing is left to explore; the one furthest from where the robot has been lately wins.
const REVISIT_DRAWS: usize = 16;

/// What the policy knows at one turn.
#[derive(Debug, Clone, Copy)]
pub struct Senses<'a> {
    /// The turn.
    pub tick: u64,
    /// Its time.
    pub time_ns: u64,
    /// `t_odom_base`.
    pub pose: Pose2,
    /// The map.
    pub map: &'a OccupancyGrid,
    /// The newest look at the world and an older one, each by itself.
    pub looks: Option<(&'a SingleFrameMap, &'a SingleFrameMap)>,
    /// The bumper has just backed off from something.
    pub bumped: bool,
}

/// A policy and its memory.
pub struct Explorer {
    kind: PolicyKind,
    config: ExplorationConfig,
    rng: Pcg64Mcg,
    /// The policy itself when it is blind; otherwise what fills in while there is no goal.
    blind: BlindPolicy,
    warm_up: BlindPolicy,
    mode: GoalReason,
    mode_since: u64,
    goal: Option<Goal>,
    navigator: Navigator,
    follower: Follower,
    blacklist: Blacklist,
    trail_m: VecDeque<[f64; 2]>,
    plan_at: u64,
    choose_at: u64,
}

impl Explorer {
    /// A policy that has seen nothing yet.
    ///
    /// # Errors
    /// When the planner's or the follower's configuration is out of range.
    pub fn new(
        kind: PolicyKind,
        config: ExplorationConfig,
        plan: &PlanConfig,
        follower: &FollowerConfig,
        rng: Pcg64Mcg,
    ) -> Result<Self, ConfigError> {
        let blind = match kind {
            PolicyKind::Random => BlindPolicy::Random,
            PolicyKind::Forward => BlindPolicy::Forward { turns_left: 0 },
            _ => BlindPolicy::Heuristic { queue: VecDeque::new() },
        };
        let mode = if kind == PolicyKind::Inconsistency {
            GoalReason::Inconsistency
        } else {
            GoalReason::Frontier
        };
        Ok(Self {
            kind,
            config,
            rng,
            blind,
            warm_up: BlindPolicy::Heuristic { queue: VecDeque::new() },
            mode,
            mode_since: config.warm_up_frames,
            goal: None,
            navigator: Navigator::new(plan)?,
            follower: Follower::new(follower)?,
            blacklist: Blacklist::default(),
            trail_m: VecDeque::with_capacity(TRAIL_LENGTH + 1),
            plan_at: 0,
            choose_at: 0,
        })
    }

    /// The current goal.
    #[must_use]
    pub fn goal(&self) -> Option<&Goal> {
        self.goal.as_ref()
    }

    /// The way to the goal, in `odom`, metres.
    #[must_use]
    pub fn path_m(&self) -> &[[f64; 2]] {
        self.follower.path_m()
    }

    /// The next step, and what happened on the way to it.
    pub fn step(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) -> Primitive {
        if senses.tick < self.config.warm_up_frames {
            return self.warm_up.next(&mut self.rng, senses.bumped);
        }
        match self.kind {
            PolicyKind::Random | PolicyKind::Heuristic | PolicyKind::Forward => {
                self.blind.next(&mut self.rng, senses.bumped)
            }
            _ => self.step_to_goal(senses, events),
        }
    }

    fn step_to_goal(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) -> Primitive {
        self.leave_trail(senses);
        self.blacklist.forgive(senses.time_ns);
        self.switch_mode(senses, events);
        self.judge_goal(senses, events);
        if self.goal.is_none() && senses.tick >= self.choose_at {
            self.choose_goal(senses, events);
        }
        if self.goal.is_some() && (senses.tick >= self.plan_at || senses.bumped) {
            self.plan(senses, events);
        }
        self.follow(senses, events).unwrap_or_else(|| self.blind.next(&mut self.rng, senses.bumped))
    }

    fn leave_trail(&mut self, senses: &Senses<'_>) {
        if senses.tick.is_multiple_of(TRAIL_EVERY_TICKS) {
            self.trail_m.push_back([senses.pose.x_m, senses.pose.y_m]);
            if self.trail_m.len() > TRAIL_LENGTH {
                self.trail_m.pop_front();
            }
        }
    }

    /// `active`: 800 frames of frontiers, 400 of inconsistencies, and again.
    fn switch_mode(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) {
        let budget = match (self.kind, self.mode) {
            (PolicyKind::Active, GoalReason::Frontier) => self.config.frontier_frames,
            (PolicyKind::Active, _) => self.config.inconsistency_frames,
            _ => return,
        };
        if senses.tick < self.mode_since + budget {
            return;
        }
        self.mode_since = senses.tick;
        self.mode = match self.mode {
            GoalReason::Frontier => GoalReason::Inconsistency,
            _ => GoalReason::Frontier,
        };
        events.push(Event::PolicySwitched { to: self.mode });
        if self.goal.is_some() {
            self.drop_goal(DropReason::PolicySwitched, senses, events);
        }
    }

    /// Gives up a goal that has been reached, seen, blocked or tried for too long.
    fn judge_goal(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) {
        let Some(goal) = &mut self.goal else { return };
        let now_ns = senses.time_ns;
        if distance_m(goal.target_m, [senses.pose.x_m, senses.pose.y_m])
            < self.config.goal_reached_m
        {
            self.goal_reached(senses, events);
            return;
        }
        let seconds = |time_ns: u64| time_ns as f64 * 1e-9;
        let why = if senses.bumped && goal.note_trip() >= self.config.trips_per_goal {
            DropReason::Blocked
        } else if seconds(goal.stalled_ns(now_ns)) > self.config.progress_timeout_s {
            DropReason::NoProgress
        } else if seconds(goal.age_ns(now_ns)) > self.config.goal_timeout_s {
            DropReason::Timeout
        } else if goal.is_frontier() && !frontier_is_left(senses.map, goal.interest_m) {
            DropReason::Resolved
        } else {
            return;
        };
        self.drop_goal(why, senses, events);
    }

    fn drop_goal(&mut self, why: DropReason, senses: &Senses<'_>, events: &mut Vec<Event>) {
        events.push(Event::GoalDropped { why });
        let Some(goal) = self.goal else { return };
        self.forget_goal();
        if !matches!(why, DropReason::Resolved | DropReason::PolicySwitched) {
            self.list(goal.interest_m, senses);
            self.list(goal.target_m, senses);
        }
    }

    fn forget_goal(&mut self) {
        self.goal = None;
        self.follower.clear();
    }

    fn list(&mut self, place_m: [f64; 2], senses: &Senses<'_>) {
        let expiry_ns = (self.config.blacklist_expiry_s * 1e9) as u64;
        self.blacklist.add(place_m, senses.time_ns + expiry_ns);
    }

    /// Looks for a goal: the mode's own first, then the other kind, then a frontier behind doubtful marks, then any place.
    fn choose_goal(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) {
        match self.best_goal(senses, events) {
            Some((target_m, interest_m, why)) => {
                events.push(Event::GoalChosen { x_m: target_m[0], y_m: target_m[1], why });
                self.goal = Some(Goal::new(target_m, interest_m, why, senses.time_ns));
                self.plan_at = senses.tick;
            }
            None => self.choose_at = senses.tick + FILL_IN_TICKS,
        }
    }

    fn best_goal(
        &mut self,
        senses: &Senses<'_>,
        events: &mut Vec<Event>,
    ) -> Option<([f64; 2], [f64; 2], GoalReason)> {
        let survey = match self.navigator.survey(senses.map, &senses.pose, 0.0) {
            Ok(survey) => survey,
            Err(_) => {
                events.push(Event::NoGoal { why: NoGoalReason::StartBlocked });
                return None;
            }
        };
        let kinds: &[GoalReason] = match (self.kind, self.mode) {
            (PolicyKind::Frontier, _) => &[GoalReason::Frontier],
            (_, GoalReason::Inconsistency) => &[GoalReason::Inconsistency, GoalReason::Frontier],
            _ => &[GoalReason::Frontier, GoalReason::Inconsistency],
        };
        for kind in kinds {
            let (candidates, none) = match (kind, senses.looks) {
                (GoalReason::Inconsistency, Some((new, old))) => {
                    let listed = |place: &Candidate| {
                        self.blacklist.holds(place.interest_m, self.config.blacklist_radius_m)
                    };
                    let reachable = |place: &Candidate| place.travel_m.is_some() && !listed(place);
                    // The largest one, not the nearest ("Embodied Depth Prediction", section III-D).
                    let largest = survey.inconsistencies(new, old).into_iter().find(reachable);
                    (largest.into_iter().collect(), NoGoalReason::NoInconsistency)
                }
                (GoalReason::Inconsistency, None) => (Vec::new(), NoGoalReason::NoInconsistency),
                _ => (survey.frontiers(), NoGoalReason::NoFrontier),
            };
            match choose::best(
                &candidates,
                &senses.pose,
                &self.blacklist,
                &self.config,
                &mut self.rng,
                none,
            ) {
                Ok(chosen) => return Some((chosen.target_m, chosen.interest_m, *kind)),
                Err(why) => events.push(Event::NoGoal { why }),
            }
        }
        let places = survey.random_places(REVISIT_DRAWS, senses.map, &mut self.rng);
        if let Some(again) = self.look_again(senses) {
            return Some((again.target_m, again.interest_m, GoalReason::LookAgain));
        }
        let place_m = choose::revisit(&places, &self.trail_m, &self.blacklist, &self.config)?;
        Some((place_m, place_m, GoalReason::Revisit))
    }

    /// A frontier that doubtful marks stand before.
    fn look_again(&mut self, senses: &Senses<'_>) -> Option<Candidate> {
        let doubt = self.config.doubtful_log_odds;
        let survey = self.navigator.survey(senses.map, &senses.pose, doubt).ok()?;
        let (candidates, none) = (survey.frontiers(), NoGoalReason::NoFrontier);
        choose::best(&candidates, &senses.pose, &self.blacklist, &self.config, &mut self.rng, none)
            .ok()
    }

    fn plan(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) {
        let Some(goal) = &mut self.goal else { return };
        self.plan_at = senses.tick + self.config.replan_ticks;
        let doubt =
            if goal.why == GoalReason::LookAgain { self.config.doubtful_log_odds } else { 0.0 };
        let way = self.navigator.plan(senses.map, &senses.pose, goal.target_m, doubt);
        match way
            .and_then(|path_m| self.follower.set_path(&path_m).map_err(|_| NoPath::Unreachable))
        {
            Ok(()) if senses.bumped => goal.note_new_way(),
            Ok(()) => {}
            Err(_) => self.drop_goal(DropReason::Unreachable, senses, events),
        }
    }

    /// The next step on the way; `None` when there is no way to follow.
    fn follow(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) -> Option<Primitive> {
        let goal = self.goal.as_mut()?;
        let step = self.follower.next(&senses.pose).ok()?;
        match step.progress {
            Progress::Following => {
                goal.note_distance(step.remaining_m, senses.time_ns);
                Some(step.primitive)
            }
            Progress::Reached => {
                self.goal_reached(senses, events);
                None
            }
            Progress::OffPath => {
                self.plan_at = senses.tick;
                Some(Primitive::Stay)
            }
        }
    }

    fn goal_reached(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) {
        events.push(Event::GoalReached);
        let Some(goal) = self.goal else { return };
        self.forget_goal();
        // What is still unknown there will not become known by standing in front of it: look elsewhere for a while.
        self.list(goal.interest_m, senses);
    }
}

/// Whether unknown floor still meets free floor near `place_m`.
fn frontier_is_left(map: &OccupancyGrid, place_m: [f64; 2]) -> bool {
    let steps = (FRONTIER_REACH_M / map.cell_m()).ceil() as i32;
    let middle = map.cell_at(place_m[0], place_m[1]);
    let known = |dx: i32, dy: i32| map.state(middle.offset(dx, dy));
    (-steps..=steps).any(|dy| {
        (-steps..=steps).any(|dx| {
            known(dx, dy) == CellState::Unknown
                && [(1, 0), (-1, 0), (0, 1), (0, -1)]
                    .iter()
                    .any(|(x, y)| known(dx + x, dy + y) == CellState::Free)
        })
    })
}

remembers!(
    Explorer: rng, blind, warm_up, mode, mode_since, goal, follower, blacklist, trail_m, plan_at, choose_at
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::MapConfig;
    use hal::{LaserScan, Range, ScanGeometry};
    use rand::SeedableRng;

    /// Looks around from the origin, both ways; `range_m` of a bearing.
    fn look_around(map: &mut OccupancyGrid, range_m: impl Fn(f64) -> f32) {
        let geometry = ScanGeometry::UTM_30LX;
        for yaw_rad in [0.0, std::f64::consts::PI] {
            let pose = Pose2 { x_m: 0.0, y_m: 0.0, yaw_rad };
            let ranges = (0..geometry.beams).map(|beam| {
                Range::Hit(range_m(hal::wrap_angle(yaw_rad + geometry.angle_rad(beam))))
            });
            map.begin_update(&pose).unwrap();
            map.integrate_scan(
                &LaserScan { time_ns: 0, geometry, ranges: ranges.collect() },
                &pose,
            )
            .unwrap();
            map.finish_update();
        }
    }

    /// A round room with a bay ahead that something was seen in front of, once.
    fn room_with_a_doubtful_bay() -> OccupancyGrid {
        let mut map = OccupancyGrid::new(&MapConfig::default()).unwrap();
        for _ in 0..10 {
            look_around(&mut map, |bearing| if bearing.abs() < 0.4 { 1.9 } else { 1.2 });
        }
        look_around(&mut map, |_| 1.2);
        map
    }

    fn first_goal(doubtful_log_odds: f32) -> GoalReason {
        let config = ExplorationConfig { doubtful_log_odds, ..ExplorationConfig::default() };
        let (plan, follow) = (PlanConfig::default(), FollowerConfig::default());
        let rng = Pcg64Mcg::seed_from_u64(1);
        let mut explorer =
            Explorer::new(PolicyKind::Frontier, config, &plan, &follow, rng).unwrap();
        let map = room_with_a_doubtful_bay();
        let senses = Senses {
            tick: 0,
            time_ns: 0,
            pose: Pose2::IDENTITY,
            map: &map,
            looks: None,
            bumped: false,
        };
        let mut events = Vec::new();
        explorer.step(&senses, &mut events);
        assert!(
            events.contains(&Event::NoGoal { why: NoGoalReason::AllUnreachable }),
            "{events:?}"
        );
        explorer.goal().unwrap().why
    }

    #[test]
    fn a_frontier_behind_doubtful_marks_is_looked_at_again_when_no_other_can_be_reached() {
        assert_eq!(first_goal(5.0), GoalReason::LookAgain);
    }

    #[test]
    fn who_never_doubts_goes_to_any_known_place_instead() {
        assert_eq!(first_goal(0.0), GoalReason::Revisit);
    }

    #[test]
    fn all_policies_begin_with_the_same_warm_up_and_then_part() {
        let config = ExplorationConfig { warm_up_frames: 64, ..ExplorationConfig::default() };
        let map = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let steps = |kind: PolicyKind| -> Vec<Primitive> {
            let (plan, follow) = (PlanConfig::default(), FollowerConfig::default());
            let mut explorer =
                Explorer::new(kind, config, &plan, &follow, Pcg64Mcg::seed_from_u64(4)).unwrap();
            let senses = Senses {
                tick: 0,
                time_ns: 0,
                pose: Pose2::IDENTITY,
                map: &map,
                looks: None,
                bumped: false,
            };
            (0..128)
                .map(|tick| explorer.step(&Senses { tick, ..senses }, &mut Vec::new()))
                .collect()
        };
        let heuristic = steps(PolicyKind::Heuristic);
        for kind in PolicyKind::ALL {
            assert_eq!(steps(kind)[..64], heuristic[..64], "{kind:?}");
        }
        assert_ne!(steps(PolicyKind::Random)[64..], heuristic[64..]);
        assert!(steps(PolicyKind::Forward)[64..].iter().all(|step| *step == Primitive::Forward));
    }
}
