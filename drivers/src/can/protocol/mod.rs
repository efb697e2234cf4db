//! The protocols of motor controllers, and the trait [`MotorProtocol`] that they share. A protocol
//! is a state machine without I/O: it takes received frames and the time, and returns the frames to
//! send. It can therefore be tested and fuzzed without a device.
//!
//! The life of a motor: the driver finds it on the bus, sets the controller's own watchdog and
//! **reads it back**, and reads its faults. Then the motor is ready. It is enabled only on request,
//! and after a fault or a bus-off it is set up again.
//!
//! # Adding a protocol
//!
//! 1. Implement [`MotorProtocol`] in a module of this folder. `examples/new_motor_protocol.rs` of
//!    this crate is a complete implementation for an invented controller, to copy.
//! 2. Add a variant to [`Protocol`](super::config::Protocol), a table with the protocol's own
//!    settings to [`BaseConfig`](super::config::BaseConfig), and construct the motor where
//!    `BaseConfig` constructs the others.
//! 3. Add the module to the fuzz target of the motor protocols, and a simulated controller to the
//!    tests of the base.

pub mod cia402;
pub mod crc;
pub mod odrive;
pub mod power;
pub mod sdo;
pub mod vesc;

use std::fmt;

pub use power::PowerReadings;

use super::frame::CanFrame;

/// The frames that a motor sends in one tick. Every protocol sends at most four.
pub type Outbox = heapless::Vec<CanFrame, 8>;

/// Adds frames while the outbox has free capacity.
pub(crate) fn put(out: &mut Outbox, frames: impl IntoIterator<Item = CanFrame>) {
    for frame in frames {
        if out.push(frame).is_err() {
            return;
        }
    }
}

/// A set-up request without a response is repeated after this time: ten control ticks.
pub const RESPONSE_NS: u64 = 100_000_000;

/// The progress of a motor from power-up to following velocities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MotorStage {
    /// The controller is being found and configured.
    #[default]
    SettingUp,
    /// The controller is configured and its watchdog confirmed; the motor is not powered.
    Ready,
    /// The motor is being powered.
    Enabling,
    /// The motor follows velocities.
    Enabled,
    /// The controller reported a fault. [`MotorProtocol::enable`] clears it.
    Faulted,
    /// The controller's configuration is unsafe. An operator must correct it.
    Refused,
}

/// Why a motor is not ready or not enabled.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum MotorProblem {
    /// The controller did not respond to a set-up request.
    NoResponse { request: &'static str },
    /// The controller's watchdog time is not the required one.
    Watchdog {
        /// The time that was read back; NaN when the watchdog is off.
        read_ms: f64,
        /// The longest allowed time, or the time that was written.
        required_ms: f64,
    },
    /// The controller lets the wheel coast when its watchdog expires.
    CoastsOnTimeout,
    /// The controller runs other firmware than the configured one, so its parameters may have other
    /// addresses.
    Firmware {
        /// Major, minor and revision that the controller reports.
        found: [u8; 3],
    },
    /// The controller refused a parameter.
    Parameter {
        /// Object index or endpoint number.
        index: u16,
        /// Sub-index, 0 where the protocol has none.
        sub: u8,
        /// The controller's error code, or the value that was read back instead of the written one.
        code: u32,
    },
    /// The controller reports a fault.
    Fault { code: u32, meaning: &'static str },
    /// The controller's response does not match the request.
    Mismatch { request: &'static str },
}

impl fmt::Display for MotorProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoResponse { request } => {
                write!(
                    f,
                    "no response to the request for its {request}; check power, cable, bit \
                    rate and node id"
                )
            }
            Self::Watchdog { read_ms, required_ms } if read_ms.is_nan() => {
                write!(
                    f,
                    "its watchdog is off; set it to {required_ms} ms or less in the \
                    controller's own tool"
                )
            }
            Self::Watchdog { read_ms, required_ms } => {
                write!(
                    f,
                    "its watchdog is {read_ms} ms, but must be {required_ms} ms or less; set it \
                     in the controller's own tool"
                )
            }
            Self::CoastsOnTimeout => f.write_str(
                "it lets the wheel coast when its watchdog expires; set a brake current or a \
                 stop ramp for time-outs",
            ),
            Self::Firmware { found: [major, minor, revision] } => {
                write!(
                    f,
                    "it runs firmware {major}.{minor}.{revision}, but the configuration names \
                     another; configure this one with the endpoint numbers from its \
                     flat_endpoints.json"
                )
            }
            Self::Parameter { index, sub, code } => {
                write!(f, "it refuses parameter {index:#06x}:{sub} ({code:#010x})")
            }
            Self::Fault { code, meaning } => write!(f, "it reports fault {code:#x}, {meaning}"),
            Self::Mismatch { request } => {
                write!(
                    f,
                    "its response does not match the request for its {request}; check the \
                    node id and the protocol"
                )
            }
        }
    }
}

/// The state of a motor as far as the driver knows it. Angles are those of the motor's shaft,
/// before the gear and in the motor's own direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotorStatus {
    pub stage: MotorStage,
    /// Why the motor is not ready or not enabled, if there is a reason.
    pub problem: Option<MotorProblem>,
    /// The watchdog time that the controller confirmed; `None` until then.
    pub watchdog_ms: Option<f64>,
    pub velocity_radps: f64,
    /// Measured angle of the shaft. It continues where the controller's own counter wraps.
    pub position_rad: f64,
    /// Monotonic time of the older of the two measurements; 0 before the first.
    pub feedback_ns: u64,
    /// Supply and temperatures, as far as the controller reports them.
    pub power: PowerReadings,
    /// Frames that failed a check and were dropped.
    pub bad: u64,
}

/// One motor on the bus.
///
/// An implementation must keep these rules, on which the base relies:
///
/// * No method blocks, allocates or reads a clock. The times passed in are monotonic.
/// * [`MotorStatus::watchdog_ms`] is `Some` only after the controller itself confirmed its watchdog
///   time. If the controller cannot do that, or if the time is too long, the stage is
///   [`Refused`](MotorStage::Refused).
/// * From then on every [`tick`](Self::tick) sends a velocity, which feeds the watchdog. It is zero
///   unless the stage is [`Enabled`](MotorStage::Enabled).
/// * [`MotorStatus::feedback_ns`] advances only with a position and a velocity that passed every
///   check. A frame that fails a check is counted in [`MotorStatus::bad`] and changes nothing else.
/// * A controller that reports a fault, or leaves operation on its own, becomes
///   [`Faulted`](MotorStage::Faulted) and stays so until [`enable`](Self::enable).
pub trait MotorProtocol: Send {
    /// Processes a received frame. Returns false when the frame does not belong to this motor.
    fn receive(&mut self, frame: &CanFrame, time_ns: u64) -> bool;

    /// Adds the frames to send in this control tick: the velocity and any due set-up request. The
    /// base calls this at about 100 Hz. A velocity other than zero may be sent only while the stage
    /// is [`MotorStage::Enabled`].
    fn tick(&mut self, now_ns: u64, out: &mut Outbox);

    /// Sets the velocity for the next ticks, in rad/s of the motor's shaft. The base passes only
    /// finite values.
    fn set_velocity(&mut self, radps: f64);

    /// Clears a fault and powers the motor at standstill. Has an effect only while the stage is
    /// [`Ready`](MotorStage::Ready) or [`Faulted`](MotorStage::Faulted).
    fn enable(&mut self);

    /// Removes power from the motor. The base calls this after braking.
    fn disable(&mut self);

    /// Adds the frames after which an unpowered controller no longer waits for commands. The base
    /// calls this before it is left alone, and sends nothing to the motor afterwards.
    fn finish(&mut self, _out: &mut Outbox) {}

    /// Starts the set-up again: configures the controller and reads its watchdog back. The base
    /// calls this after a bus error.
    fn restart(&mut self);

    fn status(&self) -> &MotorStatus;
}

/// The timing of a set-up request: when to send it, and when to repeat it because there was no
/// response. For implementations of [`MotorProtocol`].
#[derive(Debug, Clone, Copy, Default)]
pub struct SetupRequest {
    sent_ns: Option<u64>,
}

impl SetupRequest {
    /// Whether the request has to be sent now. If so, it counts as sent at `now_ns`.
    pub fn due(&mut self, now_ns: u64) -> Due {
        match self.sent_ns {
            Some(sent) if now_ns.saturating_sub(sent) < RESPONSE_NS => Due::No,
            before => {
                self.sent_ns = Some(now_ns);
                if before.is_some() { Due::Repeat } else { Due::First }
            }
        }
    }

    /// Records the response, so that the next request is due at once.
    pub fn answered(&mut self) {
        self.sent_ns = None;
    }
}

/// Whether a set-up request has to be sent now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Due {
    /// The request was sent a short time ago.
    No,
    /// The request has to be sent for the first time.
    First,
    /// The request has to be sent again, because there was no response.
    Repeat,
}

/// A position counter of 32 bits that wraps, continued in 64 bits. It starts at 0. For
/// implementations of [`MotorProtocol`].
#[derive(Debug, Clone, Copy, Default)]
pub struct UnwrappedCounter {
    last: Option<i32>,
    total: i64,
}

impl UnwrappedCounter {
    /// Takes the controller's count and returns the continued one.
    pub fn update(&mut self, count: i32) -> i64 {
        let step = count.wrapping_sub(self.last.unwrap_or(count));
        self.last = Some(count);
        self.total += i64::from(step);
        self.total
    }
}
