//! States of the safety plane, what goes into it and what comes out.

use hal::{ErrorKind, LaserScan, Pose2, Twist2, WheelFeedback};
use serde::{Deserialize, Serialize};

use crate::event::{FaultReason, SafetyEvent};

/// What the safety plane is doing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum SafetyState {
    /// Nobody has asked for motion yet, or a fault was cleared. Only [`Request::Arm`] leads out.
    Disarmed,
    /// Passing plans through.
    Clear,
    /// Passing plans through, slower: something is ahead.
    Slow,
    /// Something is in the stop zone: waiting until the wheels stand.
    Tripped {
        /// When it began.
        since_ns: u64,
        /// The obstacle, in `odom`, metres.
        blocked_m: [f64; 2],
    },
    /// Driving back from an obstacle.
    BackingOff(BackOff),
    /// Turning on the spot to find a way out.
    Escaping(Escape),
    /// Standing until the reason is gone; some need an operator.
    Fault(FaultReason),
}

/// Driving back from an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BackOff {
    /// Where it began, in `odom`.
    pub from: Pose2,
    /// When it began.
    pub since_ns: u64,
    /// How far back the ground was known to be free, metres.
    pub known_free_m: f64,
    /// It still feels what it is leaving.
    pub touching: bool,
    /// The obstacle, in `odom`, metres.
    pub blocked_m: [f64; 2],
}

/// Turning on the spot to find a way out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Escape {
    /// When its first turn was; `None` before.
    pub since_ns: Option<u64>,
    /// +1 turns left, -1 right.
    pub direction: f64,
    /// Turned so far, radians.
    pub turned_rad: f64,
    /// Heading at the last call.
    pub last_yaw_rad: f64,
}

impl SafetyState {
    /// Whether the safety plane drives by itself, or lets nobody drive: plans have no effect.
    #[must_use]
    pub fn is_in_charge(&self) -> bool {
        !matches!(self, Self::Clear | Self::Slow)
    }

    /// In one word.
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

/// What an operator, or the program on his behalf, asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// Let plans move the robot as soon as scanner and wheels are well.
    Arm,
    /// Stop and let nothing move it.
    Disarm,
    /// The reason of a fault is seen to: go to `Disarmed`.
    ClearFault,
}

/// What the planner wants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Wanted velocity.
    pub twist: Twist2,
    /// When what it was decided on was measured, monotonic.
    pub time_ns: u64,
}

/// What is known at one call.
#[derive(Debug, Clone, Copy)]
pub struct SafetyInput<'a> {
    /// Now, monotonic.
    pub time_ns: u64,
    /// A new scan, if one came.
    pub scan: Option<&'a LaserScan>,
    /// A new measurement of the wheels, if one came.
    pub wheel: Option<WheelFeedback>,
    /// The base says that it cannot be driven.
    pub base_error: Option<ErrorKind>,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The newest plan; `None` before the first.
    pub plan: Option<Plan>,
    /// What an operator asks for.
    pub request: Option<Request>,
}

/// What the safety plane lets through, and what it has to say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SafetyOutput {
    /// The command for the base. `None`: stop, as hard as the base can.
    pub command: Option<Twist2>,
    /// A change, with its reason.
    pub event: Option<SafetyEvent>,
    /// A place that the planner should treat as blocked, in `odom`, metres: set once, when backing off has ended.
    pub blocked_m: Option<[f64; 2]>,
    /// The planner's wish has no effect.
    pub in_charge: bool,
}

impl SafetyOutput {
    pub(super) const STOP: Self =
        Self { command: None, event: None, blocked_m: None, in_charge: true };

    pub(super) fn drive(command: Twist2) -> Self {
        Self { command: Some(command), ..Self::STOP }
    }

    /// The planner's wish, or what is left of it.
    pub(super) fn pass(twist: Twist2) -> Self {
        Self { in_charge: false, ..Self::drive(twist) }
    }

    pub(super) fn because(self, event: SafetyEvent) -> Self {
        Self { event: Some(event), ..self }
    }

    /// The command as a velocity.
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
