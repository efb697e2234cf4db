//! The loop's handle of the recording thread.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use runtime::recording::{RecordedTick, RunHeader, Views};
use runtime::robot::Robot;
use segment_store::signature::RobotKey;
use segment_store::{is_segment_name, private};

use super::disk::{Disk, FileSystem};
use super::error::RecordError;
use super::free_space::{Quota, Removed};
use super::segments::{Segments, segment_name};
use crate::config::RecordingSection;
use crate::report::map_view::map_view;

/// What the recorder does with a tick when the disk is slower than the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenFull {
    /// The loop waits, so that every tick is recorded. For virtual time.
    Wait,
    /// The tick is dropped and counted, so that recording can neither delay nor end the loop. After a failure the recorder
    /// tries again every [`RETRY_NS`]. For robots.
    Drop,
}

/// How a run is recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct RecorderOptions {
    /// Folder of the segments.
    pub dir: PathBuf,
    /// What the recorder does when the disk is slower than the loop.
    pub when_full: WhenFull,
    /// Capacity of the queue between the loop and the recording thread, ticks.
    pub queue_ticks: usize,
    /// A segment ends when it spans this much time of the run.
    pub segment_ns: u64,
    /// A segment ends when its file has this many bytes.
    pub segment_bytes: u64,
    /// Whether every chunk is synced to the disk.
    pub sync: bool,
    /// Whether images are recorded, and the parts of a tick that contain images: depth and snapshots.
    pub images: bool,
    /// Whether segments say which date the run's times are. Not in virtual time.
    pub dated: bool,
    /// How much of the disk recordings may use; `None` for all of it.
    pub quota: Option<Quota>,
    /// The key that signs each segment of a run with an identity; `None` for recordings that are not signed.
    pub key: Option<RobotKey>,
}

impl RecorderOptions {
    /// For virtual time: every tick is recorded, and the operating system decides when it writes them to the disk.
    #[must_use]
    pub fn simulation(dir: impl Into<PathBuf>) -> Self {
        Self {
            dir: dir.into(),
            when_full: WhenFull::Wait,
            queue_ticks: 16,
            segment_ns: 60_000_000_000,
            segment_bytes: 256 << 20,
            sync: false,
            images: true,
            dated: false,
            quota: None,
            key: None,
        }
    }

    /// For a real robot: recording never delays the loop, and a power cut costs little (see the [module](super)).
    #[must_use]
    pub fn robot(dir: impl Into<PathBuf>) -> Self {
        Self { when_full: WhenFull::Drop, sync: true, dated: true, ..Self::simulation(dir) }
    }

    /// With the segments and images of the configuration.
    #[must_use]
    pub fn configured(self, section: &RecordingSection) -> Self {
        Self {
            segment_ns: (section.segment_s * 1e9) as u64,
            segment_bytes: section.segment_mib << 20,
            images: section.images,
            ..self
        }
    }
}

/// The result of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordingSummary {
    /// Number of recorded ticks.
    pub ticks: u64,
    /// Number of ticks that were dropped because the disk was too slow or had failed.
    pub dropped: u64,
    /// Older segments that were removed to free space.
    pub removed: Removed,
    /// Why the recording ended before the run; `None` if it did not.
    pub failure: Option<String>,
    /// Number of segments.
    pub segments: u32,
    /// Total size of the segments.
    pub bytes: u64,
    /// [`RunDigest::inputs`](runtime::recording::RunDigest::inputs) of the recorded ticks.
    pub inputs_digest: String,
    /// [`RunDigest::decisions`](runtime::recording::RunDigest::decisions) of the recorded ticks.
    pub decisions_digest: String,
}

/// Time after which a robot tries to record again after a failure, because space may have been freed.
pub const RETRY_NS: u64 = 10_000_000_000;

/// A request to the recording thread.
enum Request {
    Tick(Box<QueuedTick>),
    /// Close the segment, and answer with the number of segments.
    Cut(SyncSender<u32>),
}

struct QueuedTick {
    tick: RecordedTick,
    views: Views,
    /// A recording that has failed may begin again with this tick.
    may_begin: bool,
}

/// Sends ticks to the recording thread. Its `drop` waits for the thread, so that a run that ends with an error leaves
/// complete files too.
pub struct Recorder {
    when_full: WhenFull,
    segment_ns: u64,
    images: bool,
    next_snapshot_ns: Option<u64>,
    queue: Option<SyncSender<Request>>,
    thread: Option<JoinHandle<Result<RecordingSummary, RecordError>>>,
    next_try_ns: u64,
    dropped: u64,
    status: Arc<Mutex<RecorderStatus>>,
}

/// State of the recording thread.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecorderStatus {
    /// Why nothing is recorded at the moment; `None` while recording works.
    pub failure: Option<String>,
    /// Number of ticks that were taken out of the queue.
    pub taken: u64,
    /// How many of these could not be recorded.
    pub lost: u64,
    /// Older segments that were removed to free space.
    pub removed: Removed,
}

impl Recorder {
    /// Creates the directory and the first file, and starts the thread.
    ///
    /// # Errors
    /// When the directory cannot be written or holds a recording already.
    pub fn start(options: RecorderOptions, run: RunHeader) -> Result<Self, RecordError> {
        Self::start_on(Box::new(FileSystem), options, run)
    }

    /// The same as [`start`](Self::start), on another disk.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn start_on(
        mut disk: Box<dyn Disk>,
        options: RecorderOptions,
        run: RunHeader,
    ) -> Result<Self, RecordError> {
        refuse_old_recording(&options.dir)?;
        let path = options.dir.join(segment_name(0));
        let first_file =
            disk.create(&path).map_err(|source| RecordError::Create { path, source })?;
        let (sender, receiver) = sync_channel(options.queue_ticks);
        let when_full = options.when_full;
        let segment_ns = options.segment_ns;
        let images = options.images;
        // A run that begins in a loaded map begins with a memory: its first tick needs a snapshot too.
        let next_snapshot_ns = run.loaded_map.is_some().then_some(0);
        let run = RunHeader { images, ..run };
        let status = Arc::new(Mutex::new(RecorderStatus::default()));
        let thread_status = Arc::clone(&status);
        let thread = std::thread::Builder::new()
            .name("recording".to_owned())
            .spawn(move || {
                record_all(
                    &receiver,
                    Segments::new(options, disk, run, first_file),
                    when_full,
                    &thread_status,
                )
            })
            .map_err(|error| RecordError::Thread(error.to_string()))?;
        Ok(Self {
            when_full,
            segment_ns,
            images,
            next_snapshot_ns,
            queue: Some(sender),
            thread: Some(thread),
            next_try_ns: 0,
            dropped: 0,
            status,
        })
    }

    /// Whether the tick at `time_ns` should carry a snapshot from which a replay can begin. That is the first tick of every
    /// segment but the run's first, the first tick of a run that begins in a loaded map, and the tick with which a recording
    /// begins again after a failure.
    #[must_use]
    pub fn wants_snapshot(&mut self, time_ns: u64) -> bool {
        if self.status().failure.is_some() {
            let due = time_ns >= self.next_try_ns;
            if due {
                self.next_try_ns = time_ns.saturating_add(RETRY_NS);
            }
            return due;
        }
        let next_ns = *self.next_snapshot_ns.get_or_insert(time_ns.saturating_add(self.segment_ns));
        let wanted = time_ns >= next_ns;
        if wanted {
            self.next_snapshot_ns = Some(time_ns.saturating_add(self.segment_ns));
        }
        wanted
    }

    /// Queues a tick for recording.
    ///
    /// # Errors
    /// With [`WhenFull::Wait`], when the recording has failed: the run must end with `output_failed`. With
    /// [`WhenFull::Drop`] never; see [`dropped`](Self::dropped) and [`status`](Self::status).
    pub fn record(&mut self, mut tick: RecordedTick, mut views: Views) -> Result<(), RecordError> {
        let may_begin = tick.snapshot.is_some();
        if !self.images {
            tick.frame = None;
            tick.truth = None;
            tick.snapshot = None;
            views.depth = None;
        }
        let request = Request::Tick(Box::new(QueuedTick { tick, views, may_begin }));
        let accepted = match (&self.queue, self.when_full) {
            (None, _) => Err(TrySendError::Disconnected(())),
            (Some(queue), WhenFull::Wait) => {
                queue.send(request).map_err(|_| TrySendError::Disconnected(()))
            }
            (Some(queue), WhenFull::Drop) => queue.try_send(request).map_err(|error| match error {
                TrySendError::Full(_) => TrySendError::Full(()),
                TrySendError::Disconnected(_) => TrySendError::Disconnected(()),
            }),
        };
        let Err(refusal) = accepted else { return Ok(()) };
        self.dropped += 1;
        if matches!(refusal, TrySendError::Full(())) {
            return Ok(());
        }
        let error = self.why_ended();
        match self.when_full {
            WhenFull::Wait => Err(error),
            WhenFull::Drop => {
                // The thread has panicked: a failure of the disk does not end it. Nothing more can be recorded.
                lock(&self.status).failure.get_or_insert(error.to_string());
                Ok(())
            }
        }
    }

    /// Closes the current segment and waits until its file is complete. Returns the number of segments. The next tick
    /// begins another one.
    ///
    /// # Errors
    /// When the recording has failed.
    pub fn cut(&mut self) -> Result<u32, RecordError> {
        let (sender, receiver) = sync_channel(1);
        let sent =
            self.queue.as_ref().is_some_and(|queue| queue.send(Request::Cut(sender)).is_ok());
        match receiver.recv() {
            Ok(segments) if sent => Ok(segments),
            _ => Err(self.why_ended()),
        }
    }

    fn why_ended(&mut self) -> RecordError {
        match self.join() {
            Some(Err(error)) => error,
            Some(Ok(_)) | None => RecordError::Thread("it has ended already".to_owned()),
        }
    }

    /// Number of ticks that could not be recorded.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped + lock(&self.status).lost
    }

    /// State of the recording thread. It reports a failure with [`WhenFull::Drop`] only.
    #[must_use]
    pub fn status(&self) -> RecorderStatus {
        lock(&self.status).clone()
    }

    /// Waits until every queued tick is recorded, and closes the last file.
    ///
    /// # Errors
    /// When the recording has failed.
    pub fn finish(mut self) -> Result<RecordingSummary, RecordError> {
        match self.join() {
            Some(result) => {
                let dropped = self.dropped();
                let failure = self.status().failure;
                result.map(|summary| RecordingSummary { dropped, failure, ..summary })
            }
            None => Err(RecordError::Thread("it has ended already".to_owned())),
        }
    }

    fn join(&mut self) -> Option<Result<RecordingSummary, RecordError>> {
        self.queue = None;
        let joined = self.thread.take()?.join();
        Some(joined.unwrap_or_else(|_| {
            Err(RecordError::Thread("it panicked; please report this".to_owned()))
        }))
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if let Some(Err(error)) = self.join() {
            tracing::error!("{error}");
        }
    }
}

/// Map, path and depth for viewers, at their configured rates.
#[must_use]
pub fn recorded_views(robot: &Robot, tick: u64, config: &RecordingSection) -> Views {
    let shows_map = tick.is_multiple_of(config.map_every_ticks);
    let shows_depth = tick.is_multiple_of(config.depth_every_ticks);
    let mut views = Views::default();
    if shows_map {
        views.map = map_view(robot.map());
    }
    if shows_depth {
        views.path_m = Some(robot.explorer().path_m().to_vec());
        views.depth = robot.shown_depth();
    }
    views
}

/// The robot's snapshot, if the recorder wants one with the tick at `time_ns`.
pub fn snapshot(recorder: Option<&mut Recorder>, robot: &Robot, time_ns: u64) -> Option<Vec<u8>> {
    recorder?.wants_snapshot(time_ns).then(|| robot.snapshot())
}

fn record_all(
    queue: &Receiver<Request>,
    mut segments: Segments,
    when_full: WhenFull,
    status: &Mutex<RecorderStatus>,
) -> Result<RecordingSummary, RecordError> {
    for request in queue {
        match request {
            Request::Tick(queued) => match when_full {
                WhenFull::Wait => segments.write(&queued.tick, &queued.views)?,
                WhenFull::Drop => write_if_possible(&mut segments, &queued, status),
            },
            Request::Cut(answer) => {
                let count = segments.cut()?;
                // The receiver may have been dropped.
                let _ = answer.send(count);
            }
        }
    }
    segments.finish()
}

/// After a failure only a tick with a snapshot is tried, because a replay cannot begin at another tick.
fn write_if_possible(segments: &mut Segments, queued: &QueuedTick, status: &Mutex<RecorderStatus>) {
    let QueuedTick { tick, views, may_begin } = queued;
    let failing = lock(status).failure.is_some();
    if failing && !may_begin {
        lock(status).taken += 1;
        lock(status).lost += 1;
        return;
    }
    let written = segments.write(tick, views);
    let mut status = lock(status);
    status.taken += 1;
    status.removed = segments.summary().removed;
    match written {
        Ok(()) if failing => {
            tracing::warn!("recording again from tick {} on", tick.tick);
            status.failure = None;
        }
        Ok(()) => {}
        Err(error) => {
            if !failing {
                tracing::error!("nothing is recorded: {error}; trying again every 10 s");
            }
            status.failure = Some(error.to_string());
            status.lost += 1;
        }
    }
}

/// Ignores poisoning: a thread that panics while it holds the lock leaves every field valid.
fn lock(status: &Mutex<RecorderStatus>) -> MutexGuard<'_, RecorderStatus> {
    status.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Refuses a folder with a recording, because a folder holds one run. Creates the folder if it is missing, for this
/// account only.
///
/// # Errors
/// When the folder holds a recording, or cannot be read.
pub fn refuse_old_recording(dir: &Path) -> Result<(), RecordError> {
    private::create_folder(dir).map_err(|source| unusable(dir, source))?;
    for entry in std::fs::read_dir(dir).map_err(|source| unusable(dir, source))? {
        let entry = entry.map_err(|source| unusable(dir, source))?;
        if entry.file_name().to_str().is_some_and(is_segment_name) {
            return Err(RecordError::HoldsRecording { path: entry.path() });
        }
    }
    Ok(())
}

fn unusable(dir: &Path, source: std::io::Error) -> RecordError {
    RecordError::Directory { dir: dir.to_owned(), source }
}
