//! A differential drive base on a CAN bus.
//!
//! | module | content |
//! |---|---|
//! | [`frame`], [`record`], [`stamp`] | a frame, its 16 bytes in Linux, and its time of reception |
//! | [`bus`] | the trait of a bus: non-blocking send and receive, and reports of bus errors |
//! | [`socket`], [`unix`] | SocketCAN, and a Unix socket for kernels without CAN |
//! | [`protocol`] | motor controllers: ODrive CANSimple, VESC, CiA 402 |
//! | [`sender`] | which controller sent a frame, for finding what is on a bus |
//! | [`kinematics`], [`limits`] | kinematics, odometry, limits of velocity and acceleration |
//! | [`messages`] | the project's own frames, described in `embodied.dbc` |
//! | [`base`] | all of this as a [`hal::Base`] |

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
pub mod sender;
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

/// Makes the bus of this name: an interface such as `can0`, or `unix:PATH`. The interface may
/// appear later.
#[must_use]
pub fn open_bus(name: &str) -> Box<dyn CanBus + Send> {
    match name.strip_prefix("unix:") {
        Some(path) => Box::new(UnixBus::new(path)),
        None => Box::new(SocketBus::new(name)),
    }
}
