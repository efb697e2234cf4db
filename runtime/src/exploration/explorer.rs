//! The exploration policy: chooses goals, plans and follows paths, gives goals up, and reports each
//! decision as an event.

use std::collections::VecDeque;

use hal::{Pose2, Twist2};
use rand_pcg::Pcg64Mcg;

use super::blacklist::{Blacklist, distance_m};
use super::blind::BlindPolicy;
use super::choose::{self, Candidate};
use super::config::{ExplorationConfig, PolicyKind};
use super::ending::Ending;
use super::errand::{Errand, Means, moved_pose};
use super::goal::Goal;
use super::navigator::{FRONTIER_RADIUS_M, Navigator};
use super::observations::Observations;
use super::pattern::Pattern;
use crate::event::{DropReason, Event, GoalReason, NoGoalReason};
use crate::mapping::{CellState, OccupancyGrid};
use crate::planning::{
    ConfigError, Follower, FollowerConfig, KeepOut, PlanConfig, Primitive, Progress,
};
use crate::snapshot::remembers;
use crate::task::{AreaChange, HOLD_NS, Task};
use crate::tick::Command;

/// Ticks until the next attempt to choose a goal when there is none: one move of the heuristic
/// policy, which drives meanwhile.
const RETRY_TICKS: u64 = 16;
/// Ticks between two recorded positions, and the number of positions kept: the last 100 s at 10 Hz.
const POSITION_EVERY_TICKS: u64 = 10;
const POSITION_COUNT: usize = 100;
/// Number of places drawn at random when nothing is left to explore; the one farthest from the
/// robot's recent positions is chosen.
const REVISIT_DRAWS: usize = 16;

/// An exploration policy with its state: the current goal, path and blacklist.
pub struct Explorer {
    kind: PolicyKind,
    config: ExplorationConfig,
    rng: Pcg64Mcg,
    /// The policy itself if it is a blind one; otherwise the policy that drives while there is no
    /// goal.
    blind: BlindPolicy,
    warm_up: BlindPolicy,
    mode: GoalReason,
    mode_since: u64,
    goal: Option<Goal>,
    navigator: Navigator,
    follower: Follower,
    blacklist: Blacklist,
    recent_positions_m: VecDeque<[f64; 2]>,
    plan_at: u64,
    choose_at: u64,
    /// Where the robot was when it first decided, in `map`.
    start: Option<Pose2>,
    ending: Ending,
    /// While there is one, the policy waits.
    errand: Option<Errand>,
}

impl Explorer {
    /// A policy without a goal.
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
        Ok(Self {
            kind,
            config,
            rng,
            blind: blind_part(kind),
            warm_up: BlindPolicy::Heuristic { queue: VecDeque::new() },
            mode: first_mode(kind),
            mode_since: config.warm_up_frames,
            goal: None,
            navigator: Navigator::new(plan)?,
            follower: Follower::new(follower)?,
            blacklist: Blacklist::default(),
            recent_positions_m: VecDeque::with_capacity(POSITION_COUNT + 1),
            plan_at: 0,
            choose_at: 0,
            start: None,
            ending: Ending::default(),
            errand: None,
        })
    }

    #[must_use]
    pub fn goal(&self) -> Option<&Goal> {
        self.errand.as_ref().map_or(self.goal.as_ref(), Errand::goal)
    }

    /// Whether exploration has ended and the robot has nothing left to do: it has seen all floor that it can reach, and stands at
    /// its start if it was to return.
    #[must_use]
    pub fn is_done(&self) -> bool {
        let returned = self.errand.as_ref().is_some_and(Errand::has_returned);
        self.ending.has_ended() && (returned || !self.config.return_to_start)
    }

    /// Whether the robot stands because of a task: it is where it was sent to, has given up getting there, or was paused.
    #[must_use]
    pub fn stands(&self) -> bool {
        self.errand.as_ref().is_some_and(Errand::is_standing)
    }

    /// The policy by which the robot explores.
    #[must_use]
    pub fn policy(&self) -> PolicyKind {
        self.kind
    }

    /// Takes a task of the operator in this tick, in place of the one before.
    pub fn begin(&mut self, task: Task, tick: u64, time_ns: u64, events: &mut Vec<Event>) {
        if self.goal().is_some() {
            events.push(Event::GoalDropped { why: DropReason::Task });
        }
        self.forget_goal();
        self.choose_at = 0;
        self.errand = match task {
            Task::Explore => self.return_after_exploration(),
            Task::ExploreBy { policy } => {
                self.kind = policy;
                self.blind = blind_part(policy);
                self.mode = first_mode(policy);
                self.mode_since = tick.max(self.config.warm_up_frames);
                self.return_after_exploration()
            }
            Task::GoTo { x_m, y_m } => Some(Errand::to_place([x_m, y_m])),
            // Before its first decision the robot is at its start.
            Task::Pause => Some(Errand::HERE),
            Task::Return => Some(self.start.as_ref().map_or(Errand::HERE, Errand::back_to)),
            Task::Drive { linear_mps, angular_radps } => {
                let command = Command { linear_mps, angular_radps };
                Some(Errand::by_hand(command, time_ns.saturating_add(HOLD_NS)))
            }
        };
    }

    /// Closes or opens areas, and plans a new path with the next step.
    pub fn change_areas(&mut self, change: AreaChange) {
        self.navigator.change_areas(change);
        self.move_places(|place_m| place_m);
    }

    /// The areas that the robot keeps out of.
    #[must_use]
    pub fn keep_out(&self) -> &KeepOut {
        self.navigator.keep_out()
    }

    /// Whether a person drives the robot by hand.
    #[must_use]
    pub fn is_driven_by_hand(&self) -> bool {
        self.errand.as_ref().is_some_and(Errand::is_by_hand)
    }

    /// The velocity at which a person drives the robot by hand; `None` if no person does at `time_ns`.
    pub fn hand_velocity(&mut self, time_ns: u64) -> Option<Twist2> {
        self.errand.as_mut().and_then(|errand| errand.hand_velocity(time_ns))
    }

    /// The drive back to the start, if exploration has ended and the robot is to return then.
    fn return_after_exploration(&self) -> Option<Errand> {
        let returns = self.ending.has_ended() && self.config.return_to_start;
        self.start.as_ref().filter(|_| returns).map(Errand::back_to)
    }

    /// The path to the goal as corner points in `odom`, metres.
    #[must_use]
    pub fn path_m(&self) -> &[[f64; 2]] {
        self.follower.path_m()
    }

    /// Decides the next motion primitive and appends what happened to `events`.
    pub fn step(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) -> Primitive {
        self.start.get_or_insert(senses.pose);
        if self.errand.is_some() {
            return self.step_errand(senses, events);
        }
        if self.is_warming_up(senses) || !self.kind.plans_paths() {
            return self.step_without_path(senses);
        }
        self.step_to_goal(senses, events)
    }

    /// Applies the correction of the map, `moved`, to the goal, the blacklist and the recorded positions. The next
    /// tick plans a new path.
    pub fn move_places(&mut self, moved: impl Fn([f64; 2]) -> [f64; 2]) {
        if let Some(goal) = &mut self.goal {
            goal.target_m = moved(goal.target_m);
            goal.interest_m = moved(goal.interest_m);
        }
        if let Some(errand) = &mut self.errand {
            errand.move_places(&moved);
        }
        self.start = self.start.map(|start| moved_pose(&start, &moved));
        self.ending.move_places(&moved);
        self.blacklist.move_places(&moved);
        for place_m in &mut self.recent_positions_m {
            *place_m = moved(*place_m);
        }
        self.follower.clear();
        self.plan_at = 0;
    }

    /// The robot is in another map from now on, in which places of the one before mean nothing. A drive to such a place ends. Exploration of
    /// this map began at `start`, or begins where the robot is now. Returns where that of the map before began.
    pub fn enter_map(&mut self, start: Option<Pose2>, events: &mut Vec<Event>) -> Option<Pose2> {
        if self.goal().is_some() {
            events.push(Event::GoalDropped { why: DropReason::Unreachable });
        }
        self.forget_goal();
        if self.errand.as_ref().is_some_and(|errand| !errand.is_by_hand()) {
            self.errand = Some(Errand::HERE);
        }
        self.blacklist = Blacklist::default();
        self.recent_positions_m.clear();
        self.ending = Ending::default();
        self.plan_at = 0;
        self.choose_at = 0;
        std::mem::replace(&mut self.start, start)
    }

    /// The map has become a part of another, where exploration began at `start`, if it is known.
    pub fn begin_at(&mut self, start: Option<Pose2>) {
        self.start = start.or(self.start);
    }

    /// Whether the policy chooses where the robot goes: no operator has given it another task, and it does not return to its start.
    #[must_use]
    pub fn is_exploring(&self) -> bool {
        self.errand.is_none()
    }

    fn step_errand(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) -> Primitive {
        let Some(errand) = &mut self.errand else { return Primitive::Stay };
        let mut means = Means {
            navigator: &mut self.navigator,
            follower: &mut self.follower,
            config: &self.config,
        };
        errand.step(senses, &mut means, events)
    }

    fn step_to_goal(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) -> Primitive {
        self.record_position(senses);
        self.blacklist.expire(senses.time_ns);
        self.update_mode(senses, events);
        self.check_goal(senses, events);
        if self.goal.is_none() && senses.tick >= self.choose_at {
            self.choose_goal(senses, events);
        }
        if self.errand.is_some() {
            return self.step_errand(senses, events);
        }
        if self.goal.is_some() && (senses.tick >= self.plan_at || senses.bumped) {
            self.plan(senses, events);
        }
        self.follow(senses, events).unwrap_or_else(|| self.step_without_path(senses))
    }

    fn is_warming_up(&self, senses: &Observations<'_>) -> bool {
        self.kind != PolicyKind::Calibration && senses.tick < self.config.warm_up_frames
    }

    /// Drives on blindly to observe more. With closed areas, which it might enter, it only rotates.
    fn step_without_path(&mut self, senses: &Observations<'_>) -> Primitive {
        if !self.navigator.keep_out().is_empty() {
            return Primitive::TurnLeft;
        }
        let policy = if self.is_warming_up(senses) { &mut self.warm_up } else { &mut self.blind };
        policy.next(&mut self.rng, &senses.pose, senses.bumped)
    }

    fn record_position(&mut self, senses: &Observations<'_>) {
        if senses.tick.is_multiple_of(POSITION_EVERY_TICKS) {
            self.recent_positions_m.push_back([senses.pose.x_m, senses.pose.y_m]);
            if self.recent_positions_m.len() > POSITION_COUNT {
                self.recent_positions_m.pop_front();
            }
        }
    }

    /// The `active` policy alternates: by default 800 frames of frontiers, then 400 frames of
    /// inconsistencies.
    fn update_mode(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) {
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

    /// Ends a goal that was reached, has become resolved or blocked, or has taken too long.
    fn check_goal(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) {
        let Some(goal) = &mut self.goal else { return };
        if distance_m(goal.target_m, [senses.pose.x_m, senses.pose.y_m])
            < self.config.goal_reached_m
        {
            self.goal_reached(senses, events);
            return;
        }
        let why = if let Some(why) = goal.why_to_drop(&self.config, senses) {
            why
        } else if goal.is_frontier() && !frontier_is_left(senses.map, goal.interest_m) {
            DropReason::Resolved
        } else {
            return;
        };
        self.drop_goal(why, senses, events);
    }

    fn drop_goal(&mut self, why: DropReason, senses: &Observations<'_>, events: &mut Vec<Event>) {
        events.push(Event::GoalDropped { why });
        let Some(goal) = self.goal else { return };
        self.forget_goal();
        // A switch of the policy ends goals that the robot may have tried for long without progress.
        let stalled_s = goal.stalled_ns(senses.time_ns) as f64 * 1e-9;
        let was_cut_short =
            why == DropReason::PolicySwitched && stalled_s < 0.5 * self.config.progress_timeout_s;
        if why != DropReason::Resolved && !was_cut_short {
            self.note_tried(&goal);
        }
        if !matches!(why, DropReason::Resolved | DropReason::PolicySwitched) {
            self.blacklist_place(goal.interest_m, senses);
            self.blacklist_place(goal.target_m, senses);
        }
    }

    fn forget_goal(&mut self) {
        self.goal = None;
        self.follower.clear();
    }

    /// Remembers that a goal ended before its frontier was resolved.
    fn note_tried(&mut self, goal: &Goal) {
        if goal.is_frontier() {
            self.ending.tried(goal, self.config.blacklist_radius_m);
        }
    }

    fn blacklist_place(&mut self, place_m: [f64; 2], senses: &Observations<'_>) {
        let expiry_ns = (self.config.blacklist_expiry_s * 1e9) as u64;
        self.blacklist.add(place_m, senses.time_ns + expiry_ns);
    }

    /// Chooses a goal: of the mode's own kind first, then of the other kind, then a frontier behind
    /// doubtful obstacles, then any reachable place.
    fn choose_goal(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) {
        let mut is_open = true;
        let selected = self.select_goal(senses, events, &mut is_open);
        is_open = is_open || self.any_doubtful_frontier_is_open(senses);
        let floor_m2 = senses.map.free_m2();
        if self.ending.update(is_open, floor_m2, senses.time_ns) {
            events.push(Event::Explored);
            self.errand = self.return_after_exploration();
            if self.errand.is_some() {
                return;
            }
        }
        match selected {
            Some((target_m, interest_m, why)) => {
                events.push(Event::GoalChosen { x_m: target_m[0], y_m: target_m[1], why });
                self.goal = Some(Goal::new(target_m, interest_m, why, senses.time_ns));
                self.plan_at = senses.tick;
            }
            None => self.choose_at = senses.tick + RETRY_TICKS,
        }
    }

    /// Sets `is_open` to whether a frontier is left that the robot has not tried often enough.
    fn select_goal(
        &mut self,
        senses: &Observations<'_>,
        events: &mut Vec<Event>,
        is_open: &mut bool,
    ) -> Option<([f64; 2], [f64; 2], GoalReason)> {
        let survey = match self.navigator.survey(senses.map, &senses.pose, 0.0) {
            Ok(survey) => survey,
            Err(_) => {
                events.push(Event::NoGoal { why: NoGoalReason::StartBlocked });
                return None;
            }
        };
        let radius_m = self.config.blacklist_radius_m;
        let frontiers = survey.frontiers();
        *is_open = self.ending.any_open(&frontiers, radius_m);
        let kinds: &[GoalReason] = match (self.kind, self.mode) {
            (PolicyKind::Frontier, _) => &[GoalReason::Frontier],
            (_, GoalReason::Inconsistency) => &[GoalReason::Inconsistency, GoalReason::Frontier],
            _ => &[GoalReason::Frontier, GoalReason::Inconsistency],
        };
        for kind in kinds {
            let (candidates, none) = match (kind, senses.frame_maps) {
                (GoalReason::Inconsistency, Some((new, old))) => {
                    // The largest one, not the nearest ("Embodied Depth Prediction", section
                    // III-D).
                    let largest = survey.inconsistencies(new, old).into_iter().find(|place| {
                        let radius_m = self.config.blacklist_radius_m;
                        place.travel_m.is_some()
                            && !self.blacklist.is_listed(place.interest_m, radius_m)
                    });
                    (largest.into_iter().collect(), NoGoalReason::NoInconsistency)
                }
                (GoalReason::Inconsistency, None) => (Vec::new(), NoGoalReason::NoInconsistency),
                _ => (frontiers.clone(), NoGoalReason::NoFrontier),
            };
            match choose::select_best(
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
        if let Some(again) = self.select_doubtful_frontier(senses) {
            return Some((again.target_m, again.interest_m, GoalReason::DoubtfulFrontier));
        }
        let place_m = choose::select_revisit(
            &places,
            &self.recent_positions_m,
            &self.blacklist,
            &self.config,
        )?;
        Some((place_m, place_m, GoalReason::Revisit))
    }

    /// The best frontier that can be reached when doubtful obstacles count as unknown floor.
    fn select_doubtful_frontier(&mut self, senses: &Observations<'_>) -> Option<Candidate> {
        let doubtful_log_odds = self.config.doubtful_log_odds;
        let survey = self.navigator.survey(senses.map, &senses.pose, doubtful_log_odds).ok()?;
        choose::select_best(
            &survey.frontiers(),
            &senses.pose,
            &self.blacklist,
            &self.config,
            &mut self.rng,
            NoGoalReason::NoFrontier,
        )
        .ok()
    }

    /// Whether a frontier can be reached when doubtful obstacles count as unknown floor, and was not tried often enough.
    fn any_doubtful_frontier_is_open(&mut self, senses: &Observations<'_>) -> bool {
        let doubtful_log_odds = self.config.doubtful_log_odds;
        let survey = self.navigator.survey(senses.map, &senses.pose, doubtful_log_odds);
        let radius_m = self.config.blacklist_radius_m;
        survey.is_ok_and(|survey| self.ending.any_open(&survey.frontiers(), radius_m))
    }

    fn plan(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) {
        let Some(goal) = &mut self.goal else { return };
        self.plan_at = senses.tick + self.config.replan_ticks;
        let doubtful_log_odds = if goal.why == GoalReason::DoubtfulFrontier {
            self.config.doubtful_log_odds
        } else {
            0.0
        };
        if senses.bumped {
            self.follower.clear();
        }
        let planned = self.navigator.plan(
            senses.map,
            &senses.pose,
            goal.target_m,
            doubtful_log_odds,
            &mut self.follower,
        );
        match planned {
            Ok(()) if senses.bumped => goal.restart_progress(),
            Ok(()) => {}
            Err(_) => self.drop_goal(DropReason::Unreachable, senses, events),
        }
    }

    /// The next step along the path; `None` if there is no path.
    fn follow(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) -> Option<Primitive> {
        let goal = self.goal.as_mut()?;
        let step = self.follower.next(&senses.pose).ok()?;
        match step.progress {
            Progress::Following => {
                goal.record_distance(step.remaining_m, senses.time_ns);
                Some(step.primitive)
            }
            Progress::Reached => {
                self.goal_reached(senses, events);
                None
            }
            Progress::OffPath => {
                self.follower.clear();
                self.plan_at = senses.tick;
                Some(Primitive::Stay)
            }
        }
    }

    fn goal_reached(&mut self, senses: &Observations<'_>, events: &mut Vec<Event>) {
        events.push(Event::GoalReached);
        let Some(goal) = self.goal else { return };
        self.forget_goal();
        self.note_tried(&goal);
        // A place that is still unknown when the robot is in front of it stays unknown: explore
        // elsewhere for a while.
        self.blacklist_place(goal.interest_m, senses);
    }
}

/// The blind policy that is this one, or that drives while it has no goal.
fn blind_part(kind: PolicyKind) -> BlindPolicy {
    match kind {
        PolicyKind::Random => BlindPolicy::Random,
        PolicyKind::Forward => BlindPolicy::Forward { rotations_left: 0 },
        PolicyKind::Calibration => BlindPolicy::Calibration(Pattern::default()),
        _ => BlindPolicy::Heuristic { queue: VecDeque::new() },
    }
}

/// The kind of goals with which a policy begins.
fn first_mode(kind: PolicyKind) -> GoalReason {
    match kind {
        PolicyKind::Inconsistency => GoalReason::Inconsistency,
        _ => GoalReason::Frontier,
    }
}

/// Whether unknown floor still meets free floor near `place_m`.
fn frontier_is_left(map: &OccupancyGrid, place_m: [f64; 2]) -> bool {
    let steps = (FRONTIER_RADIUS_M / map.cell_m()).ceil() as i32;
    let middle = map.cell_at(place_m[0], place_m[1]);
    (-steps..=steps).flat_map(|dy| (-steps..=steps).map(move |dx| middle.offset(dx, dy))).any(
        |cell| {
            map.state(cell) == CellState::Unknown
                && [(1, 0), (-1, 0), (0, 1), (0, -1)]
                    .iter()
                    .any(|(dx, dy)| map.state(cell.offset(*dx, *dy)) == CellState::Free)
        },
    )
}

remembers!(
    Explorer: kind, rng, blind, warm_up, mode, mode_since, goal, follower, blacklist, recent_positions_m, plan_at, choose_at, start, ending, errand, navigator
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{MapConfig, Sweep};
    use hal::{LaserScan, Range, ScanGeometry};
    use rand::SeedableRng;

    /// Integrates two scans from the origin, forward and backward; `range_m` gives the range at a
    /// bearing.
    fn scan_around(map: &mut OccupancyGrid, range_m: impl Fn(f64) -> f32) {
        let geometry = ScanGeometry::UTM_30LX;
        for yaw_rad in [0.0, std::f64::consts::PI] {
            let pose = Pose2 { x_m: 0.0, y_m: 0.0, yaw_rad };
            let ranges = (0..geometry.beams).map(|beam| {
                Range::Hit(range_m(hal::wrap_angle(yaw_rad + geometry.angle_rad(beam))))
            });
            map.begin_update(&pose).unwrap();
            let scan = LaserScan { time_ns: 0, geometry, ranges: ranges.collect() };
            map.integrate_scan(&scan, &Sweep::at_rest(pose)).unwrap();
            map.finish_update();
        }
    }

    /// A round hall with a bay ahead; one scan saw an obstacle in front of the bay.
    fn room_with_a_doubtful_bay() -> OccupancyGrid {
        let mut map = OccupancyGrid::new(&MapConfig::default()).unwrap();
        for _ in 0..10 {
            scan_around(&mut map, |bearing| if bearing.abs() < 0.4 { 1.9 } else { 1.2 });
        }
        scan_around(&mut map, |_| 1.2);
        map
    }

    fn explorer(kind: PolicyKind, config: ExplorationConfig, seed: u64) -> Explorer {
        let plan = PlanConfig::default();
        let follow = FollowerConfig::default();
        Explorer::new(kind, config, &plan, &follow, Pcg64Mcg::seed_from_u64(seed)).unwrap()
    }

    fn first_goal(doubtful_log_odds: f32) -> GoalReason {
        let config = ExplorationConfig { doubtful_log_odds, ..ExplorationConfig::default() };
        let mut explorer = explorer(PolicyKind::Frontier, config, 1);
        let map = room_with_a_doubtful_bay();
        let senses = Observations {
            tick: 0,
            time_ns: 0,
            pose: Pose2::IDENTITY,
            map: &map,
            frame_maps: None,
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
    fn a_frontier_behind_doubtful_obstacles_is_chosen_when_no_other_can_be_reached() {
        assert_eq!(first_goal(5.0), GoalReason::DoubtfulFrontier);
    }

    #[test]
    fn without_doubtful_obstacles_any_known_place_is_chosen_instead() {
        assert_eq!(first_goal(0.0), GoalReason::Revisit);
    }

    #[test]
    fn a_frontier_all_around_the_robot_is_not_resolved_before_it_is_observed() {
        let mut map = OccupancyGrid::new(&MapConfig::default()).unwrap();
        // The walls are beyond the range up to which the map clears: the centroid is the robot's place.
        scan_around(&mut map, |_| 5.0);
        let mut explorer = explorer(PolicyKind::Frontier, ExplorationConfig::default(), 1);
        let mut events = Vec::new();
        for tick in 0..30 {
            let time_ns = tick * 100_000_000;
            let pose = Pose2::IDENTITY;
            let senses =
                Observations { tick, time_ns, pose, map: &map, frame_maps: None, bumped: false };
            explorer.step(&senses, &mut events);
        }
        let chosen = events.iter().filter(|event| matches!(event, Event::GoalChosen { .. }));
        assert_eq!(chosen.count(), 1, "{events:?}");
    }

    #[test]
    fn all_policies_that_explore_begin_with_the_same_warm_up_and_then_differ() {
        fn steps(kind: PolicyKind) -> Vec<Primitive> {
            let config = ExplorationConfig { warm_up_frames: 64, ..ExplorationConfig::default() };
            let map = OccupancyGrid::new(&MapConfig::default()).unwrap();
            let mut explorer = explorer(kind, config, 4);
            let senses = Observations {
                tick: 0,
                time_ns: 0,
                pose: Pose2::IDENTITY,
                map: &map,
                frame_maps: None,
                bumped: false,
            };
            (0..128)
                .map(|tick| explorer.step(&Observations { tick, ..senses }, &mut Vec::new()))
                .collect()
        }
        let heuristic = steps(PolicyKind::Heuristic);
        for kind in PolicyKind::ALL.into_iter().filter(|kind| *kind != PolicyKind::Calibration) {
            assert_eq!(steps(kind)[..64], heuristic[..64], "{kind:?}");
        }
        assert_eq!(steps(PolicyKind::Calibration)[0], Primitive::TurnLeft);
        assert_ne!(steps(PolicyKind::Random)[64..], heuristic[64..]);
        assert!(steps(PolicyKind::Forward)[64..].iter().all(|step| *step == Primitive::Forward));
    }
}
