//! Errors of a scanner, with their remedies.

use std::sync::Arc;

use hal::ErrorKind;

use crate::scanner::{BlindError, LinkError, PollError};
use crate::scip::{Model, ScipError};

/// [`poll_scan`](hal::Lidar::poll_scan) returns only the first variant, which does not allocate. The
/// other variants are the detailed reasons, whose texts
/// [`problem`](crate::LidarMonitor::problem) returns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HokuyoError {
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
        "LiDAR {port}: no answer to `{command}`; check that the scanner has power and has \
         finished starting"
    )]
    NoAnswer { port: Arc<str>, command: &'static str },
    /// The device sends bytes, but no SCIP messages.
    #[error(
        "LiDAR {port}: {bytes} bytes arrived but no answer to `{command}`: wrong baud rate \
         ({baud}) or another device; set `baud` (19200, 57600, 115200, 250000, 500000, 750000), \
         correct `port`, or set `kind = \"rplidar\"` or `\"ld06\"` if it is not a Hokuyo"
    )]
    NotScip {
        port: Arc<str>,
        command: &'static str,
        /// Number of bytes that arrived.
        bytes: usize,
        /// The configured baud rate.
        baud: u32,
    },
    /// The scanner is another model than the configured one.
    #[error(
        "LiDAR {port}: the scanner reports that it is `{found}`, configured is {configured}; \
         correct `model` or `port`"
    )]
    WrongModel {
        port: Arc<str>,
        configured: Model,
        /// The model that the scanner reports, with its steps.
        found: String,
    },
    /// The scanner does not measure because its laser is off.
    #[error(
        "LiDAR {port}: its laser is off although the driver switched it on; it reports: \
         {reported}; power-cycle it"
    )]
    LaserOff { port: Arc<str>, reported: String },
    /// The laser, the motor or the electronics are broken.
    #[error(
        "LiDAR {port}: hardware fault, status {status}; it reports: {reported}; power-cycle it, \
         replace it if that does not help"
    )]
    Hardware {
        port: Arc<str>,
        /// The two characters of the status.
        status: String,
        reported: String,
    },
    /// The scanner's clock jumped.
    #[error("LiDAR {port}: its timestamps jumped, as after a restart; the driver sets it up again")]
    ClockJumped { port: Arc<str> },
    /// A message violates the protocol.
    #[error("LiDAR {port}: {source}")]
    Protocol { port: Arc<str>, source: ScipError },
}

impl hal::Error for HokuyoError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Poll(error) => error.kind(),
            Self::Link(_) => ErrorKind::Disconnected,
            Self::NoAnswer { .. } => ErrorKind::Timeout,
            Self::NotScip { .. } | Self::ClockJumped { .. } => ErrorKind::Corrupt,
            Self::Hardware { .. } | Self::Blind(_) | Self::LaserOff { .. } => ErrorKind::Fault,
            Self::Config { .. } | Self::WrongModel { .. } => ErrorKind::Unsupported,
            Self::Protocol { source, .. } => source.kind(),
        }
    }
}
