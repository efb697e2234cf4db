//! Errors of cameras.

use std::sync::Arc;

use hal::ErrorKind;
use rustix::io::Errno;

use super::node::FourCc;

/// Why there is no frame. Cheap to clone, because every poll returns it until frames arrive again.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum V4l2Error {
    /// A value in the configuration is invalid for every camera.
    #[error("camera configuration: {field} = {value}; {way_out}")]
    Config { field: &'static str, value: String, way_out: &'static str },
    /// The frames and the lens model have different sizes.
    #[error("the camera's frames are {}x{}, but its lens model is for {}x{}; calibrate at the \
        size that is used", .frames.0, .frames.1, .model.0, .model.1)]
    Model { frames: (u32, u32), model: (usize, usize) },
    /// The device does not exist.
    #[error(
        "no camera at {device} ({errno}); plug it in, or find its name with `ls /dev/v4l/by-id`"
    )]
    NotThere { device: Arc<str>, errno: Errno },
    /// The process has no permission to open the device.
    #[error("no permission for {device}; add the user to the group `video`")]
    Denied { device: Arc<str> },
    /// Another process streams from the device.
    #[error("{device} is used by another program; `fuser -v {device}` shows which")]
    Busy { device: Arc<str> },
    /// The device is not a camera.
    #[error(
        "{device} does not support streaming capture; a camera has several nodes, the first is \
         usually the right one"
    )]
    NotACamera { device: Arc<str> },
    /// The camera does not offer the configured format.
    #[error("{device} has no {asked}; configure one of {offered}")]
    Format { device: Arc<str>, asked: FourCc, offered: String },
    /// The camera does not offer the configured size in this format.
    #[error(
        "{device} makes {got} of {asked}; configure what it can: `v4l2-ctl -d {device} \
         --list-formats-ext`"
    )]
    Layout { device: Arc<str>, asked: String, got: String },
    /// The camera does not offer the configured frame rate.
    #[error(
        "{device} gives {got_fps:.2} frames per second, {asked_fps:.2} are configured; a longer \
         exposure or larger frames may make it slower"
    )]
    Rate { device: Arc<str>, asked_fps: f64, got_fps: f64 },
    /// A control does not accept the configured value.
    #[error("{device}: {control} cannot be {value}: {why}")]
    Control { device: Arc<str>, control: &'static str, value: String, why: String },
    /// The camera's timestamps are not of the monotonic clock, so they cannot be compared with
    /// other times.
    #[error(
        "{device} does not use the monotonic clock for its timestamps; for USB cameras: \
         `modprobe uvcvideo clock=CLOCK_MONOTONIC`"
    )]
    Clock { device: Arc<str> },
    /// The camera is open but sends no frames.
    #[error(
        "{device} has sent no frame for {silent_ms} ms; the driver restarts it automatically; \
         check the cable if this persists"
    )]
    Silent {
        device: Arc<str>,
        /// Time since the last frame, or since the start of the stream.
        silent_ms: u64,
    },
    /// The camera was unplugged or failed while streaming.
    #[error("{device} stopped ({errno}); the driver reopens it automatically")]
    Lost { device: Arc<str>, errno: Errno },
    /// Any other system call failed.
    #[error("{device}: {step} failed ({errno}); the kernel's log may show the reason: `dmesg`")]
    System { device: Arc<str>, step: &'static str, errno: Errno },
}

impl V4l2Error {
    /// Converts an error number of opening or setting up a device.
    pub(super) fn setup(device: &Arc<str>, step: &'static str, errno: Errno) -> Self {
        let device = device.clone();
        match errno {
            Errno::NOENT | Errno::NODEV | Errno::NXIO | Errno::CONNREFUSED => {
                Self::NotThere { device, errno }
            }
            Errno::ACCESS | Errno::PERM => Self::Denied { device },
            Errno::BUSY => Self::Busy { device },
            Errno::NOTTY => Self::NotACamera { device },
            errno => Self::System { device, step, errno },
        }
    }
}

impl hal::Error for V4l2Error {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NotThere { .. } => ErrorKind::Disconnected,
            Self::Lost { errno, .. } if *errno == Errno::NODEV => ErrorKind::Disconnected,
            Self::Lost { .. } => ErrorKind::Fault,
            Self::Silent { .. } => ErrorKind::Timeout,
            Self::Denied { .. } | Self::Busy { .. } => ErrorKind::Rejected,
            Self::Config { .. }
            | Self::Model { .. }
            | Self::NotACamera { .. }
            | Self::Format { .. }
            | Self::Layout { .. }
            | Self::Rate { .. }
            | Self::Control { .. }
            | Self::Clock { .. } => ErrorKind::Unsupported,
            Self::System { .. } => ErrorKind::Other,
        }
    }
}
