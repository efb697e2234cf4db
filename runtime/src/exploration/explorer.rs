//! A policy at work: chooses goals, plans ways, follows them, gives up, and says why.

use std::collections::VecDeque;

use hal::Pose2;
use rand_pcg::Pcg64Mcg;

use super::blacklist::{Blacklist, distance_m};
use super::blind::BlindPolicy;
use super::choose::{self, Candidate};
use super::config::{ExplorationConfig, PolicyKind};
use super::goal::Goal;
use crate::event::{DropReason, Event, GoalReason, NoGoalReason};
use crate::mapping::{CellState, Frontier, OccupancyGrid, SingleFrameMap, inconsistencies};
use crate::planning::{Follower, Following, Planner, PlanningConfig, Primitive};

/// Ticks of heuristic walking when there is no goal: one of its moves.
const FILL_IN_TICKS: u64 = 16;
/// Ticks between two notes of where the robot has been, and how many are kept: the last 100 s at 10 Hz.
const TRAIL_EVERY_TICKS: u64 = 10;
const TRAIL_LENGTH: usize = 100;
/// A frontier is still there while unknown floor meets free floor this near to its middle, metres.
const FRONTIER_REACH_M: f64 = 0.45;
/// An inconsistent place is looked at from free floor at most this far away, metres.
const LOOK_FROM_M: f64 = 1.5;

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
    mode: GoalReason,
    mode_since: u64,
    goal: Option<Goal>,
    path_m: Vec<[f64; 2]>,
    planner: Planner,
    follower: Follower,
    blacklist: Blacklist,
    trail_m: VecDeque<[f64; 2]>,
    plan_at: u64,
    choose_at: u64,
}

impl Explorer {
    /// A policy that has seen nothing yet.
    #[must_use]
    pub fn new(kind: PolicyKind, config: ExplorationConfig, planning: &PlanningConfig, rng: Pcg64Mcg) -> Self {
        let blind = match kind {
            PolicyKind::Random => BlindPolicy::Random,
            PolicyKind::Forward => BlindPolicy::Forward { turns_left: 0 },
            _ => BlindPolicy::Heuristic { queue: VecDeque::new() },
        };
        let mode = if kind == PolicyKind::Inconsistency { GoalReason::Inconsistency } else { GoalReason::Frontier };
        Self {
            kind,
            config,
            rng,
            blind,
            mode,
            mode_since: 0,
            goal: None,
            path_m: Vec::new(),
            planner: Planner::new(planning),
            follower: Follower::new(planning),
            blacklist: Blacklist::default(),
            trail_m: VecDeque::with_capacity(TRAIL_LENGTH + 1),
            plan_at: 0,
            choose_at: 0,
        }
    }

    /// The current goal.
    #[must_use]
    pub fn goal(&self) -> Option<&Goal> {
        self.goal.as_ref()
    }

    /// The way to the goal, in `odom`, metres.
    #[must_use]
    pub fn path_m(&self) -> &[[f64; 2]] {
        &self.path_m
    }

    /// The next step, and what happened on the way to it.
    pub fn step(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) -> Primitive {
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
        if distance_m(goal.target_m, [senses.pose.x_m, senses.pose.y_m]) < self.config.goal_reached_m {
            events.push(Event::GoalReached);
            // What is still unknown there will not become known by standing in front of it: look elsewhere for a while.
            let interest_m = goal.interest_m;
            self.forget_goal();
            self.list(interest_m, senses);
            return;
        }
        let seconds = |time_ns: u64| time_ns as f64 * 1e-9;
        let why = if senses.bumped && goal.note_trip() >= self.config.trips_per_goal {
            DropReason::Blocked
        } else if seconds(goal.stalled_ns(now_ns)) > self.config.progress_timeout_s {
            DropReason::NoProgress
        } else if seconds(goal.age_ns(now_ns)) > self.config.goal_timeout_s {
            DropReason::Timeout
        } else if goal.why == GoalReason::Frontier && !frontier_is_left(senses.map, goal.interest_m) {
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
        self.path_m.clear();
    }

    fn list(&mut self, place_m: [f64; 2], senses: &Senses<'_>) {
        let expiry_ns = (self.config.blacklist_expiry_s * 1e9) as u64;
        self.blacklist.add(place_m, senses.time_ns + expiry_ns);
    }

    /// Looks for a goal: the mode's own first, then the other kind, then a place to look at again.
    fn choose_goal(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) {
        let survey = self.planner.survey(senses.map, &senses.pose);
        if survey.is_err() {
            events.push(Event::NoGoal { why: NoGoalReason::StartBlocked });
            self.choose_at = senses.tick + FILL_IN_TICKS;
            return;
        }
        let order = match self.mode {
            GoalReason::Inconsistency => [GoalReason::Inconsistency, GoalReason::Frontier],
            _ => [GoalReason::Frontier, GoalReason::Inconsistency],
        };
        for why in order {
            if why == GoalReason::Inconsistency && self.kind == PolicyKind::Frontier {
                continue;
            }
            let (candidates, none) = match why {
                GoalReason::Inconsistency => (self.inconsistent_places(senses), NoGoalReason::NoInconsistency),
                _ => (self.frontiers(senses), NoGoalReason::NoFrontier),
            };
            match choose::best(&candidates, &senses.pose, &self.blacklist, &self.config, &mut self.rng, none) {
                Ok(chosen) => return self.take(chosen.target_m, chosen.interest_m, why, senses, events),
                Err(why) => events.push(Event::NoGoal { why }),
            }
        }
        let reachable = self.planner.reachable_places();
        let recent: Vec<[f64; 2]> = self.trail_m.iter().copied().collect();
        match choose::revisit(&reachable, &recent, &self.blacklist, &self.config, &mut self.rng) {
            Some(place_m) => self.take(place_m, place_m, GoalReason::Revisit, senses, events),
            None => self.choose_at = senses.tick + FILL_IN_TICKS,
        }
    }

    fn take(
        &mut self,
        target_m: [f64; 2],
        interest_m: [f64; 2],
        why: GoalReason,
        senses: &Senses<'_>,
        events: &mut Vec<Event>,
    ) {
        events.push(Event::GoalChosen { x_m: target_m[0], y_m: target_m[1], why });
        self.goal = Some(Goal::new(target_m, interest_m, why, senses.time_ns));
        self.plan_at = senses.tick;
    }

    fn frontiers(&self, senses: &Senses<'_>) -> Vec<Candidate> {
        let candidate = |frontier: &Frontier| Candidate {
            target_m: frontier.approach_m,
            interest_m: frontier.centroid_m,
            size_m: frontier.cells as f64 * senses.map.cell_m(),
            travel_m: self.planner.travel_m(frontier.approach_m),
        };
        senses.map.frontiers().iter().map(candidate).collect()
    }

    /// The largest place that two looks disagree about and that can be looked at from reachable floor nearby.
    fn inconsistent_places(&self, senses: &Senses<'_>) -> Vec<Candidate> {
        let Some((new, old)) = senses.looks else { return Vec::new() };
        let candidate = |place: &crate::mapping::Inconsistency| {
            let target_m = self.planner.nearest_reachable(place.centroid_m, LOOK_FROM_M)?;
            Some(Candidate {
                target_m,
                interest_m: place.centroid_m,
                size_m: place.cells as f64 * senses.map.cell_m(),
                travel_m: self.planner.travel_m(target_m),
            })
        };
        let listed = |one: &Candidate| self.blacklist.holds(one.interest_m, self.config.blacklist_radius_m);
        let places = inconsistencies(new, old);
        places.iter().filter_map(candidate).find(|one| !listed(one)).into_iter().collect()
    }

    fn plan(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) {
        let Some(goal) = &mut self.goal else { return };
        self.plan_at = senses.tick + self.config.replan_ticks;
        match self.planner.plan(senses.map, &senses.pose, goal.target_m) {
            Ok(path_m) => {
                if senses.bumped {
                    goal.note_new_way();
                }
                self.path_m = path_m;
                self.follower.start(&self.path_m);
            }
            Err(_) => self.drop_goal(DropReason::Unreachable, senses, events),
        }
    }

    fn follow(&mut self, senses: &Senses<'_>, events: &mut Vec<Event>) -> Option<Primitive> {
        let goal = self.goal.as_mut()?;
        match self.follower.step(&self.path_m, &senses.pose) {
            Following::Step { primitive, left_m } => {
                goal.note_distance(left_m, senses.time_ns);
                Some(primitive)
            }
            Following::Arrived => {
                events.push(Event::GoalReached);
                let interest_m = goal.interest_m;
                self.forget_goal();
                self.list(interest_m, senses);
                None
            }
            Following::OffPath => {
                self.plan_at = senses.tick;
                Some(Primitive::Stay)
            }
        }
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
                && [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().any(|(x, y)| known(dx + x, dy + y) == CellState::Free)
        })
    })
}
