//! Errors of the base, and the reasons for which it takes itself out of service.

use std::fmt;
use std::sync::Arc;

use hal::ErrorKind;

use super::bus::SendProblem;
use super::protocol::MotorProblem;

/// One of the two driven wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Left,
    Right,
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if *self == Self::Left { "left" } else { "right" })
    }
}

/// The reason why an armed base went out of service. It stays until the caller arms the base again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Trip {
    /// The CAN controller is bus-off.
    BusOff,
    /// The CAN interface is absent or down.
    BusGone,
    /// Nothing could be sent for 50 ms.
    TransmitBlocked,
    /// A motor stopped sending feedback.
    FeedbackSilent(Side),
    /// A motor reports a fault or left operation.
    MotorFault(Side),
    /// A wheel rotates against its command. Only a changed configuration clears this trip.
    WrongDirection(Side),
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The safety board stopped sending.
    SafetySilent,
    /// The control loop paused for longer than the motors' watchdog time.
    LoopStalled,
    /// The position of a wheel jumped: its controller has restarted.
    MotorRestarted(Side),
}

impl Trip {
    /// The number of this trip in `BaseState` of `embodied.dbc`.
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
            Self::MotorRestarted(_) => 10,
        }
    }
}

impl fmt::Display for Trip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BusOff => f.write_str(
                "the CAN controller is bus-off; check cable, termination and bit rate, then arm",
            ),
            Self::BusGone => f.write_str(
                "the CAN interface is absent or down; plug it in or set it up, then arm",
            ),
            Self::TransmitBlocked => f.write_str(
                "no frame could be sent for 50 ms; check cable and power of the motors, then arm",
            ),
            Self::FeedbackSilent(side) => {
                write!(f, "the {side} motor sends no feedback; check its power and cable, then arm")
            }
            Self::MotorFault(side) => {
                write!(f, "the {side} motor reports a fault; clear its cause, then arm")
            }
            Self::MotorRestarted(side) => {
                write!(f, "the {side} motor's controller has restarted; check its supply, then arm")
            }
            Self::WrongDirection(side) => {
                write!(
                    f,
                    "the {side} wheel rotates against its command; set invert_{side} or \
                     swap_wheels and start again"
                )
            }
            Self::EmergencyStop => {
                f.write_str("the emergency stop is pressed; release it, then arm")
            }
            Self::SafetySilent => {
                f.write_str("the safety board sends nothing; check its power and cable, then arm")
            }
            Self::LoopStalled => f.write_str(
                "the control loop paused for too long; check the load of the computer, then arm",
            ),
        }
    }
}

/// Why the base refuses a request or cannot report.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CanError {
    /// A number in the configuration is out of its range.
    #[error("base: {field} is {value}, allowed: {allowed}")]
    Config {
        /// Name of the field of [`BaseConfig`](super::BaseConfig).
        field: &'static str,
        value: String,
        allowed: String,
    },
    /// A frame could not be sent.
    #[error("CAN bus {bus}: {problem}")]
    Bus { bus: Arc<str>, problem: SendProblem },
    /// The base was not armed.
    #[error("the base is not armed; call arm() when it may move")]
    NotArmed,
    /// The base is out of service.
    #[error("the base has stopped: {0}")]
    Tripped(Trip),
    /// The command holds a number that is not finite.
    #[error("the command {linear_mps} m/s, {angular_radps} rad/s is not finite; the base stops")]
    NotFinite { linear_mps: f64, angular_radps: f64 },
    /// The plan behind the command is too old.
    #[error(
        "the plan is {age_ms} ms old, allowed: {limit_ms} ms; the base stops until a newer plan \
         arrives"
    )]
    PlanTooOld { age_ms: u64, limit_ms: u64 },
    /// The command's counter did not increase: the command is repeated or late.
    #[error("the command's counter is {found} after {last}; every command needs a higher one")]
    Counter { found: u32, last: u32 },
    /// A motor has not confirmed its watchdog yet.
    #[error("the {side} motor has not confirmed its watchdog yet: {}", not_ready_reason(.problem))]
    NotReady {
        side: Side,
        /// The reason, if it is known.
        problem: Option<MotorProblem>,
    },
    /// A motor cannot be used because of its configuration.
    #[error("the {side} motor cannot be used: {problem}")]
    Motor { side: Side, problem: MotorProblem },
    /// A wheel rotates although the base is not armed.
    #[error(
        "the {side} wheel rotates at {speed_mps:.2} m/s; the base can be armed only while it \
         stands still"
    )]
    Moving {
        side: Side,
        /// Speed at the rim.
        speed_mps: f64,
    },
    /// A motor sent no feedback within its time-out.
    #[error(
        "no feedback of the {side} motor for {age_ms} ms, allowed: {limit_ms} ms; check its \
         power and cable"
    )]
    Silent { side: Side, age_ms: u64, limit_ms: u64 },
}

fn not_ready_reason(problem: &Option<MotorProblem>) -> String {
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
                | Trip::MotorRestarted(_)
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
