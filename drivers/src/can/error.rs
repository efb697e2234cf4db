//! What can be wrong with the base.

use std::fmt;
use std::sync::Arc;

use hal::ErrorKind;

use super::bus::SendProblem;
use super::protocol::MotorProblem;

/// A wheel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if *self == Self::Left { "left" } else { "right" })
    }
}

/// What took an armed base out of service. Stays until somebody arms it again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Trip {
    /// The CAN controller left the bus.
    BusOff,
    /// The interface is gone or down.
    BusGone,
    /// Nothing could be sent for 50 ms.
    TransmitBlocked,
    /// A motor is silent.
    FeedbackSilent(Side),
    /// A motor reports a fault or has left operation.
    MotorFault(Side),
    /// A motor turns against its command. Only another configuration clears it.
    WrongDirection(Side),
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The safety board is silent.
    SafetySilent,
    /// The control loop stood still for longer than the motors' watchdog.
    LoopStalled,
}

impl Trip {
    /// Its number in `BaseState` of `embodied.dbc`.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::BusOff => 1,
            Self::BusGone => 2,
            Self::TransmitBlocked => 3,
            Self::FeedbackSilent(_) => 4,
            Self::MotorFault(_) => 5,
            Self::WrongDirection(_) => 6,
            Self::EmergencyStop => 7,
            Self::SafetySilent => 8,
            Self::LoopStalled => 9,
        }
    }
}

impl fmt::Display for Trip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BusOff => f.write_str(
                "the CAN controller is bus-off; check cable, termination and bit rate, then arm",
            ),
            Self::BusGone => {
                f.write_str("the CAN interface is gone or down; plug it in or set it up, then arm")
            }
            Self::TransmitBlocked => f.write_str(
                "nothing could be sent for 50 ms; check cable and power of the motors, then arm",
            ),
            Self::FeedbackSilent(side) => {
                write!(f, "the {side} motor is silent; check its power and cable, then arm")
            }
            Self::MotorFault(side) => {
                write!(f, "the {side} motor reports a fault; see its own text, then arm")
            }
            Self::WrongDirection(side) => {
                write!(
                    f,
                    "the {side} wheel turns against its command; set invert_{side} or swap_wheels and start again"
                )
            }
            Self::EmergencyStop => {
                f.write_str("the emergency stop is pressed; release it, then arm")
            }
            Self::SafetySilent => {
                f.write_str("the safety board is silent; check its power and cable, then arm")
            }
            Self::LoopStalled => f.write_str(
                "the control loop stood still; check the load of the computer, then arm",
            ),
        }
    }
}

/// Why the base does not do what it was asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CanError {
    /// A number in the configuration is out of its range.
    #[error("base: {field} is {value}, allowed: {allowed}")]
    Config {
        /// Field of [`BaseConfig`](super::BaseConfig).
        field: &'static str,
        /// What stands there.
        value: String,
        /// What may stand there.
        allowed: String,
    },
    /// A frame could not be sent.
    #[error("CAN bus {bus}: {problem}")]
    Bus {
        /// Its name.
        bus: Arc<str>,
        /// Why.
        problem: SendProblem,
    },
    /// The base was not armed.
    #[error("the base is not armed; call arm() when it may move")]
    NotArmed,
    /// The base is out of service.
    #[error("the base has stopped: {0}")]
    Tripped(Trip),
    /// The command holds a number that is not finite.
    #[error("the command {linear_mps} m/s, {angular_radps} rad/s is not finite; the base stands")]
    NotFinite {
        /// Its speed.
        linear_mps: f64,
        /// Its turn rate.
        angular_radps: f64,
    },
    /// The plan behind the command is too old.
    #[error(
        "the plan is {age_ms} ms old, allowed: {limit_ms} ms; the base stands until a fresh one comes"
    )]
    PlanTooOld {
        /// Its age.
        age_ms: u64,
        /// `plan_age_limit_ms`.
        limit_ms: u64,
    },
    /// The command's counter did not go up: a repeated or late command.
    #[error("the command's counter is {found} after {last}; every command needs a higher one")]
    Counter {
        /// Of this command.
        found: u32,
        /// Of the one before.
        last: u32,
    },
    /// A motor has not confirmed its watchdog.
    #[error("the {side} motor has not confirmed its watchdog yet: {}", reason(.problem))]
    NotReady {
        /// Which.
        side: Side,
        /// What stands in the way, if it is known.
        problem: Option<MotorProblem>,
    },
    /// A motor's own problem.
    #[error("the {side} motor cannot be used: {problem}")]
    Motor {
        /// Which.
        side: Side,
        /// What it says.
        problem: MotorProblem,
    },
    /// The wheels turn although nobody commands them.
    #[error("the {side} wheel turns at {speed_mps:.2} m/s; the base is armed only at a stand")]
    Moving {
        /// Which.
        side: Side,
        /// Its speed at the rim.
        speed_mps: f64,
    },
    /// No feedback.
    #[error(
        "no feedback of the {side} motor for {age_ms} ms, allowed: {limit_ms} ms; check its power and cable"
    )]
    Silent {
        /// Which.
        side: Side,
        /// Its age.
        age_ms: u64,
        /// `feedback_timeout_ms`.
        limit_ms: u64,
    },
}

fn reason(problem: &Option<MotorProblem>) -> String {
    problem
        .map_or_else(|| "it is still being set up; wait".to_owned(), |problem| problem.to_string())
}

impl hal::Error for CanError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Config { .. } => ErrorKind::Unsupported,
            Self::Bus { problem: SendProblem::Down | SendProblem::Gone, .. } => {
                ErrorKind::Disconnected
            }
            Self::Bus { .. } => ErrorKind::Fault,
            Self::Tripped(trip) => match trip {
                Trip::BusGone => ErrorKind::Disconnected,
                Trip::FeedbackSilent(_) | Trip::SafetySilent | Trip::LoopStalled => {
                    ErrorKind::Timeout
                }
                Trip::EmergencyStop => ErrorKind::Rejected,
                Trip::BusOff
                | Trip::TransmitBlocked
                | Trip::MotorFault(_)
                | Trip::WrongDirection(_) => ErrorKind::Fault,
            },
            Self::Motor { .. } => ErrorKind::Fault,
            Self::Silent { .. } => ErrorKind::Timeout,
            Self::NotArmed
            | Self::NotFinite { .. }
            | Self::PlanTooOld { .. }
            | Self::Counter { .. }
            | Self::NotReady { .. }
            | Self::Moving { .. } => ErrorKind::Rejected,
        }
    }
}
