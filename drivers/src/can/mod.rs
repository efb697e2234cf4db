//! A drive base on a CAN bus.
//!
//! | module | what it knows |
//! |---|---|
//! | [`frame`], [`record`], [`stamp`] | a frame, its 16 bytes in Linux, and when it came |
//! | [`bus`] | the trait of a bus: send or not, never block, tell when it is ill |
//! | [`socket`], [`unix`] | SocketCAN, and the same over a Unix socket where the kernel has no CAN |
//! | [`protocol`] | motor controllers: ODrive CANSimple, VESC, CiA 402 |
//! | [`kinematics`], [`limits`] | two wheels, odometry, and how fast they may change |
//! | [`messages`] | our own frames, described in `embodied.dbc` |
//! | [`base`] | all of it as a [`hal::Base`] |

pub mod base;
pub mod bus;
pub mod config;
pub mod error;
pub mod frame;
mod guard;
pub mod kinematics;
pub mod limits;
pub mod messages;
pub mod protocol;
pub mod record;
pub mod socket;
pub mod stamp;
pub mod unix;

pub use base::{BaseCounts, DifferentialBase, Phase};
pub use bus::{Backoff, BusEvent, CanBus, ErrorState, Received, SendProblem};
pub use config::{BaseConfig, Protocol};
pub use error::{CanError, Side, Trip};
pub use frame::{CanFrame, CanId};
pub use kinematics::{Kinematics, Odometry};
pub use limits::{LimitConfig, Limiter};
pub use socket::SocketBus;
pub use unix::UnixBus;

/// The bus of that name: an interface such as `can0`, or `unix:PATH`. It need not be there yet.
#[must_use]
pub fn open_bus(name: &str) -> Box<dyn CanBus + Send> {
    match name.strip_prefix("unix:") {
        Some(path) => Box::new(UnixBus::new(path)),
        None => Box::new(SocketBus::new(name)),
    }
}
