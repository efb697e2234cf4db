//! The camera as the rest of the robot sees it.

use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use hal::{Camera, CameraModel, ErrorType, Frame};
use rustix::io::Errno;

use super::capture::{Capture, Job, Opener, Picture};
use super::config::CameraDeviceConfig;
use super::error::V4l2Error;
use super::node::{Control, FourCc, Layout, VideoNode, controls, formats};
use super::remote::RemoteNode;
use super::stream::Stream;
use super::sys::KernelNode;
use crate::DeviceStatus;
use monotonic_clock::monotonic_ns;

/// A V4L2 camera.
///
/// Looking for a picture happens in the caller's thread and never waits; opening, restarting and closing the camera takes
/// as long as it takes, in a thread of the driver's own.
pub struct V4l2Camera {
    capture: Capture,
    model: CameraModel,
    jobs: SyncSender<Job>,
    results: Receiver<Result<Box<Stream>, V4l2Error>>,
}

impl V4l2Camera {
    /// A camera that is opened by itself, now or when it is plugged in.
    ///
    /// # Errors
    /// When the configuration cannot be, or the lens model is for another size.
    pub fn new(config: &CameraDeviceConfig, model: CameraModel) -> Result<Self, V4l2Error> {
        let device = config.clone();
        Self::with_opener(config, model, Box::new(move || open(&device)))
    }

    /// As [`new`](Self::new) for a camera that is opened in another way.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_opener(
        config: &CameraDeviceConfig,
        model: CameraModel,
        open: Opener,
    ) -> Result<Self, V4l2Error> {
        if (model.width, model.height) != (config.width as usize, config.height as usize) {
            let pictures = (config.width, config.height);
            return Err(V4l2Error::Model { pictures, model: (model.width, model.height) });
        }
        let capture = Capture::new(config)?;
        let (jobs, to_do) = sync_channel(1);
        let (finished, results) = sync_channel(1);
        let config = config.clone();
        std::thread::Builder::new()
            .name("camera".to_owned())
            .spawn(move || work(open, &config, &to_do, &finished))
            .map_err(|error| V4l2Error::System {
                device: "camera".into(),
                step: "starting its thread",
                errno: error.raw_os_error().map_or(Errno::AGAIN, Errno::from_raw_os_error),
            })?;
        Ok(Self { capture, model, jobs, results })
    }

    /// Lends the newest picture that nobody has seen, in the camera's own memory; `None` when there is none.
    ///
    /// # Errors
    /// As [`Camera::poll_frame`].
    pub fn with_newest<R>(
        &mut self,
        look: impl FnOnce(&Picture<'_>) -> R,
    ) -> Result<Option<R>, V4l2Error> {
        let now_ns = monotonic_ns();
        if let Ok(result) = self.results.try_recv() {
            self.capture.done(result, now_ns);
        }
        let seen = self.capture.with_newest(now_ns, look);
        if let Some(job) = self.capture.job(now_ns) {
            // There is room: a job is handed out only when the one before has come back.
            _ = self.jobs.try_send(job);
        }
        seen
    }

    /// State and counts; see [`Capture::status`].
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.capture.status()
    }

    /// Pictures that were skipped for newer ones.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.capture.skipped()
    }

    /// Each of the camera's buffers as a dma-buf, in the order of [`Picture::buffer`], for a device that reads pictures
    /// without the processor. A buffer holds its picture only within [`with_newest`](Self::with_newest), and after the
    /// camera was opened again ([`DeviceStatus::reopened`]) they must be exported again.
    ///
    /// # Errors
    /// When the camera is not open, or its driver cannot export.
    pub fn export_buffers(&mut self) -> Result<Vec<OwnedFd>, V4l2Error> {
        let device = self.capture.device();
        let failed = |errno| V4l2Error::System { device, step: "exporting its buffers", errno };
        self.capture.stream().ok_or(Errno::NODEV).and_then(Stream::export).map_err(failed)
    }
}

impl ErrorType for V4l2Camera {
    type Error = V4l2Error;
}

impl Camera for V4l2Camera {
    fn model(&self) -> &CameraModel {
        &self.model
    }

    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, V4l2Error> {
        let copied = self.with_newest(|picture| {
            frame.time_ns = picture.time_ns;
            frame.sequence = picture.sequence;
            frame.width = picture.view.width();
            frame.height = picture.view.height();
            frame.format = picture.view.format();
            frame.data.clear();
            frame.data.extend_from_slice(picture.view.data());
        })?;
        Ok(copied.is_some())
    }
}

/// Ends when the camera that it works for is dropped.
fn work(
    mut open: Opener,
    config: &CameraDeviceConfig,
    jobs: &Receiver<Job>,
    finished: &SyncSender<Result<Box<Stream>, V4l2Error>>,
) {
    while let Ok(job) = jobs.recv() {
        if finished.send(job.run(&mut open, config)).is_err() {
            return;
        }
    }
}

/// Opens a device of the kernel's or a simulated one.
///
/// # Errors
/// The kernel's error number.
pub fn open(config: &CameraDeviceConfig) -> Result<Box<dyn VideoNode>, Errno> {
    Ok(match config.socket() {
        Some(path) => Box::new(RemoteNode::open(path)?),
        None => Box::new(KernelNode::open(Path::new(&config.device))?),
    })
}

/// What a camera agrees to, for `check`.
#[derive(Debug, Clone, PartialEq)]
pub struct Agreement {
    /// Size and format.
    pub layout: Layout,
    /// Time between two pictures, nanoseconds.
    pub interval_ns: u64,
    /// Every pixel format that it has.
    pub formats: Vec<FourCc>,
    /// Everything that can be set.
    pub controls: Vec<Control>,
}

/// Opens a camera, starts it, and lets it go again. Takes as long as the camera takes.
///
/// # Errors
/// As the driver would report.
pub fn check(config: &CameraDeviceConfig) -> Result<Agreement, V4l2Error> {
    config.check()?;
    let mut opener: Opener = {
        let config = config.clone();
        Box::new(move || open(&config))
    };
    let mut stream = Job::Open.run(&mut opener, config)?;
    let (layout, interval_ns) = (stream.layout(), stream.interval_ns());
    let formats = formats(stream.node()).unwrap_or_default();
    let controls = controls(stream.node()).unwrap_or_default();
    Ok(Agreement { layout, interval_ns, formats, controls })
}
