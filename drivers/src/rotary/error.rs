//! Errors of a rotating scanner, with their remedies.

use std::io;
use std::sync::Arc;

use hal::ErrorKind;
use hal::settings::OutOfRange;

use super::WireError;
use crate::scanner::{LinkError, PollError, remedy};

/// [`poll_scan`](hal::Lidar::poll_scan) returns only the first four variants, which do not
/// allocate. The other variants are the detailed reasons, whose texts
/// [`problem`](crate::LidarMonitor::problem) returns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RotaryError {
    /// The scanner is absent, or its first good scans are still being counted.
    #[error(
        "LiDAR {port}: not connected, or its first good scans are being counted; the driver \
         keeps trying to open it"
    )]
    Disconnected { port: Arc<str> },
    /// No good scan arrived within the time-out.
    #[error(
        "LiDAR {port}: no good scan for more than {limit_ms} ms; check its power and cable, the \
         driver keeps listening"
    )]
    Silent {
        port: Arc<str>,
        /// The time-out: two scan periods.
        limit_ms: u64,
    },
    /// A part of a scan failed its checks.
    #[error(
        "LiDAR {port}: data failed its checks and was dropped; if it happens often, check cable \
         and ground"
    )]
    Corrupt { port: Arc<str> },
    /// The scanner is broken, covered, too slow, or another model than the configured one.
    #[error(
        "LiDAR {port}: broken, covered, too slow or another model; the driver's problem text \
         names the reason and the remedy"
    )]
    Faulty { port: Arc<str> },
    /// A value of the configuration is invalid.
    #[error("LiDAR configuration: {what}")]
    Config {
        /// The value and its limits.
        what: String,
    },
    /// The port cannot be opened.
    #[error("LiDAR {port}: cannot be opened: {source}; {}", remedy(.source))]
    Open { port: Arc<str>, source: io::Error },
    /// The connection to the port was lost.
    #[error(
        "LiDAR {port}: the connection was lost ({source}); plug it in again, the driver waits \
         for it"
    )]
    Gone { port: Arc<str>, source: io::Error },
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
    /// No beam of the scans has a distance.
    #[error(
        "LiDAR {port}: no beam measures a distance ({errors} errors, {too_near} too near, \
         {no_return} without echo); uncover and clean the scanner"
    )]
    Blind {
        port: Arc<str>,
        /// Number of beams that could not be measured.
        errors: usize,
        /// Number of beams with an object that is too near.
        too_near: usize,
        /// Number of beams without an echo.
        no_return: usize,
    },
    /// Data violates the protocol.
    #[error("LiDAR {port}: {source}")]
    Protocol { port: Arc<str>, source: WireError },
}

impl hal::Error for RotaryError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Disconnected { .. } | Self::Open { .. } | Self::Gone { .. } => {
                ErrorKind::Disconnected
            }
            Self::Silent { .. } | Self::NoData { .. } => ErrorKind::Timeout,
            Self::Corrupt { .. } | Self::OtherDevice { .. } | Self::Protocol { .. } => {
                ErrorKind::Corrupt
            }
            Self::Faulty { .. }
            | Self::Hardware { .. }
            | Self::TooSlow { .. }
            | Self::Blind { .. } => ErrorKind::Fault,
            Self::Config { .. } | Self::WrongModel { .. } => ErrorKind::Unsupported,
        }
    }
}

impl RotaryError {
    pub(crate) fn of_poll(error: PollError, port: &Arc<str>) -> Self {
        let port = port.clone();
        match error {
            PollError::Disconnected => Self::Disconnected { port },
            PollError::Silent { limit_ms } => Self::Silent { port, limit_ms },
            PollError::Corrupt => Self::Corrupt { port },
            PollError::Faulty => Self::Faulty { port },
        }
    }
}

impl From<LinkError> for RotaryError {
    fn from(error: LinkError) -> Self {
        match error {
            LinkError::Open { port, source } => Self::Open { port, source },
            LinkError::Gone { port, source } => Self::Gone { port, source },
        }
    }
}

impl From<OutOfRange> for RotaryError {
    fn from(error: OutOfRange) -> Self {
        Self::Config { what: error.to_string() }
    }
}
