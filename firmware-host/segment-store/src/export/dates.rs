//! Dates of recorded times. Recordings have the times of the robot's monotonic clock; viewers and ROS show dates.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::ticks::header;
use crate::error::StoreError;

/// How the times of a run become dates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Dates {
    /// Unix time at which the run's clock was zero, nanoseconds.
    zero_unix_ns: u64,
    /// Whether the recording says so; otherwise the date is that of the first file.
    pub recorded: bool,
}

impl Dates {
    /// The dates of the run that consists of `segments`. A robot may begin with a wrong date and learn the right one from the
    /// network, so the last segment's date is that of all times.
    ///
    /// # Errors
    /// When a segment cannot be read.
    pub fn of(segments: &[PathBuf]) -> Result<Self, StoreError> {
        let mut first = None;
        let mut last_dated = None;
        for path in segments {
            let Some(header) = header(path)? else { continue };
            last_dated = header.zero_unix_ns.or(last_dated);
            first.get_or_insert((path, header.first_time_ns));
        }
        if let Some(zero_unix_ns) = last_dated {
            return Ok(Self { zero_unix_ns, recorded: true });
        }
        let (path, first_ns) = first.map_or((None, 0), |(path, first_ns)| (Some(path), first_ns));
        let written_ns = path.map(|path| modified_ns(path)).transpose()?.unwrap_or(0);
        Ok(Self { zero_unix_ns: written_ns.saturating_sub(first_ns), recorded: false })
    }

    /// The Unix time of a time of the run, nanoseconds.
    pub fn unix_ns(self, time_ns: u64) -> u64 {
        self.zero_unix_ns.saturating_add(time_ns)
    }
}

/// When a file was written last, Unix nanoseconds.
fn modified_ns(path: &Path) -> Result<u64, StoreError> {
    let modified = std::fs::metadata(path).and_then(|metadata| metadata.modified());
    let since = modified.map_err(StoreError::read(path))?.duration_since(SystemTime::UNIX_EPOCH);
    Ok(since.ok().and_then(|since| u64::try_from(since.as_nanos()).ok()).unwrap_or(0))
}
