//! What replaces the policy for a while, and leaves the robot standing: a drive to one place, for the operator or back to the
//! start, and a drive by hand.

use hal::{Pose2, Twist2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::blacklist::distance_m;
use super::config::ExplorationConfig;
use super::goal::Goal;
use super::navigator::Navigator;
use super::observations::Observations;
use crate::event::{DropReason, Event, GoalReason};
use crate::planning::{Follower, Primitive, Progress};
use crate::tick::Command;

/// The robot tries this often to get there, and waits this long in between: a door may open, a person may pass.
const ATTEMPTS: u32 = 3;
const WAIT_NS: u64 = 10_000_000_000;
/// The robot stands at the place within this distance.
const REACHED_M: f64 = 0.08;
/// The robot faces as it should within this angle: more than half of a rotation action, which has 4 degrees by default.
const FACING_RAD: f64 = 0.05;

/// What the robot is doing about its errand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
enum Stage {
    /// It sets out at this time.
    Waiting {
        until_ns: u64,
    },
    Driving {
        goal: Goal,
        plan_at: u64,
    },
    /// It is there and rotates.
    Facing,
    /// It is there, or has given up.
    Standing,
    /// It drives as a person says, until this time.
    ByHand {
        command: Command,
        until_ns: u64,
    },
}

/// A place to drive to, with the progress; or a drive by hand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Errand {
    why: GoalReason,
    target_m: [f64; 2],
    yaw_rad: Option<f64>,
    stage: Stage,
    attempts: u32,
}

/// What an errand drives with.
pub(super) struct Means<'a> {
    pub navigator: &'a mut Navigator,
    pub follower: &'a mut Follower,
    pub config: &'a ExplorationConfig,
}

impl Errand {
    /// Standing where the robot is.
    pub(super) const HERE: Self = Self {
        why: GoalReason::Task,
        target_m: [0.0; 2],
        yaw_rad: None,
        stage: Stage::Standing,
        attempts: 0,
    };

    /// A drive to a place in `map`, metres.
    pub(super) fn to_place(target_m: [f64; 2]) -> Self {
        Self { target_m, stage: Stage::Waiting { until_ns: 0 }, ..Self::HERE }
    }

    /// A drive by hand at this velocity, until a time.
    pub(super) fn by_hand(command: Command, until_ns: u64) -> Self {
        Self { stage: Stage::ByHand { command, until_ns }, ..Self::HERE }
    }

    /// Whether it is a drive by hand that is not over.
    pub(super) fn is_by_hand(&self) -> bool {
        matches!(self.stage, Stage::ByHand { .. })
    }

    /// The velocity of a drive by hand; `None` for any other errand, and when the time of the drive is over.
    pub(super) fn hand_velocity(&mut self, time_ns: u64) -> Option<Twist2> {
        let Stage::ByHand { command, until_ns } = self.stage else { return None };
        if time_ns >= until_ns {
            self.stage = Stage::Standing;
            return None;
        }
        Some(command.into())
    }

    /// A return to a pose in `map`.
    pub(super) fn back_to(pose: &Pose2) -> Self {
        let yaw_rad = Some(pose.yaw_rad);
        Self { why: GoalReason::Return, yaw_rad, ..Self::to_place([pose.x_m, pose.y_m]) }
    }

    /// Where the robot is driving to.
    pub(super) fn goal(&self) -> Option<&Goal> {
        match &self.stage {
            Stage::Driving { goal, .. } => Some(goal),
            _ => None,
        }
    }

    /// Whether nothing is left to do.
    pub(super) fn is_standing(&self) -> bool {
        self.stage == Stage::Standing
    }

    /// Whether the robot was to return, and is back or has given up.
    pub(super) fn has_returned(&self) -> bool {
        self.why == GoalReason::Return && self.is_standing()
    }

    /// Moves the place, after the map was corrected.
    pub(super) fn move_places(&mut self, moved: impl Fn([f64; 2]) -> [f64; 2]) {
        if let Some(yaw_rad) = &mut self.yaw_rad {
            let pose = Pose2 { x_m: self.target_m[0], y_m: self.target_m[1], yaw_rad: *yaw_rad };
            *yaw_rad = moved_pose(&pose, &moved).yaw_rad;
        }
        self.target_m = moved(self.target_m);
        if let Stage::Driving { goal, plan_at } = &mut self.stage {
            goal.target_m = self.target_m;
            goal.interest_m = self.target_m;
            *plan_at = 0;
        }
    }

    /// The next step; appends what happened to `events`.
    pub(super) fn step(
        &mut self,
        senses: &Observations<'_>,
        means: &mut Means<'_>,
        events: &mut Vec<Event>,
    ) -> Primitive {
        if let Stage::Waiting { until_ns } = self.stage
            && senses.time_ns >= until_ns
        {
            let [x_m, y_m] = self.target_m;
            events.push(Event::GoalChosen { x_m, y_m, why: self.why });
            let goal = Goal::new(self.target_m, self.target_m, self.why, senses.time_ns);
            self.stage = Stage::Driving { goal, plan_at: senses.tick };
        }
        match self.stage {
            Stage::Driving { goal, plan_at } => self.drive(goal, plan_at, senses, means, events),
            Stage::Facing => self.face(&senses.pose),
            Stage::Waiting { .. } | Stage::Standing | Stage::ByHand { .. } => Primitive::Stay,
        }
    }

    fn drive(
        &mut self,
        mut goal: Goal,
        mut plan_at: u64,
        senses: &Observations<'_>,
        means: &mut Means<'_>,
        events: &mut Vec<Event>,
    ) -> Primitive {
        if distance_m(goal.target_m, [senses.pose.x_m, senses.pose.y_m]) < REACHED_M {
            return self.arrive(means, events);
        }
        if let Some(why) = goal.why_to_drop(means.config, senses) {
            return self.give_up(why, senses, means, events);
        }
        if senses.tick >= plan_at || senses.bumped {
            plan_at = senses.tick + means.config.replan_ticks;
            if senses.bumped {
                means.follower.clear();
            }
            let target_m = goal.target_m;
            let follower = &mut *means.follower;
            let planned = means.navigator.plan(senses.map, &senses.pose, target_m, 0.0, follower);
            if planned.is_err() {
                return self.give_up(DropReason::Unreachable, senses, means, events);
            }
            if senses.bumped {
                goal.restart_progress();
            }
        }
        let Ok(step) = means.follower.next(&senses.pose) else { return Primitive::Stay };
        match step.progress {
            Progress::Following => goal.record_distance(step.remaining_m, senses.time_ns),
            Progress::Reached => return self.arrive(means, events),
            Progress::OffPath => {
                means.follower.clear();
                plan_at = senses.tick;
            }
        }
        self.stage = Stage::Driving { goal, plan_at };
        if step.progress == Progress::OffPath { Primitive::Stay } else { step.primitive }
    }

    fn arrive(&mut self, means: &mut Means<'_>, events: &mut Vec<Event>) -> Primitive {
        events.push(Event::GoalReached);
        means.follower.clear();
        self.stage = if self.yaw_rad.is_some() { Stage::Facing } else { Stage::Standing };
        Primitive::Stay
    }

    fn give_up(
        &mut self,
        why: DropReason,
        senses: &Observations<'_>,
        means: &mut Means<'_>,
        events: &mut Vec<Event>,
    ) -> Primitive {
        events.push(Event::GoalDropped { why });
        means.follower.clear();
        self.attempts += 1;
        let until_ns = senses.time_ns.saturating_add(WAIT_NS);
        self.stage =
            if self.attempts < ATTEMPTS { Stage::Waiting { until_ns } } else { Stage::Standing };
        Primitive::Stay
    }

    fn face(&mut self, pose: &Pose2) -> Primitive {
        let error_rad = self.yaw_rad.map_or(0.0, |yaw_rad| wrap_angle(yaw_rad - pose.yaw_rad));
        if error_rad > FACING_RAD {
            Primitive::TurnLeft
        } else if error_rad < -FACING_RAD {
            Primitive::TurnRight
        } else {
            self.stage = Stage::Standing;
            Primitive::Stay
        }
    }
}

/// A pose after the map was corrected: its place and a place ahead of it move with the map.
pub(super) fn moved_pose(pose: &Pose2, moved: &impl Fn([f64; 2]) -> [f64; 2]) -> Pose2 {
    let [x_m, y_m] = moved([pose.x_m, pose.y_m]);
    let [ahead_x_m, ahead_y_m] = moved(pose.transform(0.3, 0.0).into());
    Pose2 { x_m, y_m, yaw_rad: (ahead_y_m - y_m).atan2(ahead_x_m - x_m) }
}
