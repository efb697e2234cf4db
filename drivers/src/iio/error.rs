//! Errors of inertial measurement units, with their remedies.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use hal::ErrorKind;

use super::Refusal;

/// Why a unit cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImuError {
    /// A value of the configuration is not allowed.
    #[error("IMU: {what}")]
    Config {
        /// The value, and what is allowed.
        what: String,
    },
    /// The thread that reads the unit cannot be started.
    #[error("IMU: its thread cannot be started: {source}")]
    Thread { source: io::Error },
    /// There is no such device, or no other program at the socket.
    #[error("IMU {device}: {what}; the driver waits for it")]
    Absent { device: Arc<str>, what: String },
    /// A file may not be opened by this user.
    #[error(
        "IMU: no permission for {}; the udev rules of the package give the group `embodied-depth` access: install the \
         package (60-embodied-depth.rules) and add the user to that group", .path.display()
    )]
    Denied { path: PathBuf },
    /// A socket of another program may not be connected to by this user.
    #[error(
        "IMU: no permission for the socket {}; its program must give the user of `firmware-host` write permission, outside of /home and /tmp",
        .path.display()
    )]
    SocketDenied { path: PathBuf },
    /// Another program reads the device.
    #[error("IMU: {} is used by another program, often iio-sensor-proxy; `fuser -v {}` shows which",
        .path.display(), .path.display())]
    Busy { path: PathBuf },
    /// A file of the device cannot be read or written.
    #[error("IMU: {} {}: {source}; the kernel's log may show the reason: `dmesg`", .path.display(), .what)]
    Attribute {
        path: PathBuf,
        /// What failed: that it cannot be read, or does not accept a value.
        what: String,
        source: io::Error,
    },
    /// The device cannot be what is configured.
    #[error("IMU {device}: {what}")]
    Unsupported { device: Arc<str>, what: String },
    /// The device disappeared, or the other program closed its socket.
    #[error("IMU {device}: the connection was lost ({source}); the driver waits for it")]
    Gone { device: Arc<str>, source: io::Error },
    /// The device is open but sends no samples.
    #[error(
        "IMU {device}: no sample for more than {limit_ms} ms; the driver sets it up again; check its trigger and cable if this \
         persists"
    )]
    Silent { device: Arc<str>, limit_ms: u32 },
    /// The device sends samples that are all refused.
    #[error(
        "IMU {device}: no usable sample for more than {limit_ms} ms; the last one was dropped because {refusal}"
    )]
    Refused { device: Arc<str>, limit_ms: u32, refusal: Refusal },
}

impl hal::Error for ImuError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Absent { .. } | Self::Gone { .. } => ErrorKind::Disconnected,
            Self::Silent { .. } | Self::Refused { .. } => ErrorKind::Timeout,
            Self::Denied { .. } | Self::SocketDenied { .. } | Self::Busy { .. } => {
                ErrorKind::Rejected
            }
            Self::Config { .. } | Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::Thread { .. } | Self::Attribute { .. } => ErrorKind::Other,
        }
    }
}

/// Why no sample can be returned now. Making one does not allocate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ImuPollError {
    /// The unit is absent or may not be opened, or its first sample has not arrived yet.
    #[error(
        "IMU {device}: not connected; the driver keeps trying to open it, and its problem text names the reason"
    )]
    Disconnected { device: Arc<str> },
    /// No sample arrived within the time-out.
    #[error(
        "IMU {device}: no sample for more than {limit_ms} ms; check its trigger and cable, the driver keeps listening"
    )]
    Silent { device: Arc<str>, limit_ms: u32 },
    /// The unit cannot be what is configured.
    #[error(
        "IMU {device}: it cannot be what is configured; the driver's problem text names the reason and the remedy"
    )]
    Unsupported { device: Arc<str> },
}

impl hal::Error for ImuPollError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Disconnected { .. } => ErrorKind::Disconnected,
            Self::Silent { .. } => ErrorKind::Timeout,
            Self::Unsupported { .. } => ErrorKind::Unsupported,
        }
    }
}
