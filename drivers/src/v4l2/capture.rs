//! A camera that can be unplugged and reopened, as a state machine without a clock and without
//! threads: the caller passes in the time, and runs the operations that block as [`Job`]s.

use std::sync::Arc;

use hal::{Error, ErrorKind, ImageView};
use rustix::io::Errno;

use super::config::CameraDeviceConfig;
use super::error::V4l2Error;
use super::node::VideoNode;
use super::stream::Stream;
use crate::{DeviceState, DeviceStatus};

/// Delay before the camera is opened again: the first value, doubled after each failure up to the
/// second.
const BACKOFF_NS: (u64, u64) = (100_000_000, 2_000_000_000);
/// Time-out for the first frame. A silent camera is restarted after the same time.
const RESTART_AFTER_NS: u64 = 1_000_000_000;

/// An operation that blocks. The caller runs it on another thread, and passes the result to
/// [`Capture::finish_job`].
pub enum Job {
    /// Open the camera and start it.
    Open,
    /// Stop the stream and start it again. Close the camera if that fails.
    Restart(Box<Stream>),
    /// Close the camera, for this reason.
    Close(Box<Stream>, V4l2Error),
}

/// The function that opens a camera.
pub type Opener = Box<dyn FnMut() -> Result<Box<dyn VideoNode>, Errno> + Send>;

impl Job {
    /// Runs the job. Blocks for as long as the camera takes.
    ///
    /// # Errors
    /// When there is no camera, or it does not support the configuration.
    pub fn run(
        self,
        open: &mut Opener,
        config: &CameraDeviceConfig,
    ) -> Result<Box<Stream>, V4l2Error> {
        let device: Arc<str> = config.device.as_str().into();
        match self {
            Self::Open => {
                let node =
                    open().map_err(|errno| V4l2Error::setup(&device, "opening it", errno))?;
                Ok(Box::new(Stream::start(node, config)?))
            }
            Self::Restart(mut stream) => match stream.restart() {
                Ok(()) => Ok(stream),
                Err(errno) => Err(V4l2Error::Lost { device, errno }),
            },
            Self::Close(stream, reason) => {
                drop(stream);
                Err(reason)
            }
        }
    }
}

/// A frame in the camera's own memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BorrowedFrame<'a> {
    /// Middle of the exposure on the monotonic clock: the kernel's timestamp, corrected by the
    /// configured exposure and latency.
    pub time_ns: u64,
    /// Frame counter that continues over restarts. A gap means that frames were lost or skipped.
    pub sequence: u32,
    /// Index of the frame's buffer, for users of exported buffers.
    pub buffer: u32,
    pub view: ImageView<'a>,
}

/// The connection to the camera.
enum Link {
    /// Closed. It may be opened from this time on.
    Closed { retry_ns: u64 },
    /// Failed. The next job restarts or closes it.
    Broken { stream: Box<Stream>, reason: V4l2Error, restart: bool },
    /// The caller runs a job that it took at this time.
    Pending { since_ns: u64 },
    /// Streaming. `last_frame_ns` is the arrival time of the last whole frame, or the start of the
    /// stream.
    Streaming { stream: Box<Stream>, last_frame_ns: u64, had_frame: bool },
}

/// The state machine of one camera.
pub struct Capture {
    device: Arc<str>,
    max_age_ns: u64,
    link: Link,
    backoff_ns: u64,
    restarted: bool,
    error: Option<V4l2Error>,
    /// The number of the last frame, and that of the last frame before this stream.
    sequence: u32,
    sequence_before: u32,
    skipped: u64,
    status: DeviceStatus,
}

impl Capture {
    /// A camera that is not open yet.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &CameraDeviceConfig) -> Result<Self, V4l2Error> {
        config.check()?;
        Ok(Self {
            device: config.device.as_str().into(),
            max_age_ns: u64::from(config.max_age_ms) * 1_000_000,
            link: Link::Closed { retry_ns: 0 },
            backoff_ns: BACKOFF_NS.0,
            restarted: false,
            error: None,
            sequence: 0,
            sequence_before: 0,
            skipped: 0,
            status: DeviceStatus::default(),
        })
    }

    /// The camera's state and counts. `lost` counts the frames that never arrived according to the
    /// camera's own counter, without the frames that were skipped for newer ones. `bad` counts
    /// damaged and outdated frames. `reopened` includes restarts of the stream.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.status
    }

    /// The configured device path, for messages.
    #[must_use]
    pub fn device(&self) -> Arc<str> {
        self.device.clone()
    }

    /// The number of frames that were skipped because a newer one had arrived.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The stream, if the camera is streaming.
    pub fn stream(&mut self) -> Option<&mut Stream> {
        match &mut self.link {
            Link::Streaming { stream, .. } => Some(stream),
            _ => None,
        }
    }

    /// Returns the job that is due now. The caller must run it and pass its result to
    /// [`finish_job`](Self::finish_job).
    pub fn take_job(&mut self, now_ns: u64) -> Option<Job> {
        match std::mem::replace(&mut self.link, Link::Pending { since_ns: now_ns }) {
            Link::Broken { stream, restart: true, .. } => Some(Job::Restart(stream)),
            Link::Broken { stream, reason, .. } => Some(Job::Close(stream, reason)),
            Link::Closed { retry_ns } if retry_ns <= now_ns => Some(Job::Open),
            other => {
                self.link = other;
                None
            }
        }
    }

    /// Processes the result of a job.
    pub fn finish_job(&mut self, result: Result<Box<Stream>, V4l2Error>, now_ns: u64) {
        match result {
            Ok(stream) => {
                if self.error.take().is_some() {
                    self.status.reopened += 1;
                }
                self.status.state = DeviceState::Starting;
                self.sequence_before = self.sequence;
                self.link = Link::Streaming { stream, last_frame_ns: now_ns, had_frame: false };
            }
            Err(error) => {
                self.set_error(error);
                self.link = Link::Closed { retry_ns: now_ns.saturating_add(self.backoff_ns) };
                self.backoff_ns = (2 * self.backoff_ns).min(BACKOFF_NS.1);
            }
        }
    }

    /// Calls `inspect` with the newest frame, without copying it. Returns `None` when there is no
    /// frame that was not inspected before.
    ///
    /// # Errors
    /// [`Timeout`](ErrorKind::Timeout) after two frame intervals without a frame,
    /// [`Disconnected`](ErrorKind::Disconnected) while the camera is absent, or another reason why
    /// there are no frames.
    pub fn with_newest<R>(
        &mut self,
        now_ns: u64,
        inspect: impl FnOnce(&BorrowedFrame<'_>) -> R,
    ) -> Result<Option<R>, V4l2Error> {
        let Link::Streaming { stream, last_frame_ns, had_frame } = &mut self.link else {
            return self.absent(now_ns);
        };
        let drained = match stream.newest() {
            Ok(drained) => drained,
            Err(errno) => return Err(self.fail(errno)),
        };
        self.status.lost += drained.lost;
        self.status.bad += drained.damaged;
        self.skipped += drained.skipped;
        let Some(taken) = drained.newest else {
            let silent_ns = now_ns.saturating_sub(*last_frame_ns);
            let allowed_ns = if *had_frame { 2 * stream.interval_ns() } else { RESTART_AFTER_NS };
            return if silent_ns > allowed_ns { Err(self.on_silence(silent_ns)) } else { Ok(None) };
        };
        // An outdated frame counts too: the caller did not poll in time, but the camera works.
        *last_frame_ns = now_ns;
        *had_frame = true;
        self.sequence = self.sequence_before.wrapping_add(taken.position);
        if taken.time_ns > now_ns.saturating_add(self.max_age_ns) {
            return Err(self.fail(Errno::PROTO));
        }
        let fresh = now_ns.saturating_sub(taken.time_ns) <= self.max_age_ns;
        let inspected = match stream.view(&taken) {
            Ok(view) if fresh => Some(inspect(&BorrowedFrame {
                time_ns: taken.time_ns,
                sequence: self.sequence,
                buffer: taken.index,
                view,
            })),
            _ => None,
        };
        let returned = stream.give_back(taken);
        if inspected.is_some() {
            self.status.good += 1;
            self.status.state = DeviceState::Working;
            self.status.last_good_ns = taken.time_ns;
            self.backoff_ns = BACKOFF_NS.0;
            self.restarted = false;
        } else {
            self.status.bad += 1;
        }
        if let Err(errno) = returned {
            // The frame was good; the next poll reports the error.
            self.fail(errno);
        }
        Ok(inspected)
    }

    fn absent<R>(&mut self, now_ns: u64) -> Result<Option<R>, V4l2Error> {
        match (&self.error, &self.link) {
            (Some(error), _) => Err(error.clone()),
            (None, Link::Pending { since_ns })
                if now_ns.saturating_sub(*since_ns) > RESTART_AFTER_NS =>
            {
                Err(self.report_silence(now_ns.saturating_sub(*since_ns)))
            }
            (None, _) => Ok(None),
        }
    }

    fn report_silence(&mut self, silent_ns: u64) -> V4l2Error {
        self.status.state = DeviceState::Silent;
        V4l2Error::Silent { device: self.device.clone(), silent_ms: silent_ns / 1_000_000 }
    }

    /// Reports the silence. After a longer silence the camera is restarted, and closed if it was
    /// restarted before.
    fn on_silence(&mut self, silent_ns: u64) -> V4l2Error {
        let error = self.report_silence(silent_ns);
        if silent_ns > RESTART_AFTER_NS {
            self.give_up(error.clone(), true);
        }
        error
    }

    fn fail(&mut self, errno: Errno) -> V4l2Error {
        let device = self.device.clone();
        let error = if errno == Errno::PROTO {
            V4l2Error::Clock { device }
        } else {
            V4l2Error::Lost { device, errno }
        };
        self.give_up(error.clone(), !matches!(errno, Errno::NODEV | Errno::PROTO));
        error
    }

    /// Restarts the stream if that may help and was not tried since the last frame. Otherwise
    /// closes the camera.
    fn give_up(&mut self, error: V4l2Error, may_help: bool) {
        let restart = may_help && !self.restarted;
        self.restarted = true;
        self.set_error(error.clone());
        match std::mem::replace(&mut self.link, Link::Closed { retry_ns: 0 }) {
            Link::Streaming { stream, .. } => {
                self.link = Link::Broken { stream, reason: error, restart }
            }
            other => self.link = other,
        }
    }

    fn set_error(&mut self, error: V4l2Error) {
        self.status.state = match error.kind() {
            ErrorKind::Disconnected => DeviceState::Disconnected,
            ErrorKind::Timeout => DeviceState::Silent,
            _ => DeviceState::Faulty,
        };
        self.error = Some(error);
    }
}
