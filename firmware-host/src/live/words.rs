//! The robot's state in words: what it does, or why it stands and what a person can do about it.

use std::time::Duration;

use hal::Pose2;
use runtime::event::{Event, FaultReason, GoalReason, NoGoalReason, SafetyEvent};
use runtime::localization::LostReason;
use runtime::recording::{fault_reason, lost_reason};
use runtime::robot::Robot;
use runtime::task::Task;
use runtime::tick::{Decision, TickInput};
use serde::Serialize;

use crate::control_panel::{ControlPanel, Plane};

/// The robot's state after a tick.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Now {
    tick: u64,
    /// Time since the first tick, seconds.
    run_s: f64,
    /// The state of the safety plane.
    plane: &'static str,
    /// Whether the robot stands for the reason in `why`.
    stands: bool,
    /// Whether it stands until a person arms it.
    needs_person: bool,
    /// What it does, or why it stands.
    why: String,
    x_m: f64,
    y_m: f64,
    yaw_deg: f64,
    /// Standard deviations of position and yaw against the scans of the last metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    position_std_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    yaw_std_deg: Option<f64>,
    goal: Option<Goal>,
    /// The command in force.
    linear_mps: f64,
    angular_radps: f64,
    /// The fastest that the robot may be driven by hand.
    most_mps: f64,
    most_radps: f64,
    /// Time that the tick took, milliseconds.
    tick_ms: f64,
    /// Ticks that the live view did not get because it was too slow.
    dropped: u64,
}

#[derive(Debug, Clone, Serialize)]
struct Goal {
    x_m: f64,
    y_m: f64,
    why: &'static str,
}

/// Remembers of earlier ticks what explains the present one.
pub struct StateTracker {
    panel: ControlPanel,
    memory: Memory,
    began_ns: Option<u64>,
}

/// What the words are made of.
#[derive(Debug, Clone, Default)]
struct Memory {
    plane: Plane,
    /// Why the last request to arm was cancelled.
    lapsed: Option<FaultReason>,
    task: Option<Task>,
    lost: Option<LostReason>,
    stands_lost: bool,
    is_tilted: bool,
    without_frames: bool,
    no_goal: Option<NoGoalReason>,
    is_done: bool,
    /// The robot stands because of its task.
    stands: bool,
    goal: Option<(GoalReason, [f64; 2])>,
    /// A person drives the robot by hand.
    by_hand: bool,
    /// The robot is in an area that it keeps out of, or has left those that it keeps in.
    in_closed_area: bool,
}

impl StateTracker {
    /// At the start of a run.
    pub fn new(panel: ControlPanel) -> Self {
        Self { panel, memory: Memory::default(), began_ns: None }
    }

    /// Takes note of a tick.
    pub fn note(&mut self, input: &TickInput<'_>, decision: &Decision) {
        self.began_ns.get_or_insert(input.time_ns);
        let memory = &mut self.memory;
        memory.task = input.task.or(memory.task);
        memory.lost = decision.lost;
        if input.frame.is_some() {
            memory.without_frames = false;
        }
        if decision.lost.is_none() {
            memory.stands_lost = false;
        }
        if decision.goal_m.is_some() {
            memory.no_goal = None;
        }
        for event in &decision.events {
            match event {
                Event::StandsWithoutFrames => memory.without_frames = true,
                Event::StandsLost => memory.stands_lost = true,
                Event::StandsTilted { .. } => memory.is_tilted = true,
                Event::LevelAgain => memory.is_tilted = false,
                Event::NoGoal { why } => memory.no_goal = Some(*why),
                Event::Safety { what: SafetyEvent::ArmingLapsed { why } } => {
                    memory.lapsed = Some(*why);
                }
                Event::Safety { what: SafetyEvent::Armed } => memory.lapsed = None,
                _ => {}
            }
        }
    }

    /// The state after the tick that was noted last.
    pub fn now(
        &mut self,
        robot: &Robot,
        input: &TickInput<'_>,
        decision: &Decision,
        took: Duration,
        dropped: u64,
    ) -> Now {
        let explorer = robot.explorer();
        self.memory.plane = self.panel.plane();
        self.memory.stands = explorer.stands();
        self.memory.is_done = explorer.is_done();
        self.memory.goal = explorer.goal().map(|goal| (goal.why, goal.target_m));
        self.memory.by_hand = explorer.is_driven_by_hand();
        let Pose2 { x_m, y_m, yaw_rad } = decision.t_map_base();
        self.memory.in_closed_area = explorer.keep_out().forbids([x_m, y_m]);
        let words = self.memory.words();
        let [most_mps, most_radps] = robot.speeds();
        let sent = decision.sent.unwrap_or_default();
        let since_ns = input.time_ns.saturating_sub(self.began_ns.unwrap_or(input.time_ns));
        Now {
            tick: decision.tick,
            run_s: since_ns as f64 * 1e-9,
            plane: self.memory.plane.name(),
            stands: words.stands,
            needs_person: words.needs_person,
            why: words.text,
            x_m,
            y_m,
            yaw_deg: yaw_rad.to_degrees(),
            position_std_m: robot.pose_std().map(|[position_m, _]| position_m),
            yaw_std_deg: robot.pose_std().map(|[_, yaw_rad]| yaw_rad.to_degrees()),
            goal: self.memory.goal.map(|(why, [x_m, y_m])| Goal { x_m, y_m, why: why.name() }),
            linear_mps: sent.linear_mps,
            angular_radps: sent.angular_radps,
            most_mps,
            most_radps,
            tick_ms: took.as_secs_f64() * 1e3,
            dropped,
        }
    }
}

/// The state in words.
#[derive(Debug, PartialEq)]
struct Words {
    stands: bool,
    needs_person: bool,
    text: String,
}

fn drives(text: String) -> Words {
    Words { stands: false, needs_person: false, text }
}

fn stands(text: impl Into<String>) -> Words {
    Words { stands: true, needs_person: false, text: text.into() }
}

fn needs_person(text: String) -> Words {
    Words { stands: true, needs_person: true, text }
}

impl Memory {
    fn words(&self) -> Words {
        self.safety_words().unwrap_or_else(|| self.exploration_words())
    }

    fn safety_words(&self) -> Option<Words> {
        match self.plane {
            Plane::Clear | Plane::Slow => None,
            Plane::Disarmed => Some(match self.lapsed {
                Some(why) => needs_person(format!(
                    "Not armed. Arming was cancelled: {}. Fix the cause, then press Arm.",
                    fault_reason(why)
                )),
                None => needs_person("Not armed. Press Arm when it may move.".to_owned()),
            }),
            Plane::Fault(why) if why.needs_person() => Some(needs_person(format!(
                "Stopped: {}. Fix the cause, then press Arm.",
                fault_reason(why)
            ))),
            Plane::Fault(why) => Some(stands(format!(
                "Stopped: {}. The robot resumes automatically when this condition clears.",
                fault_reason(why)
            ))),
            Plane::Tripped => Some(stands("Stopped: an obstacle is too near.")),
            Plane::BackingOff => Some(drives("Backs off from an obstacle.".to_owned())),
            Plane::Escaping => Some(drives("Rotates to find a way past an obstacle.".to_owned())),
        }
    }

    /// What is added where the safety plane slows the robot down.
    fn slowly(&self) -> &'static str {
        if self.plane == Plane::Slow { ", slowly: an obstacle is near" } else { "" }
    }

    fn exploration_words(&self) -> Words {
        if self.without_frames {
            return stands("Stopped: no camera image has come for too long.");
        }
        if self.by_hand {
            return drives(format!("Driven by hand{}.", self.slowly()));
        }
        if self.is_tilted {
            return stands("Stopped: the robot is tilted. Put it on level floor.");
        }
        if self.stands_lost {
            return stands("Lost, and it does not recognize this place. Move it to another place.");
        }
        if let Some(why) = self.lost.filter(|_| !self.stands) {
            let why = lost_reason(why);
            return drives(format!("Searches for its place in the map: {why}."));
        }
        if self.stands {
            return stands(match self.task {
                Some(Task::Pause) => "Paused. Press Resume to go on.",
                Some(Task::GoTo { .. }) => {
                    "Stands where it was sent, or found no way there. Press Resume to explore."
                }
                Some(Task::Return) => "Stands where the run began. Press Resume to explore.",
                Some(Task::Drive { .. }) => {
                    "Stands where it was driven by hand. Press Resume to explore."
                }
                _ => "Done: it has seen all floor that it can reach, and is back at its start.",
            });
        }
        if let Some((why, [x_m, y_m])) = self.goal {
            let why = purpose(why);
            let slowly = self.slowly();
            return drives(format!("Drives to ({x_m:.1}, {y_m:.1}) m: {why}{slowly}."));
        }
        if self.is_done {
            return drives("It has seen all floor that it can reach.".to_owned());
        }
        match self.no_goal {
            Some(NoGoalReason::StartBlocked) if self.in_closed_area => drives(
                "It is where it must not be: in an area that it keeps out of, or outside of the one that it keeps in. Drive it by hand, or open the areas."
                    .to_owned(),
            ),
            Some(NoGoalReason::StartBlocked) => {
                drives("Looks around: it knows no free floor under itself yet.".to_owned())
            }
            Some(_) => drives("Looks around: it can reach no goal at the moment.".to_owned()),
            None => drives("Looks around before its first goal.".to_owned()),
        }
    }
}

fn purpose(why: GoalReason) -> &'static str {
    match why {
        GoalReason::Frontier => "to see the unknown space beside it",
        GoalReason::Inconsistency => "to see again what two observations disagree about",
        GoalReason::DoubtfulFrontier => "to see whether an uncertain obstacle is still there",
        GoalReason::Revisit => "to see a known place from another side",
        GoalReason::Task => "it was sent there",
        GoalReason::Return => "back to where the run began",
        _ => "its policy chose that place",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use runtime::safety::STOPS;

    fn memory() -> Memory {
        Memory { plane: Plane::Clear, ..Memory::default() }
    }

    #[test]
    fn every_stop_says_its_reason_and_what_ends_it() {
        for stop in STOPS {
            let words = Memory { plane: Plane::Fault(stop.why), ..memory() }.words();
            assert!(words.text.contains(fault_reason(stop.why)), "{words:?}");
            assert_eq!(words.text.contains("press Arm"), stop.why.needs_person());
            assert_eq!((words.stands, words.needs_person), (true, stop.why.needs_person()));
        }
    }

    #[test]
    fn the_safety_planes_reason_goes_before_that_of_exploration() {
        let paused = Memory { stands: true, task: Some(Task::Pause), ..memory() };
        assert_eq!(paused.words(), stands("Paused. Press Resume to go on."));
        let disarmed = Memory { plane: Plane::Disarmed, ..paused };
        assert!(disarmed.words().needs_person);
    }

    #[test]
    fn a_robot_that_is_driven_by_hand_says_so_and_afterwards_why_it_stands() {
        let driven = Memory { by_hand: true, lost: Some(LostReason::Carried), ..memory() };
        assert_eq!(driven.words(), drives("Driven by hand.".to_owned()));
        let task = Some(Task::Drive { linear_mps: 0.1, angular_radps: 0.0 });
        let words = Memory { stands: true, task, by_hand: false, ..driven.clone() }.words();
        assert!(words.stands && words.text.contains("driven by hand"), "{words:?}");
        let stopped = Memory { plane: Plane::Fault(FaultReason::EmergencyStop), ..driven };
        assert!(stopped.words().needs_person);
    }

    #[test]
    fn a_robot_that_drives_says_where_to_and_why() {
        let goal = Some((GoalReason::Frontier, [1.25, -2.0]));
        let words = Memory { goal, ..memory() }.words();
        assert!(!words.stands);
        assert_eq!(words.text, "Drives to (1.2, -2.0) m: to see the unknown space beside it.");
    }
}
