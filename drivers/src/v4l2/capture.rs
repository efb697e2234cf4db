//! A camera that comes and goes, without a clock and without threads: time is told, and what takes long is handed out as a
//! [`Job`] for somebody else to run.

use std::sync::Arc;

use hal::{Error, ErrorKind, ImageView};
use rustix::io::Errno;

use super::config::CameraDeviceConfig;
use super::error::V4l2Error;
use super::node::VideoNode;
use super::stream::Stream;
use crate::{DeviceState, DeviceStatus};

/// Waits before an attempt: the first, doubled after each that fails, up to the second.
const BACKOFF_NS: (u64, u64) = (100_000_000, 2_000_000_000);
/// A camera may take this long for its first picture, and a silent one is restarted after it.
const PATIENCE_NS: u64 = 1_000_000_000;

/// What takes long: run it on another thread, and give the result to [`Capture::done`].
pub enum Job {
    /// Open the camera and start it.
    Open,
    /// Stop the stream and start it again. On failure, close the camera.
    Restart(Box<Stream>),
    /// Close the camera, for this reason.
    Close(Box<Stream>, V4l2Error),
}

/// How a camera is opened.
pub type Opener = Box<dyn FnMut() -> Result<Box<dyn VideoNode>, Errno> + Send>;

impl Job {
    /// Does it. Takes as long as the camera takes.
    ///
    /// # Errors
    /// When there is no camera, or not one that can do what is configured.
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

/// A picture in the camera's own memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Picture<'a> {
    /// Middle of the exposure, monotonic: the kernel's stamp, less what the configured exposure and latency explain.
    pub time_ns: u64,
    /// Counts on over restarts; a gap is pictures that were lost or skipped.
    pub sequence: u32,
    /// Which buffer it is in, for users of exported buffers.
    pub buffer: u32,
    /// The picture.
    pub view: ImageView<'a>,
}

enum Link {
    /// Nobody tries to open it before this time.
    Closed { retry_ns: u64 },
    /// To be restarted or closed as soon as somebody asks for work.
    Broken { stream: Box<Stream>, reason: V4l2Error, restart: bool },
    /// Somebody runs the job that was handed out at this time.
    Pending { since_ns: u64 },
    /// Delivers, or should. `heard_ns` is when a whole picture last came, or when it was started.
    Streaming { stream: Box<Stream>, heard_ns: u64, had_picture: bool },
}

/// The camera.
pub struct Capture {
    device: Arc<str>,
    max_age_ns: u64,
    link: Link,
    backoff_ns: u64,
    restarted: bool,
    error: Option<V4l2Error>,
    /// The last picture's number, and the last one's before this stream.
    sequence: u32,
    before: u32,
    skipped: u64,
    status: DeviceStatus,
}

impl Capture {
    /// A camera that is still to be opened.
    ///
    /// # Errors
    /// When the configuration cannot be.
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
            before: 0,
            skipped: 0,
            status: DeviceStatus::default(),
        })
    }

    /// State and counts. `lost` are pictures that the camera counted and that never came; pictures that were skipped for
    /// newer ones are not among them. `bad` were damaged or too old. `reopened` counts restarts of the stream as well.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.status
    }

    /// The configured device, for messages.
    #[must_use]
    pub fn device(&self) -> Arc<str> {
        self.device.clone()
    }

    /// Pictures that were skipped for newer ones.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The stream while there is one.
    pub fn stream(&mut self) -> Option<&mut Stream> {
        match &mut self.link {
            Link::Streaming { stream, .. } => Some(stream),
            _ => None,
        }
    }

    /// What has to be done now, once.
    pub fn job(&mut self, now_ns: u64) -> Option<Job> {
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

    /// What became of the job.
    pub fn done(&mut self, result: Result<Box<Stream>, V4l2Error>, now_ns: u64) {
        match result {
            Ok(stream) => {
                if self.error.take().is_some() {
                    self.status.reopened += 1;
                }
                self.status.state = DeviceState::Starting;
                self.before = self.sequence;
                self.link = Link::Streaming { stream, heard_ns: now_ns, had_picture: false };
            }
            Err(error) => {
                self.set_error(error);
                self.link = Link::Closed { retry_ns: now_ns.saturating_add(self.backoff_ns) };
                self.backoff_ns = (2 * self.backoff_ns).min(BACKOFF_NS.1);
            }
        }
    }

    /// Lends the newest picture that nobody has seen, without a copy; `None` when there is none.
    ///
    /// # Errors
    /// [`Timeout`](ErrorKind::Timeout) after two frame intervals of silence, [`Disconnected`](ErrorKind::Disconnected) while
    /// it is not there, or what else keeps it from delivering.
    pub fn with_newest<R>(
        &mut self,
        now_ns: u64,
        look: impl FnOnce(&Picture<'_>) -> R,
    ) -> Result<Option<R>, V4l2Error> {
        let Link::Streaming { stream, heard_ns, had_picture } = &mut self.link else {
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
            let silent_ns = now_ns.saturating_sub(*heard_ns);
            let allowed_ns = if *had_picture { 2 * stream.interval_ns() } else { PATIENCE_NS };
            return if silent_ns > allowed_ns { Err(self.silent(silent_ns)) } else { Ok(None) };
        };
        // Also when the picture is too old: then it was us who did not look, and the camera is well.
        (*heard_ns, *had_picture) = (now_ns, true);
        self.sequence = self.before.wrapping_add(taken.position);
        if taken.time_ns > now_ns.saturating_add(self.max_age_ns) {
            return Err(self.fail(Errno::PROTO));
        }
        let fresh = now_ns.saturating_sub(taken.time_ns) <= self.max_age_ns;
        let seen = match stream.view(&taken) {
            Ok(view) if fresh => Some(look(&Picture {
                time_ns: taken.time_ns,
                sequence: self.sequence,
                buffer: taken.index,
                view,
            })),
            _ => None,
        };
        let returned = stream.give_back(taken);
        if seen.is_some() {
            self.status.good += 1;
            self.status.state = DeviceState::Working;
            self.status.last_good_ns = taken.time_ns;
            (self.backoff_ns, self.restarted) = (BACKOFF_NS.0, false);
        } else {
            self.status.bad += 1;
        }
        if let Err(errno) = returned {
            // The picture was good; the next look tells what has happened.
            self.fail(errno);
        }
        Ok(seen)
    }

    fn absent<R>(&mut self, now_ns: u64) -> Result<Option<R>, V4l2Error> {
        match (&self.error, &self.link) {
            (Some(error), _) => Err(error.clone()),
            (None, Link::Pending { since_ns })
                if now_ns.saturating_sub(*since_ns) > PATIENCE_NS =>
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

    /// After some patience a silent camera is restarted, and closed when that has not helped.
    fn silent(&mut self, silent_ns: u64) -> V4l2Error {
        let error = self.report_silence(silent_ns);
        if silent_ns > PATIENCE_NS {
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

    /// Restarts the stream where that may help and has not been tried since the last picture; otherwise closes the camera.
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
