//! What all motor controllers have in common. A protocol is a state machine without a bus: frames and the time go in, frames
//! come out, so that each can be tested and fuzzed without a device.
//!
//! Life of a motor: it is found on the bus, its own watchdog is set and **read back**, its faults are read; then it is ready. It
//! is enabled only on request, and a fault or a bus-off brings it back to the beginning.

pub mod cia402;
pub mod crc;
pub mod odrive;
pub mod sdo;
pub mod vesc;

use std::fmt;

use super::frame::CanFrame;

/// Frames of one turn. Every protocol sends four at most.
pub type Outbox = heapless::Vec<CanFrame, 8>;

/// Adds frames as far as there is room.
pub(crate) fn put(out: &mut Outbox, frames: impl IntoIterator<Item = CanFrame>) {
    for frame in frames {
        if out.push(frame).is_err() {
            return;
        }
    }
}

/// A question is asked again when it had no answer for this long: ten turns of the loop.
pub const ANSWER_NS: u64 = 100_000_000;

/// How far a motor has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MotorStage {
    /// Being found and configured.
    #[default]
    SettingUp,
    /// Configured, its watchdog confirmed, not powered.
    Ready,
    /// On the way to being powered.
    Enabling,
    /// Follows velocities.
    Enabled,
    /// Reports a fault; needs [`MotorProtocol::enable`], which clears it.
    Faulted,
    /// Its configuration cannot be trusted; needs a person.
    Refused,
}

/// What stands in a motor's way.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum MotorProblem {
    /// No answer to the question of this set-up step.
    NoAnswer {
        /// What was asked for.
        question: &'static str,
    },
    /// The controller's watchdog time is not what it must be.
    Watchdog {
        /// Milliseconds read back; not a number when it is switched off.
        read_ms: f64,
        /// The longest allowed, or the one that was written.
        wanted_ms: f64,
    },
    /// The controller lets the wheel roll when its watchdog expires.
    CoastsOnTimeout,
    /// The controller runs other firmware than the configured one, so its parameters may lie elsewhere.
    Firmware {
        /// Major, minor, revision as the controller tells it.
        found: [u8; 3],
    },
    /// The controller refused a parameter.
    Parameter {
        /// Object index or endpoint number.
        index: u16,
        /// Sub-index, 0 where the protocol has none.
        sub: u8,
        /// The controller's code, or the value that was read back instead of the written one.
        code: u32,
    },
    /// The controller reports a fault.
    Fault {
        /// Its own code.
        code: u32,
        /// What the code means.
        meaning: &'static str,
    },
    /// The controller answers with something else than was asked for.
    Nonsense {
        /// What was asked for.
        question: &'static str,
    },
}

impl fmt::Display for MotorProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoAnswer { question } => {
                write!(f, "no answer about its {question}; check power, cable, bit rate and node id")
            }
            Self::Watchdog { read_ms, wanted_ms } if read_ms.is_nan() => {
                write!(f, "its watchdog is off; set it to {wanted_ms} ms or less in the controller's own tool")
            }
            Self::Watchdog { read_ms, wanted_ms } => {
                write!(
                    f,
                    "its watchdog is {read_ms} ms, wanted {wanted_ms} ms or less; set it in the controller's own tool"
                )
            }
            Self::CoastsOnTimeout => f.write_str(
                "it lets the wheel roll when its watchdog expires; set a brake current or a stop ramp for time-outs",
            ),
            Self::Firmware { found: [major, minor, revision] } => {
                write!(
                    f,
                    "it runs firmware {major}.{minor}.{revision}, the configuration names another; take the endpoint numbers for it from flat_endpoints.json"
                )
            }
            Self::Parameter { index, sub, code } => write!(f, "it refuses parameter {index:#06x}:{sub} ({code:#010x})"),
            Self::Fault { code, meaning } => write!(f, "it reports fault {code:#x}, {meaning}"),
            Self::Nonsense { question } => {
                write!(f, "its answer about its {question} makes no sense; check the node id and the protocol")
            }
        }
    }
}

/// What is known of a motor. Angles are of the motor's own shaft, before the gear, in the motor's own direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotorStatus {
    /// How far it has come.
    pub stage: MotorStage,
    /// What stands in its way.
    pub problem: Option<MotorProblem>,
    /// The watchdog time that the controller confirmed, milliseconds.
    pub watchdog_ms: Option<f64>,
    /// Measured velocity, rad/s.
    pub velocity_radps: f64,
    /// Measured angle since the driver began, rad; counts on where the controller's own count wraps.
    pub position_rad: f64,
    /// When both were measured, monotonic; 0 before the first.
    pub feedback_ns: u64,
    /// Readings that failed a check and were dropped.
    pub bad: u64,
}

/// One motor on the bus.
pub trait MotorProtocol: Send {
    /// Takes a frame; false when it is somebody else's.
    fn receive(&mut self, frame: &CanFrame, time_ns: u64) -> bool;

    /// One turn: adds what has to be sent now, the velocity among it. Velocities that are not zero go out only while
    /// [`MotorStage::Enabled`].
    fn tick(&mut self, now_ns: u64, out: &mut Outbox);

    /// The velocity of the next turns, rad/s of the motor's shaft; finite.
    fn set_velocity(&mut self, radps: f64);

    /// Clears a fault and powers the motor, at a stand. Only a motor that is [`Ready`](MotorStage::Ready) or
    /// [`Faulted`](MotorStage::Faulted) listens.
    fn enable(&mut self);

    /// Takes the power off after braking, as the controller does it.
    fn disable(&mut self);

    /// Begins anew: configures the controller and reads its watchdog back.
    fn restart(&mut self);

    /// What is known of it.
    fn status(&self) -> &MotorStatus;
}

/// The question that a set-up is at, and when it was asked.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Question {
    asked_ns: Option<u64>,
}

impl Question {
    /// Whether it is time to ask, for the first time or again; notes that it was asked. True in the second place when an earlier
    /// one had no answer.
    pub(crate) fn ask(&mut self, now_ns: u64) -> (bool, bool) {
        match self.asked_ns {
            Some(asked) if now_ns.saturating_sub(asked) < ANSWER_NS => (false, false),
            before => {
                self.asked_ns = Some(now_ns);
                (true, before.is_some())
            }
        }
    }

    /// It was answered: the next may be asked at once.
    pub(crate) fn answered(&mut self) {
        self.asked_ns = None;
    }
}

/// Position of a counter that wraps, carried on in 64 bits.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Unwrapped {
    last: Option<i32>,
    total: i64,
}

impl Unwrapped {
    pub(crate) fn update(&mut self, count: i32) -> i64 {
        let step = count.wrapping_sub(self.last.unwrap_or(count));
        self.last = Some(count);
        self.total += i64::from(step);
        self.total
    }
}
