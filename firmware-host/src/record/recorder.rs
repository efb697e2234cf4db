//! The handle that the loop holds.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use runtime::recording::{RecordedTick, RunHeader, Views};
use runtime::robot::Robot;
use segment_store::is_segment_name;

use super::disk::{Disk, FileSystem};
use super::error::RecordError;
use super::room::{Quota, Removed};
use super::segments::{Segments, segment_name};
use crate::config::RecordingSection;
use crate::report::map_view::map_view;

/// What happens to a turn when the disk is slower than the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenFull {
    /// The loop waits: nothing is lost and the run replays. For virtual time.
    Wait,
    /// The turn is dropped and counted: the loop never waits, and never ends because of the recording. After a failure it is
    /// tried again every [`RETRY_NS`]. For robots.
    Drop,
}

/// How a run is recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct RecorderOptions {
    /// Where the segments go.
    pub dir: PathBuf,
    /// What happens when the disk is slower than the loop.
    pub when_full: WhenFull,
    /// Turns that may wait for the disk.
    pub queue_ticks: usize,
    /// A segment ends when it spans this much time of the run.
    pub segment_ns: u64,
    /// A segment ends when its file has this many bytes.
    pub segment_bytes: u64,
    /// Whether every chunk is synced to the disk.
    pub sync: bool,
    /// Whether images are recorded, and what holds some: depth and snapshots.
    pub images: bool,
    /// How much of the disk recordings may take; `None`: all.
    pub quota: Option<Quota>,
}

impl RecorderOptions {
    /// Virtual time: exact, and left to the operating system to write back.
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
            quota: None,
        }
    }

    /// A real robot: never in the way, and safe against power cuts (see the [module](super)).
    #[must_use]
    pub fn robot(dir: impl Into<PathBuf>) -> Self {
        Self { when_full: WhenFull::Drop, sync: true, ..Self::simulation(dir) }
    }
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordingSummary {
    /// Turns on the disk.
    pub ticks: u64,
    /// Turns that were dropped because the disk was too slow or had failed.
    pub dropped: u64,
    /// Older segments that had to make room.
    pub removed: Removed,
    /// Why it ended before the run, if so.
    pub failure: Option<String>,
    /// Files.
    pub segments: u32,
    /// Their size together.
    pub bytes: u64,
    /// [`RunDigest::inputs`](runtime::recording::RunDigest::inputs) of the recorded turns.
    pub inputs_digest: String,
    /// [`RunDigest::decisions`](runtime::recording::RunDigest::decisions) of the recorded turns.
    pub decisions_digest: String,
}

/// After a failure a robot's recording is tried again this often: somebody may have made room.
pub const RETRY_NS: u64 = 10_000_000_000;

/// What the recording thread is told.
enum Told {
    Turn(Box<Turn>),
    /// Close the segment, and answer with how many there are.
    Cut(SyncSender<u32>),
}

struct Turn {
    tick: RecordedTick,
    views: Views,
    /// A recording that failed may begin again here.
    may_begin: bool,
}

/// Hands turns to the recording thread. Dropping it waits for the thread, so that even a run that ends by an error
/// leaves whole files.
pub struct Recorder {
    when_full: WhenFull,
    segment_ns: u64,
    images: bool,
    next_snapshot_ns: Option<u64>,
    queue: Option<SyncSender<Told>>,
    thread: Option<JoinHandle<Result<RecordingSummary, RecordError>>>,
    next_try_ns: u64,
    dropped: u64,
    /// What the thread says of itself.
    word: Arc<Mutex<Word>>,
}

/// What the recording thread says of itself while it works.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Word {
    /// Why nothing is recorded now, if so.
    pub failure: Option<String>,
    /// Turns that were taken out of the queue.
    pub taken: u64,
    /// Of these, how many were lost.
    pub lost: u64,
    /// Older segments that had to make room.
    pub removed: Removed,
}

impl Recorder {
    /// Makes the directory and the first file, and starts the thread.
    ///
    /// # Errors
    /// When the directory cannot be written or holds a recording already.
    pub fn start(options: RecorderOptions, run: RunHeader) -> Result<Self, RecordError> {
        Self::start_on(Box::new(FileSystem), options, run)
    }

    /// As [`start`](Self::start), on any disk.
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
        let (when_full, segment_ns, images) =
            (options.when_full, options.segment_ns, options.images);
        let run = RunHeader { images, ..run };
        let word = Arc::new(Mutex::new(Word::default()));
        let thread_word = Arc::clone(&word);
        let thread = std::thread::Builder::new()
            .name("recording".to_owned())
            .spawn(move || {
                record_all(
                    &receiver,
                    Segments::new(options, disk, run, first_file),
                    when_full,
                    &thread_word,
                )
            })
            .map_err(|error| RecordError::Thread(error.to_string()))?;
        Ok(Self {
            when_full,
            segment_ns,
            images,
            next_snapshot_ns: None,
            queue: Some(sender),
            thread: Some(thread),
            next_try_ns: 0,
            dropped: 0,
            word,
        })
    }

    /// Whether the turn at `time_ns` should carry what the loop remembers before it: once a segment, at its first turn, so that a
    /// replay can begin there, and when recording is to begin again after a failure. The run's own first turn needs none.
    #[must_use]
    pub fn wants_snapshot(&mut self, time_ns: u64) -> bool {
        if self.word().failure.is_some() {
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

    /// Hands over a turn.
    ///
    /// # Errors
    /// With [`WhenFull::Wait`], when the recording has failed: the run must end with `output_failed`. With
    /// [`WhenFull::Drop`] never; see [`dropped`](Self::dropped) and [`word`](Self::word).
    pub fn record(&mut self, mut tick: RecordedTick, mut views: Views) -> Result<(), RecordError> {
        let may_begin = tick.snapshot.is_some();
        if !self.images {
            (tick.frame, tick.truth, tick.snapshot, views.depth) = (None, None, None, None);
        }
        let turn = Told::Turn(Box::new(Turn { tick, views, may_begin }));
        let accepted = match (&self.queue, self.when_full) {
            (None, _) => Err(TrySendError::Disconnected(())),
            (Some(queue), WhenFull::Wait) => {
                queue.send(turn).map_err(|_| TrySendError::Disconnected(()))
            }
            (Some(queue), WhenFull::Drop) => queue.try_send(turn).map_err(|error| match error {
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
                // The thread is gone, which no disk can bring about: nothing more will be recorded.
                lock(&self.word).failure.get_or_insert(error.to_string());
                Ok(())
            }
        }
    }

    /// Closes the current segment and waits until it is a whole file; how many segments there are. The next turn begins
    /// another one.
    ///
    /// # Errors
    /// When the recording has failed.
    pub fn cut(&mut self) -> Result<u32, RecordError> {
        let (sender, receiver) = sync_channel(1);
        let sent = self.queue.as_ref().is_some_and(|queue| queue.send(Told::Cut(sender)).is_ok());
        match receiver.recv() {
            Ok(segments) if sent => Ok(segments),
            _ => Err(self.why_ended()),
        }
    }

    fn why_ended(&mut self) -> RecordError {
        match self.join() {
            Some(Err(error)) => error,
            Some(Ok(_)) | None => RecordError::Thread("it has ended before".to_owned()),
        }
    }

    /// Turns that are not in the recording.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped + lock(&self.word).lost
    }

    /// What the recording thread says of itself. A failure only with [`WhenFull::Drop`].
    #[must_use]
    pub fn word(&self) -> Word {
        lock(&self.word).clone()
    }

    /// Waits until everything is in its file.
    ///
    /// # Errors
    /// When the recording has failed.
    pub fn finish(mut self) -> Result<RecordingSummary, RecordError> {
        match self.join() {
            Some(result) => {
                let (dropped, failure) = (self.dropped(), self.word().failure);
                result.map(|summary| RecordingSummary { dropped, failure, ..summary })
            }
            None => Err(RecordError::Thread("it has ended before".to_owned())),
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

/// What people look at in a recording: map, path and depth at their configured rates.
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
        views.depth = robot.mapped_depth().map(|estimate| estimate.depth.clone());
    }
    views
}

/// What `robot` remembers, when the recorder wants it with the turn at `time_ns`.
pub fn snapshot(recorder: Option<&mut Recorder>, robot: &Robot, time_ns: u64) -> Option<Vec<u8>> {
    recorder?.wants_snapshot(time_ns).then(|| robot.snapshot())
}

fn record_all(
    queue: &Receiver<Told>,
    mut segments: Segments,
    when_full: WhenFull,
    word: &Mutex<Word>,
) -> Result<RecordingSummary, RecordError> {
    for told in queue {
        match told {
            Told::Turn(turn) => match when_full {
                WhenFull::Wait => segments.write(&turn.tick, &turn.views)?,
                WhenFull::Drop => write_if_possible(&mut segments, &turn, word),
            },
            Told::Cut(answer) => {
                let count = segments.cut()?;
                // Who asked may be gone.
                let _ = answer.send(count);
            }
        }
    }
    segments.finish()
}

/// After a failure only a turn that says what the robot remembers is worth trying.
fn write_if_possible(segments: &mut Segments, turn: &Turn, word: &Mutex<Word>) {
    let Turn { tick, views, may_begin } = turn;
    let failing = lock(word).failure.is_some();
    if failing && !may_begin {
        lock(word).taken += 1;
        lock(word).lost += 1;
        return;
    }
    let written = segments.write(tick, views);
    let mut word = lock(word);
    word.taken += 1;
    word.removed = segments.summary().removed;
    match written {
        Ok(()) if failing => {
            tracing::warn!("recording again from turn {} on", tick.tick);
            word.failure = None;
        }
        Ok(()) => {}
        Err(error) => {
            if !failing {
                tracing::error!("nothing is recorded: {error}; it is tried again");
            }
            word.failure = Some(error.to_string());
            word.lost += 1;
        }
    }
}

/// A thread that panicked while it held the lock left nothing half-said.
fn lock(word: &Mutex<Word>) -> MutexGuard<'_, Word> {
    word.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A folder holds one run. Makes the folder if it is missing.
///
/// # Errors
/// When it holds a recording, or cannot be read.
pub fn refuse_old_recording(dir: &Path) -> Result<(), RecordError> {
    let error = |source| RecordError::Directory { dir: dir.to_owned(), source };
    std::fs::create_dir_all(dir).map_err(error)?;
    for entry in std::fs::read_dir(dir).map_err(error)? {
        let entry = entry.map_err(error)?;
        if entry.file_name().to_str().is_some_and(is_segment_name) {
            return Err(RecordError::HoldsRecording { path: entry.path() });
        }
    }
    Ok(())
}
