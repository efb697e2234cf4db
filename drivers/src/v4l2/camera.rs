//! The V4L2 camera behind [`hal::Camera`], and its worker thread.

use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use hal::{Camera, CameraModel, ErrorType, Frame};
use rustix::io::Errno;

use super::capture::{BorrowedFrame, Capture, Job, Opener};
use super::config::{CameraDeviceConfig, CameraFormat};
use super::error::V4l2Error;
use super::node::{Control, FourCc, Interval, Layout, VideoNode, controls, formats};
use super::remote::RemoteNode;
use super::stream::Stream;
use super::sys::KernelNode;
use crate::DeviceStatus;
use monotonic_clock::monotonic_ns;

/// A V4L2 camera.
///
/// Polling for a frame runs in the caller's thread and never blocks. Opening, restarting and
/// closing the camera may block, and run in a thread of the driver.
pub struct V4l2Camera {
    capture: Capture,
    model: CameraModel,
    jobs: SyncSender<Job>,
    results: Receiver<Result<Box<Stream>, V4l2Error>>,
}

impl V4l2Camera {
    /// Starts the driver. It opens the camera automatically, now or when it is plugged in.
    ///
    /// # Errors
    /// When the configuration is invalid, or the lens model is for another image size.
    pub fn new(config: &CameraDeviceConfig, model: CameraModel) -> Result<Self, V4l2Error> {
        let device = config.clone();
        Self::with_opener(config, model, Box::new(move || open(&device)))
    }

    /// As [`new`](Self::new), with another function that opens the camera, for tests and simulated
    /// cameras.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_opener(
        config: &CameraDeviceConfig,
        model: CameraModel,
        open: Opener,
    ) -> Result<Self, V4l2Error> {
        if (model.width, model.height) != (config.width as usize, config.height as usize) {
            let frames = (config.width, config.height);
            return Err(V4l2Error::Model { frames, model: (model.width, model.height) });
        }
        let capture = Capture::new(config)?;
        let (jobs, queue) = sync_channel(1);
        let (finished, results) = sync_channel(1);
        let config = config.clone();
        std::thread::Builder::new()
            .name("camera".to_owned())
            .spawn(move || run_jobs(open, &config, &queue, &finished))
            .map_err(|error| V4l2Error::System {
                device: "camera".into(),
                step: "starting its thread",
                errno: error.raw_os_error().map_or(Errno::AGAIN, Errno::from_raw_os_error),
            })?;
        Ok(Self { capture, model, jobs, results })
    }

    /// Calls `inspect` with the newest frame, in the camera's own memory. Returns `None` when there
    /// is no frame that was not inspected before.
    ///
    /// # Errors
    /// As [`Camera::poll_frame`].
    pub fn with_newest<R>(
        &mut self,
        inspect: impl FnOnce(&BorrowedFrame<'_>) -> R,
    ) -> Result<Option<R>, V4l2Error> {
        let now_ns = monotonic_ns();
        if let Ok(result) = self.results.try_recv() {
            self.capture.finish_job(result, now_ns);
        }
        let inspected = self.capture.with_newest(now_ns, inspect);
        if let Some(job) = self.capture.take_job(now_ns) {
            // The channel has capacity, because a job is taken only after the previous one has
            // finished.
            _ = self.jobs.try_send(job);
        }
        inspected
    }

    /// The camera's state and counts; see [`Capture::status`].
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.capture.status()
    }

    /// The number of frames that were skipped because a newer one had arrived.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.capture.skipped()
    }

    /// Exports each of the camera's buffers as a dma-buf, in the order of
    /// [`BorrowedFrame::buffer`], for a device that reads frames without the processor. A buffer
    /// holds its frame only within [`with_newest`](Self::with_newest). After the camera was
    /// reopened ([`DeviceStatus::reopened`]), the buffers must be exported again.
    ///
    /// # Errors
    /// When the camera is not open, or its driver cannot export.
    pub fn export_buffers(&mut self) -> Result<Vec<OwnedFd>, V4l2Error> {
        let device = self.capture.device();
        self.capture
            .stream()
            .ok_or(Errno::NODEV)
            .and_then(Stream::export)
            .map_err(|errno| V4l2Error::System { device, step: "exporting its buffers", errno })
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
        let copied = self.with_newest(|newest| {
            frame.time_ns = newest.time_ns;
            frame.sequence = newest.sequence;
            frame.width = newest.view.width();
            frame.height = newest.view.height();
            frame.format = newest.view.format();
            frame.data.clear();
            frame.data.extend_from_slice(newest.view.data());
        })?;
        Ok(copied.is_some())
    }
}

/// The worker thread. It ends when its camera is dropped.
fn run_jobs(
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

/// Opens a device of the kernel, or a simulated one.
///
/// # Errors
/// The error number of the kernel.
pub fn open(config: &CameraDeviceConfig) -> Result<Box<dyn VideoNode>, Errno> {
    Ok(match config.socket() {
        Some(path) => Box::new(RemoteNode::open(path)?),
        None => Box::new(KernelNode::open(Path::new(&config.device))?),
    })
}

/// What a camera offers, without starting it.
#[derive(Debug, Clone, PartialEq)]
pub struct Offer {
    /// Every pixel format that the camera offers.
    pub formats: Vec<FourCc>,
    /// The first of these that the driver reads; `None` if there is none.
    pub format: Option<CameraFormat>,
    /// The size of its frames that is nearest to the wanted one, in this format.
    pub size: (u32, u32),
    /// Frames per second at this size, if the camera knows them.
    pub fps: Option<f64>,
}

/// Asks a camera what it offers instead of frames of a size. It does not start. Blocks for as long as the camera takes to open.
///
/// # Errors
/// When it cannot be opened, or is not a camera.
pub fn offer(config: &CameraDeviceConfig) -> Result<Offer, V4l2Error> {
    let device: Arc<str> = config.device.as_str().into();
    let mut node = open(config).map_err(|errno| V4l2Error::setup(&device, "opening it", errno))?;
    let capability = node
        .capability()
        .map_err(|errno| V4l2Error::setup(&device, "querying its capabilities", errno))?;
    if !capability.is_camera() {
        return Err(V4l2Error::NotACamera { device });
    }
    let formats = formats(node.as_mut())
        .map_err(|errno| V4l2Error::setup(&device, "listing its formats", errno))?;
    let readable = CameraFormat::ALL.into_iter().find_map(|format| {
        let code = format.names().iter().find(|code| formats.contains(code))?;
        Some((format, *code))
    });
    let width = config.width;
    let height = config.height;
    let Some((format, code)) = readable else {
        return Ok(Offer { formats, format: None, size: (width, height), fps: None });
    };
    let wanted = Layout { width, height, format: code, stride: 0, size: 0, planes: 1 };
    let got = node
        .set_layout(wanted)
        .map_err(|errno| V4l2Error::setup(&device, "setting its format", errno))?;
    let interval_ns = node.interval(None).ok().and_then(Interval::ns);
    let fps = interval_ns.map(|ns| 1e9 / ns as f64);
    Ok(Offer { formats, format: Some(format), size: (got.width, got.height), fps })
}

/// What was negotiated with a camera, for `check`.
#[derive(Debug, Clone, PartialEq)]
pub struct Negotiated {
    pub layout: Layout,
    /// Time between two frames.
    pub interval_ns: u64,
    /// Every pixel format that the camera offers.
    pub formats: Vec<FourCc>,
    /// Every control of the camera.
    pub controls: Vec<Control>,
}

/// Opens a camera, starts it, and closes it again. Blocks for as long as the camera takes.
///
/// # Errors
/// Those that the driver would report.
pub fn check(config: &CameraDeviceConfig) -> Result<Negotiated, V4l2Error> {
    config.check()?;
    let mut opener: Opener = {
        let config = config.clone();
        Box::new(move || open(&config))
    };
    let mut stream = Job::Open.run(&mut opener, config)?;
    let layout = stream.layout();
    let interval_ns = stream.interval_ns();
    let formats = formats(stream.node()).unwrap_or_default();
    let controls = controls(stream.node()).unwrap_or_default();
    Ok(Negotiated { layout, interval_ns, formats, controls })
}
