//! What goes wrong with a scanner, and what to do about it.

use std::io;
use std::sync::Arc;

use hal::ErrorKind;

use crate::scip::{Model, ScipError};

/// The first four are what [`poll_scan`](hal::Lidar::poll_scan) returns; they are made without allocating, and the driver's
/// [`problem`](super::HokuyoMonitor::problem) says more. The others are such problems.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HokuyoError {
    /// Not there, or not yet alive again.
    #[error(
        "LiDAR {port}: not connected, or its first good scans are being counted; the driver keeps trying to open it"
    )]
    Disconnected {
        /// Where it should be.
        port: Arc<str>,
    },
    /// No good scan for too long.
    #[error(
        "LiDAR {port}: no good scan for more than {limit_ms} ms; check its power and cable, the driver keeps listening"
    )]
    Silent {
        /// Where it is.
        port: Arc<str>,
        /// Two of its periods.
        limit_ms: u64,
    },
    /// A scan failed its checks.
    #[error(
        "LiDAR {port}: a scan failed its checks and was dropped; if it happens often, check cable and ground"
    )]
    Corrupt {
        /// Where it is.
        port: Arc<str>,
    },
    /// It is broken, sees nothing at all, or is another model.
    #[error(
        "LiDAR {port}: broken, blind or another model; the driver's problem text says which and what to do"
    )]
    Faulty {
        /// Where it is.
        port: Arc<str>,
    },
    /// A value of the configuration cannot work.
    #[error("LiDAR configuration: {what}")]
    Config {
        /// The value and its limits.
        what: String,
    },
    /// The port cannot be opened.
    #[error("LiDAR {port}: cannot be opened: {source}; {}", way_out(.source))]
    Open {
        /// The port.
        port: Arc<str>,
        /// The system's reason.
        source: io::Error,
    },
    /// The port was there and is gone.
    #[error(
        "LiDAR {port}: the connection broke ({source}); plug it in again, the driver waits for it"
    )]
    Gone {
        /// The port.
        port: Arc<str>,
        /// The system's reason.
        source: io::Error,
    },
    /// Nothing comes.
    #[error(
        "LiDAR {port}: no answer to `{command}`; check that the scanner has power and has finished starting"
    )]
    NoAnswer {
        /// The port.
        port: Arc<str>,
        /// What it was asked.
        command: &'static str,
    },
    /// Something comes, but not SCIP.
    #[error(
        "LiDAR {port}: {bytes} bytes came and no answer to `{command}`: wrong baud rate ({baud}) or another device; set \
         `baud` (19200, 57600, 115200, 250000, 500000, 750000) or correct `port`"
    )]
    NotScip {
        /// The port.
        port: Arc<str>,
        /// What it was asked.
        command: &'static str,
        /// How much came.
        bytes: usize,
        /// The rate that is set.
        baud: u32,
    },
    /// Another model.
    #[error(
        "LiDAR {port}: the scanner says it is `{found}`, configured is {configured}; correct `model` or `port`"
    )]
    WrongModel {
        /// The port.
        port: Arc<str>,
        /// What is configured.
        configured: Model,
        /// What it says, with its steps.
        found: String,
    },
    /// It does not measure because its laser is off.
    #[error(
        "LiDAR {port}: its laser is off although it was told to switch it on; it says: {says}; power-cycle it"
    )]
    LaserOff {
        /// The port.
        port: Arc<str>,
        /// In its own words.
        says: String,
    },
    /// Laser, motor or electronics are broken.
    #[error(
        "LiDAR {port}: hardware fault, status {status}; it says: {says}; power-cycle it, replace it if that does not help"
    )]
    Hardware {
        /// The port.
        port: Arc<str>,
        /// The two characters of its status.
        status: String,
        /// In its own words.
        says: String,
    },
    /// Scans in which nothing was measured.
    #[error(
        "LiDAR {port}: not one beam meets anything ({errors} errors, {too_near} too near, {no_return} without return); \
         uncover and clean the scanner"
    )]
    Blind {
        /// The port.
        port: Arc<str>,
        /// Beams that could not be measured.
        errors: usize,
        /// Beams with something too near.
        too_near: usize,
        /// Beams without return.
        no_return: usize,
    },
    /// Its clock jumped.
    #[error(
        "LiDAR {port}: its time stamps jumped, as after a restart; the driver sets it up again"
    )]
    ClockJumped {
        /// The port.
        port: Arc<str>,
    },
    /// It answers, but not as the protocol has it.
    #[error("LiDAR {port}: {source}")]
    Protocol {
        /// The port.
        port: Arc<str>,
        /// What is wrong.
        source: ScipError,
    },
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

/// What to do when a port does not open.
fn way_out(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => "is it plugged in? the driver waits for it",
        io::ErrorKind::PermissionDenied => {
            "add the user to the group `dialout` or install the udev rules"
        }
        io::ErrorKind::WouldBlock | io::ErrorKind::ResourceBusy => {
            "another program has it open; stop that one"
        }
        io::ErrorKind::ConnectionRefused => {
            "the address answers, the scanner does not; check `port` and its power"
        }
        _ => "check cable and `port`; the driver tries again",
    }
}
