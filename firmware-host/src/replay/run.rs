//! A recorded run: its files as one row of turns.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use runtime::recording::{RecordedTick, RecordingError, RecordingReader, RunHeader};

use crate::record::is_segment_name;

/// Why a run cannot be replayed (any further).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// The path cannot be read.
    #[error("cannot read {}: {source}; give the --out directory of a run or one .mcap file", path.display())]
    Open {
        /// File or directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A directory without segments.
    #[error("{} holds no recording_NNNN.mcap; give the --out directory of a run or one .mcap file", dir.display())]
    NoSegments {
        /// The directory.
        dir: PathBuf,
    },
    /// A file is not a recording, or breaks off.
    #[error("{}: {source}", path.display())]
    Segment {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: RecordingError,
    },
    /// The first file is not the run's first.
    #[error(
        "{} is segment {segment} of its run, and what the robot decides depends on everything since segment 0; \
         replay the run's directory with all of its segments",
        path.display()
    )]
    NotTheStart {
        /// The file.
        path: PathBuf,
        /// Its number.
        segment: u32,
    },
    /// A file is missing in the row, or there twice.
    #[error(
        "{} is segment {found} where segment {expected} should be; put all segments of the run into one directory",
        path.display()
    )]
    SegmentOrder {
        /// The file.
        path: PathBuf,
        /// The number that should come.
        expected: u32,
        /// The number that came.
        found: u32,
    },
    /// A file of another run.
    #[error(
        "{} belongs to another run than the segments before it; put each run into a directory of its own",
        path.display()
    )]
    OtherRun {
        /// The file.
        path: PathBuf,
    },
    /// Turns were dropped while recording.
    #[error(
        "{}: turn {found} comes where turn {expected} should be: turns were dropped while recording (the disk \
         was too slow), \
         and what comes after them cannot be recomputed",
        path.display()
    )]
    Gap {
        /// The file.
        path: PathBuf,
        /// The turn that should come.
        expected: u64,
        /// The turn that came.
        found: u64,
    },
}

impl ReplayError {
    /// Whether the files are good as far as they go, and only the end is missing.
    #[must_use]
    pub fn is_truncation(&self) -> bool {
        matches!(self, Self::Segment { source, .. } if source.is_truncation())
    }
}

/// Turns of a run in order, over all of its segments. After an error comes nothing more.
pub struct Run {
    /// Segments that are still to be read, last first.
    rest: Vec<PathBuf>,
    path: PathBuf,
    reader: RecordingReader<BufReader<File>>,
    header: RunHeader,
    segment: u32,
    next_tick: u64,
    done: bool,
}

impl Run {
    /// Opens the `--out` directory of a run, or one .mcap.
    ///
    /// # Errors
    /// When there is no recording, or not from its start.
    pub fn open(path: &Path) -> Result<Self, ReplayError> {
        let mut rest = segments(path)?;
        rest.reverse();
        let path = rest.pop().ok_or_else(|| ReplayError::NoSegments { dir: path.to_owned() })?;
        let reader = open_segment(&path)?;
        let header = reader.header().clone();
        if header.segment != 0 {
            return Err(ReplayError::NotTheStart { path, segment: header.segment });
        }
        Ok(Self { rest, path, reader, header: header.run, segment: 0, next_tick: header.first_tick, done: false })
    }

    /// What the run was made with.
    #[must_use]
    pub fn header(&self) -> &RunHeader {
        &self.header
    }

    fn next_turn(&mut self) -> Result<Option<RecordedTick>, ReplayError> {
        loop {
            if let Some(tick) = self.reader.next() {
                let tick = tick.map_err(|source| ReplayError::Segment { path: self.path.clone(), source })?;
                if tick.tick != self.next_tick {
                    return Err(ReplayError::Gap {
                        path: self.path.clone(),
                        expected: self.next_tick,
                        found: tick.tick,
                    });
                }
                self.next_tick = tick.tick.saturating_add(1);
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
                let (expected, found) = (self.segment, header.segment);
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
        let item = self.next_turn().transpose();
        self.done = !matches!(item, Some(Ok(_)));
        item
    }
}

/// Opens one segment and reads its header.
///
/// # Errors
/// When it cannot be read or is no recording.
pub fn open_segment(path: &Path) -> Result<RecordingReader<BufReader<File>>, ReplayError> {
    let file = File::open(path).map_err(|source| ReplayError::Open { path: path.to_owned(), source })?;
    RecordingReader::open(BufReader::with_capacity(1 << 20, file))
        .map_err(|source| ReplayError::Segment { path: path.to_owned(), source })
}

/// The segments of the `--out` directory of a run in their order, or the one .mcap itself.
///
/// # Errors
/// When the directory cannot be read.
pub fn segments(path: &Path) -> Result<Vec<PathBuf>, ReplayError> {
    let error = |source| ReplayError::Open { path: path.to_owned(), source };
    if !std::fs::metadata(path).map_err(error)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(path).map_err(error)? {
        let entry = entry.map_err(error)?;
        if entry.file_name().to_str().is_some_and(is_segment_name) {
            found.push(entry.path());
        }
    }
    // By length first: segment 10000 comes after segment 9999.
    found.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    Ok(found)
}
