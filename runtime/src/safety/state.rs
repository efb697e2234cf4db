//! The states of the safety plane, its inputs and its outputs.

use hal::{LaserScan, Pose2, Twist2, WheelFeedback};
use serde::{Deserialize, Serialize};

use crate::event::{FaultReason, SafetyEvent};

/// The state of the safety plane. The table in `safety/mod.rs` lists the transitions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum SafetyState {
    /// The operator has not armed the robot yet, or has disarmed it or cleared a fault. Nothing
    /// moves.
    Disarmed,
    /// Plans pass unchanged.
    Clear,
    /// Plans pass at a reduced speed because an obstacle is ahead.
    Slow,
    /// An obstacle is in the stop zone: the robot brakes and waits until the wheels stand still.
    Tripped {
        since_ns: u64,
        /// The obstacle, in `odom`, metres.
        blocked_m: [f64; 2],
    },
    /// Reversing away from the obstacle, without a plan.
    BackingOff(BackOff),
    /// Rotating on the spot until there is free space ahead, without a plan.
    Escaping(Escape),
    /// Stopped until the reason is gone, or until a person has inspected the robot: see
    /// [`STOPS`](super::STOPS).
    Fault(FaultReason),
}

/// Progress of a back-off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BackOff {
    /// Pose in `odom` where the back-off began.
    pub from: Pose2,
    pub since_ns: u64,
    /// Distance behind the robot that was known to be free when the back-off began, metres.
    pub known_free_m: f64,
    /// The bumper has been pressed without a break since before the back-off began.
    pub touching: bool,
    /// The cliff sensors have seen no floor without a break since before the back-off began.
    #[serde(default)]
    pub at_cliff: bool,
    /// The obstacle, in `odom`, metres.
    pub blocked_m: [f64; 2],
}

/// Progress of an escape.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Escape {
    /// Time of the first tick of the escape; `None` before that tick.
    pub since_ns: Option<u64>,
    /// +1 rotates left, -1 rotates right.
    pub direction: f64,
    /// Sum of the absolute yaw changes so far, radians.
    pub turned_rad: f64,
    /// Yaw in `odom` at the previous tick.
    pub last_yaw_rad: f64,
}

impl SafetyState {
    /// Whether plans have no effect: the safety plane stops the robot, or drives it without a plan.
    #[must_use]
    pub fn is_in_charge(&self) -> bool {
        !matches!(self, Self::Clear | Self::Slow)
    }

    /// The state's name for logs and status output.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Disarmed => "disarmed",
            Self::Clear => "clear",
            Self::Slow => "slow",
            Self::Tripped { .. } => "tripped",
            Self::BackingOff(_) => "backing off",
            Self::Escaping(_) => "escaping",
            Self::Fault(_) => "fault",
        }
    }
}

/// A request of the operator, or of a program on the operator's behalf.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// Let plans move the robot as soon as scanner and wheels are healthy.
    Arm,
    /// Stop, and allow no motion until the robot is armed again.
    Disarm,
    /// The operator has removed the cause of the fault: go to `Disarmed`.
    ClearFault,
}

/// The velocity that the planner asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    pub twist: Twist2,
    /// Time of the measurements that the plan is based on, monotonic. A plan that is too old is
    /// refused.
    pub time_ns: u64,
}

/// The inputs of one control tick.
#[derive(Debug, Clone, Copy)]
pub struct SafetyInput<'a> {
    /// The current time, monotonic.
    pub time_ns: u64,
    /// The scan that arrived since the previous tick, if any.
    pub scan: Option<&'a LaserScan>,
    /// The wheel feedback that arrived since the previous tick, if any.
    pub wheel: Option<WheelFeedback>,
    /// Why the base cannot be driven, if it reports an error.
    pub base_error: Option<FaultReason>,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The computer was suspended since the previous tick, which the monotonic clock does not show.
    pub suspended: bool,
    /// The newest plan; `None` before the first one.
    pub plan: Option<Plan>,
    /// The operator's request, if there is one in this tick.
    pub request: Option<Request>,
}

/// The output of one control tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SafetyOutput {
    /// The command for the base. `None`: stop as hard as the base can.
    pub command: Option<Twist2>,
    /// What changed in this tick, with the reason.
    pub event: Option<SafetyEvent>,
    /// A point in `odom`, metres, that the planner has to treat as blocked. Set once, when the
    /// back-off has ended.
    pub blocked_m: Option<[f64; 2]>,
    /// A point in `odom`, metres, before which the robot stands because the scanner does not see it.
    pub unseen_m: Option<[f64; 2]>,
    /// The plan has no effect in this tick.
    pub in_charge: bool,
    /// Why no motion is allowed in this tick, whatever the state is.
    pub forbidden: Option<FaultReason>,
}

impl SafetyOutput {
    pub(super) const STOP: Self = Self {
        command: None,
        event: None,
        blocked_m: None,
        unseen_m: None,
        in_charge: true,
        forbidden: None,
    };

    pub(super) fn drive(command: Twist2) -> Self {
        Self { command: Some(command), ..Self::STOP }
    }

    /// The planner's command, possibly with a reduced speed.
    pub(super) fn pass(twist: Twist2) -> Self {
        Self { in_charge: false, ..Self::drive(twist) }
    }

    pub(super) fn because(self, event: SafetyEvent) -> Self {
        Self { event: Some(event), ..self }
    }

    /// The command as a velocity; a stop is the zero velocity.
    #[must_use]
    pub fn twist(&self) -> Twist2 {
        self.command.unwrap_or(Twist2::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_has_a_name_and_only_two_of_them_follow_plans() {
        let back_off = BackOff {
            from: Pose2::IDENTITY,
            since_ns: 0,
            known_free_m: 0.0,
            touching: false,
            at_cliff: false,
            blocked_m: [0.0; 2],
        };
        let escape = Escape { since_ns: None, direction: 1.0, turned_rad: 0.0, last_yaw_rad: 0.0 };
        let states = [
            (SafetyState::Disarmed, "disarmed", true),
            (SafetyState::Clear, "clear", false),
            (SafetyState::Slow, "slow", false),
            (SafetyState::Tripped { since_ns: 0, blocked_m: [0.0; 2] }, "tripped", true),
            (SafetyState::BackingOff(back_off), "backing off", true),
            (SafetyState::Escaping(escape), "escaping", true),
            (SafetyState::Fault(FaultReason::LidarBad), "fault", true),
        ];
        for (state, name, in_charge) in states {
            assert_eq!((state.name(), state.is_in_charge()), (name, in_charge));
        }
    }
}
