//! Errors of a scanner, with their remedies.

use std::io;
use std::sync::Arc;

use hal::ErrorKind;

use crate::scanner::{LinkError, remedy};
use crate::scip::{Model, ScipError};

/// [`poll_scan`](hal::Lidar::poll_scan) returns only the first four variants, which do not
/// allocate. The other variants are the detailed reasons, whose texts
/// [`problem`](crate::LidarMonitor::problem) returns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HokuyoError {
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
    /// A scan failed its checks.
    #[error(
        "LiDAR {port}: a scan failed its checks and was dropped; if it happens often, check \
         cable and ground"
    )]
    Corrupt { port: Arc<str> },
    /// The scanner is broken, covered, or another model than the configured one.
    #[error(
        "LiDAR {port}: broken, covered or another model; the driver's problem text names the \
         reason and the remedy"
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
        "LiDAR {port}: no answer to `{command}`; check that the scanner has power and has \
         finished starting"
    )]
    NoAnswer { port: Arc<str>, command: &'static str },
    /// The device sends bytes, but no SCIP messages.
    #[error(
        "LiDAR {port}: {bytes} bytes arrived but no answer to `{command}`: wrong baud rate \
         ({baud}) or another device; set `baud` (19200, 57600, 115200, 250000, 500000, 750000) or \
         correct `port`"
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
            Self::Disconnected { .. } | Self::Open { .. } | Self::Gone { .. } => {
                ErrorKind::Disconnected
            }
            Self::Silent { .. } | Self::NoAnswer { .. } => ErrorKind::Timeout,
            Self::Corrupt { .. } | Self::NotScip { .. } | Self::ClockJumped { .. } => {
                ErrorKind::Corrupt
            }
            Self::Faulty { .. }
            | Self::Hardware { .. }
            | Self::Blind { .. }
            | Self::LaserOff { .. } => ErrorKind::Fault,
            Self::Config { .. } | Self::WrongModel { .. } => ErrorKind::Unsupported,
            Self::Protocol { source, .. } => source.kind(),
        }
    }
}

impl From<LinkError> for HokuyoError {
    fn from(error: LinkError) -> Self {
        match error {
            LinkError::Open { port, source } => Self::Open { port, source },
            LinkError::Gone { port, source } => Self::Gone { port, source },
        }
    }
}
