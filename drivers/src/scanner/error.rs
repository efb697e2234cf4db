//! Errors that every scanner may have, with their remedies. Each driver's own error contains them.

use std::io;
use std::sync::Arc;

use hal::{ErrorKind, Range};

/// Why no scan can be returned now. Making one does not allocate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PollError {
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
    /// A scan, or a part of it, failed its checks.
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
}

impl PollError {
    pub(crate) fn kind(&self) -> ErrorKind {
        match self {
            Self::Disconnected { .. } => ErrorKind::Disconnected,
            Self::Silent { .. } => ErrorKind::Timeout,
            Self::Corrupt { .. } => ErrorKind::Corrupt,
            Self::Faulty { .. } => ErrorKind::Fault,
        }
    }
}

/// Why nothing can be read from or written to a port.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// The port cannot be opened.
    #[error("LiDAR {port}: cannot be opened: {source}; {}", remedy(.source))]
    Open { port: Arc<str>, source: io::Error },
    /// The connection to the port was lost.
    #[error(
        "LiDAR {port}: the connection was lost ({source}); plug it in again, the driver waits \
         for it"
    )]
    Gone { port: Arc<str>, source: io::Error },
}

/// No beam of a scan has a distance.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "LiDAR {port}: no beam measures a distance ({errors} errors, {too_near} too near, \
     {no_return} without echo); uncover and clean the scanner"
)]
pub struct BlindError {
    port: Arc<str>,
    /// Number of beams that could not be measured.
    errors: usize,
    /// Number of beams with an object that is too near.
    too_near: usize,
    /// Number of beams without an echo.
    no_return: usize,
}

impl BlindError {
    /// The error of a scan with these ranges, if it is one.
    pub(crate) fn of(ranges: &[Range], port: &Arc<str>) -> Option<Self> {
        ranges.iter().all(|range| range.hit_m().is_none()).then(|| Self {
            port: port.clone(),
            errors: count(Range::Error, ranges),
            too_near: count(Range::TooNear, ranges),
            no_return: count(Range::NoReturn, ranges),
        })
    }
}

fn count(kind: Range, ranges: &[Range]) -> usize {
    ranges.iter().filter(|range| **range == kind).count()
}

/// The remedy when a port cannot be opened.
fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => "is it plugged in? the driver waits for it",
        io::ErrorKind::PermissionDenied => {
            "add the user to the group `dialout` or install the udev rules"
        }
        io::ErrorKind::WouldBlock | io::ErrorKind::ResourceBusy => {
            "another program has opened it; stop that program"
        }
        io::ErrorKind::ConnectionRefused => {
            "the address exists but refuses the connection; check `port` and the scanner's power"
        }
        _ => "check cable and `port`; the driver tries again",
    }
}
