//! What can be wrong with a camera.

use std::sync::Arc;

use hal::ErrorKind;
use rustix::io::Errno;

use super::node::FourCc;

/// Why there is no picture. Cheap to clone: it is given at every poll until there is one again.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum V4l2Error {
    /// The configuration asks for what no camera can do.
    #[error("camera configuration: {field} = {value}; {way_out}")]
    Config {
        /// The field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        way_out: &'static str,
    },
    /// The pictures and the lens model have different sizes.
    #[error("the camera's pictures are {}x{}, its lens model is for {}x{}; calibrate at the size that is used", .pictures.0, .pictures.1, .model.0, .model.1)]
    Model {
        /// Configured width and height.
        pictures: (u32, u32),
        /// The model's.
        model: (usize, usize),
    },
    /// Nothing there.
    #[error(
        "no camera at {device} ({errno}); plug it in, or find its name with `ls /dev/v4l/by-id`"
    )]
    NotThere {
        /// The configured device.
        device: Arc<str>,
        /// What opening it said.
        errno: Errno,
    },
    /// Not ours to open.
    #[error("no permission for {device}; add the user to the group `video`")]
    Denied {
        /// The configured device.
        device: Arc<str>,
    },
    /// Somebody else streams from it.
    #[error("{device} is used by another program; `fuser -v {device}` tells which")]
    Busy {
        /// The configured device.
        device: Arc<str>,
    },
    /// Something else than a camera.
    #[error(
        "{device} hands out no pictures to map; a camera has several nodes, the first is usually the right one"
    )]
    NotACamera {
        /// The configured device.
        device: Arc<str>,
    },
    /// The camera has not got this format.
    #[error("{device} has no {asked}; configure one of {offered}")]
    Format {
        /// The configured device.
        device: Arc<str>,
        /// The format.
        asked: FourCc,
        /// Those that it has.
        offered: String,
    },
    /// The camera makes something else of the size and format.
    #[error(
        "{device} makes {got} of {asked}; configure what it can: `v4l2-ctl -d {device} --list-formats-ext`"
    )]
    Layout {
        /// The configured device.
        device: Arc<str>,
        /// Size and format that are configured.
        asked: String,
        /// Size and format that it gives.
        got: String,
    },
    /// The camera has another frame rate.
    #[error(
        "{device} gives {got_fps:.2} pictures a second, {asked_fps:.2} are configured; with longer exposure or larger pictures it may be slower"
    )]
    Rate {
        /// The configured device.
        device: Arc<str>,
        /// Configured.
        asked_fps: f64,
        /// What it gives.
        got_fps: f64,
    },
    /// A control cannot be set so.
    #[error("{device}: {control} cannot be {value}: {why}")]
    Control {
        /// The configured device.
        device: Arc<str>,
        /// The control.
        control: &'static str,
        /// The wish.
        value: String,
        /// What stands against it, and what can be.
        why: String,
    },
    /// Time stamps that cannot be compared with anything else.
    #[error(
        "{device} does not stamp on the monotonic clock; for USB cameras: `modprobe uvcvideo clock=CLOCK_MONOTONIC`"
    )]
    Clock {
        /// The configured device.
        device: Arc<str>,
    },
    /// Open, and silent.
    #[error(
        "{device} is silent for {silent_ms} ms; the driver restarts it by itself; check the cable if this stays"
    )]
    Silent {
        /// The configured device.
        device: Arc<str>,
        /// Since the last picture, or since the start.
        silent_ms: u64,
    },
    /// It went away or failed while it was streaming.
    #[error("{device} stopped ({errno}); the driver opens it again by itself")]
    Lost {
        /// The configured device.
        device: Arc<str>,
        /// What it said.
        errno: Errno,
    },
    /// The kernel refuses something else.
    #[error("{device}: {step} failed ({errno}); the kernel's log may say more: `dmesg`")]
    System {
        /// The configured device.
        device: Arc<str>,
        /// What was tried.
        step: &'static str,
        /// What the kernel said.
        errno: Errno,
    },
}

impl V4l2Error {
    /// What an error number means when a device is opened or set up.
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
