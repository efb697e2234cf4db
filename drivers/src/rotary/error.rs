//! Errors of a rotating scanner, with their remedies.

use std::sync::Arc;

use hal::ErrorKind;
use hal::settings::OutOfRange;

use super::WireError;
use crate::scanner::{BlindError, LinkError, PollError};

/// [`poll_scan`](hal::Lidar::poll_scan) returns only the first variant, which does not allocate. The
/// other variants are the detailed reasons, whose texts
/// [`problem`](crate::LidarMonitor::problem) returns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RotaryError {
    /// No scan can be returned now.
    #[error(transparent)]
    Poll(#[from] PollError),
    /// Nothing can be read from or written to the port.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// No beam of the scans has a distance.
    #[error(transparent)]
    Blind(#[from] BlindError),
    /// A value of the configuration is invalid.
    #[error("LiDAR configuration: {what}")]
    Config {
        /// The value and its limits.
        what: String,
    },
    /// The scanner sends nothing.
    #[error(
        "LiDAR {port}: the {device} sends nothing; check that it has power, that its motor \
         rotates, and that its data line is connected"
    )]
    NoData { port: Arc<str>, device: &'static str },
    /// The device sends bytes, but not those of the configured scanner.
    #[error(
        "LiDAR {port}: {bytes} bytes arrived, but nothing that a {device} sends at {baud} bit/s: \
         another device or another bit rate; correct `kind`, `port` or `baud`"
    )]
    OtherDevice {
        port: Arc<str>,
        device: &'static str,
        /// Number of bytes that arrived.
        bytes: usize,
        baud: u32,
    },
    /// The scanner is another model than the configured one.
    #[error(
        "LiDAR {port}: the scanner reports the model number {found:#04x}, configured is {device}; \
         correct `devices.lidar.rplidar.model` or `port`"
    )]
    WrongModel {
        port: Arc<str>,
        device: &'static str,
        /// The number that the scanner reports.
        found: u8,
    },
    /// The scanner reports a fault of its own.
    #[error(
        "LiDAR {port}: hardware fault, health {health}; the driver restarts it; if that does not \
         help, power-cycle it, then replace it"
    )]
    Hardware {
        port: Arc<str>,
        /// The state that it reports.
        health: String,
    },
    /// The motor rotates more slowly than the robot's speed allows for.
    #[error(
        "LiDAR {port}: it rotates {hz:.1} times a second instead of {expected_hz:.1}, or loses \
         data; check its power supply and bearing, or set `rotation_hz`"
    )]
    TooSlow {
        port: Arc<str>,
        /// The measured rate.
        hz: f64,
        /// The configured rate.
        expected_hz: f64,
    },
    /// Data violates the protocol.
    #[error("LiDAR {port}: {source}")]
    Protocol { port: Arc<str>, source: WireError },
}

impl hal::Error for RotaryError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Poll(error) => error.kind(),
            Self::Link(_) => ErrorKind::Disconnected,
            Self::NoData { .. } => ErrorKind::Timeout,
            Self::OtherDevice { .. } | Self::Protocol { .. } => ErrorKind::Corrupt,
            Self::Hardware { .. } | Self::TooSlow { .. } | Self::Blind(_) => ErrorKind::Fault,
            Self::Config { .. } | Self::WrongModel { .. } => ErrorKind::Unsupported,
        }
    }
}

impl From<OutOfRange> for RotaryError {
    fn from(error: OutOfRange) -> Self {
        Self::Config { what: error.to_string() }
    }
}
