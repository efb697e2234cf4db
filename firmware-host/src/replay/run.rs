//! A recorded run: the ticks of all its segments in order.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use runtime::recording::{RecordedTick, RecordingError, RecordingReader, RunHeader};
use segment_store::is_segment_name;

/// Why a run cannot be replayed, or not any further.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// The path cannot be read.
    #[error("cannot read {}: {source}; give the --out directory of a run or one .mcap file", path.display())]
    Open {
        /// File or directory.
        path: PathBuf,
        source: io::Error,
    },
    /// The directory has no segments.
    #[error("{} holds no recording_NNNN.mcap; give the --out directory of a run or one .mcap file", dir.display())]
    NoSegments { dir: PathBuf },
    /// A file is not a recording, or is truncated or corrupt.
    #[error("{}: {source}", path.display())]
    Segment {
        path: PathBuf,
        /// What is wrong with it.
        source: RecordingError,
    },
    /// The first file is not the run's first segment, and has no snapshot.
    #[error(
        "{} is segment {segment} of its run and has no snapshot, so the robot's memory of the segments before it is unknown; \
         replay the run's directory with all of its segments",
        path.display()
    )]
    NotTheStart {
        path: PathBuf,
        /// Number of the segment.
        segment: u32,
    },
    /// A segment is missing, or there are two with the same number.
    #[error(
        "{} is segment {found} where segment {expected} should be; put all segments of the run into one directory",
        path.display()
    )]
    SegmentOrder {
        path: PathBuf,
        /// Number of the missing segment.
        expected: u32,
        /// Number of this segment.
        found: u32,
    },
    /// A segment belongs to another run.
    #[error(
        "{} belongs to another run than the segments before it; put each run into a directory of its own",
        path.display()
    )]
    OtherRun { path: PathBuf },
    /// Ticks are missing.
    #[error(
        "{}: tick {found} is where tick {expected} should be: ticks were dropped while recording (the disk \
         was too slow) or were in a damaged part. Ticks after them cannot be recomputed before the next snapshot",
        path.display()
    )]
    Gap {
        path: PathBuf,
        /// Number of the missing tick.
        expected: u64,
        /// Number of the tick in its place.
        found: u64,
    },
}

impl ReplayError {
    /// Whether ticks are missing and the run goes on after them.
    #[must_use]
    pub fn is_gap(&self) -> bool {
        matches!(self, Self::Gap { .. } | Self::SegmentOrder { .. })
    }

    /// Whether only the end of the run is missing.
    #[must_use]
    pub fn is_truncation(&self) -> bool {
        matches!(self, Self::Segment { source, .. } if source.is_truncation())
    }
}

/// A moment in a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Moment {
    /// The number of a tick.
    Tick(u64),
    /// Time after the run's first tick, seconds.
    Seconds(f64),
}

impl std::str::FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let seconds = text.strip_suffix('s').map(|number| number.trim().parse::<f64>());
        match (seconds, text.parse::<u64>()) {
            (Some(Ok(seconds)), _) if seconds.is_finite() && seconds >= 0.0 => {
                Ok(Self::Seconds(seconds))
            }
            (None, Ok(tick)) => Ok(Self::Tick(tick)),
            _ => Err(format!("`{text}` is neither a tick such as 1200 nor a time such as 61.5s")),
        }
    }
}

impl Moment {
    /// Whether a tick with this number and time is at this moment or after it, in a run that began at `start_ns`.
    #[must_use]
    pub fn is_reached(self, tick: u64, time_ns: u64, start_ns: u64) -> bool {
        match self {
            Self::Tick(first) => tick >= first,
            Self::Seconds(seconds) => time_ns.saturating_sub(start_ns) as f64 * 1e-9 >= seconds,
        }
    }
}

impl std::fmt::Display for Moment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tick(tick) => write!(f, "tick {tick}"),
            Self::Seconds(seconds) => write!(f, "{seconds} s"),
        }
    }
}

/// Iterator over the ticks of a run, over all of its segments. Where ticks are missing it returns a
/// [gap](ReplayError::is_gap) and goes on after it. Any other error ends the iterator.
pub struct Run {
    /// Segments that have not been read yet, last first.
    rest: Vec<PathBuf>,
    path: PathBuf,
    reader: RecordingReader<BufReader<File>>,
    header: RunHeader,
    segment: u32,
    next_tick: u64,
    start_ns: u64,
    /// The tick after a gap, which is returned after the error.
    held: Option<RecordedTick>,
    done: bool,
}

impl Run {
    /// Opens the `--out` directory of a run, or one .mcap.
    ///
    /// # Errors
    /// When there is no recording.
    pub fn open(path: &Path) -> Result<Self, ReplayError> {
        let paths = segments(path)?;
        let start_ns = start_of(&paths, path)?;
        Self::begin(paths, 0, start_ns)
    }

    /// Opens the run at the last segment that begins with a snapshot at or before `moment`, or at its first segment if there
    /// is none. Segments that cannot be read are passed over; times count from the first one that can.
    ///
    /// # Errors
    /// When there is no recording, or the run has to be opened at its first segment and that cannot be read.
    pub fn open_before(path: &Path, moment: Moment) -> Result<Self, ReplayError> {
        let paths = segments(path)?;
        let start_ns = start_of(&paths, path)?;
        for at in (1..paths.len()).rev() {
            let Some(mut reader) = paths.get(at).and_then(|path| open_segment(path).ok()) else {
                continue;
            };
            let tick = reader.header().first_tick;
            let time_ns = reader.header().first_time_ns;
            let is_later = match moment {
                Moment::Tick(last) => tick > last,
                Moment::Seconds(seconds) => {
                    time_ns.saturating_sub(start_ns) as f64 * 1e-9 > seconds
                }
            };
            if is_later {
                continue;
            }
            if matches!(reader.next(), Some(Ok(RecordedTick { snapshot: Some(_), .. }))) {
                return Self::begin(paths, at, start_ns);
            }
        }
        Self::begin(paths, 0, start_ns)
    }

    fn begin(mut paths: Vec<PathBuf>, first: usize, start_ns: u64) -> Result<Self, ReplayError> {
        let mut rest = paths.split_off(first);
        rest.reverse();
        let path = rest.pop().unwrap_or_default();
        let reader = open_segment(&path)?;
        let header = reader.header().clone();
        Ok(Self {
            rest,
            path,
            reader,
            header: header.run,
            segment: header.segment,
            next_tick: header.first_tick,
            start_ns,
            held: None,
            done: false,
        })
    }

    /// Whether the next tick is the run's first one, and the robot had no memory before it. A run that began with a loaded map
    /// has it in the snapshot of its first tick.
    #[must_use]
    pub fn is_at_the_start(&self) -> bool {
        self.segment == 0 && self.next_tick == 0 && self.header.loaded_map.is_none()
    }

    /// The error for a run that is not at its start and has no snapshot.
    pub(super) fn not_the_start(&self) -> ReplayError {
        ReplayError::NotTheStart { path: self.path.clone(), segment: self.segment }
    }

    /// Time of the first recorded tick, monotonic.
    #[must_use]
    pub fn start_ns(&self) -> u64 {
        self.start_ns
    }

    /// The run's header.
    #[must_use]
    pub fn header(&self) -> &RunHeader {
        &self.header
    }

    fn next_tick(&mut self) -> Result<Option<RecordedTick>, ReplayError> {
        if let Some(tick) = self.held.take() {
            return Ok(Some(tick));
        }
        loop {
            if let Some(tick) = self.reader.next() {
                let tick = tick
                    .map_err(|source| ReplayError::Segment { path: self.path.clone(), source })?;
                let expected = self.next_tick;
                let found = tick.tick;
                self.next_tick = found.saturating_add(1);
                if found != expected {
                    self.held = Some(tick);
                    return Err(ReplayError::Gap { path: self.path.clone(), expected, found });
                }
                return Ok(Some(tick));
            }
            let Some(path) = self.rest.pop() else { return Ok(None) };
            self.reader = open_segment(&path)?;
            self.path = path;
            self.segment += 1;
            let header = self.reader.header();
            if header.run != self.header {
                return Err(ReplayError::OtherRun { path: self.path.clone() });
            }
            if header.segment != self.segment {
                let expected = self.segment;
                let found = header.segment;
                self.segment = found;
                self.next_tick = header.first_tick;
                return Err(ReplayError::SegmentOrder { path: self.path.clone(), expected, found });
            }
        }
    }
}

impl Iterator for Run {
    type Item = Result<RecordedTick, ReplayError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let item = self.next_tick().transpose();
        self.done = match &item {
            Some(Err(error)) => !error.is_gap(),
            item => item.is_none(),
        };
        item
    }
}

/// Time of the first tick that can be read, monotonic.
fn start_of(paths: &[PathBuf], run: &Path) -> Result<u64, ReplayError> {
    let mut why = None;
    for path in paths {
        match open_segment(path) {
            Ok(reader) => return Ok(reader.header().first_time_ns),
            Err(error) => why = why.or(Some(error)),
        }
    }
    Err(why.unwrap_or_else(|| ReplayError::NoSegments { dir: run.to_owned() }))
}

/// Opens one segment and reads its header.
///
/// # Errors
/// When it cannot be read or is not a recording.
pub fn open_segment(path: &Path) -> Result<RecordingReader<BufReader<File>>, ReplayError> {
    let file =
        File::open(path).map_err(|source| ReplayError::Open { path: path.to_owned(), source })?;
    RecordingReader::open(BufReader::with_capacity(1 << 20, file))
        .map_err(|source| ReplayError::Segment { path: path.to_owned(), source })
}

/// The segments of a run's `--out` directory in order; for a .mcap file, that file.
///
/// # Errors
/// When the directory cannot be read.
pub fn segments(path: &Path) -> Result<Vec<PathBuf>, ReplayError> {
    if !std::fs::metadata(path).map_err(|source| unreadable(path, source))?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(path).map_err(|source| unreadable(path, source))? {
        let entry = entry.map_err(|source| unreadable(path, source))?;
        if entry.file_name().to_str().is_some_and(is_segment_name) {
            found.push(entry.path());
        }
    }
    // Sorted by length first, because segment 10000 follows segment 9999.
    found.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    Ok(found)
}

fn unreadable(path: &Path, source: io::Error) -> ReplayError {
    ReplayError::Open { path: path.to_owned(), source }
}
