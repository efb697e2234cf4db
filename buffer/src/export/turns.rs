//! The turns of a segment, for exports.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use runtime::recording::{RecordedTick, RecordingReader, SegmentHeader};

use crate::error::BufferError;

/// Hands out every turn of a segment in order; whether the segment ends early.
pub(super) fn each_turn(
    path: &Path,
    mut take: impl FnMut(&SegmentHeader, &RecordedTick) -> Result<(), BufferError>,
) -> Result<bool, BufferError> {
    let file = File::open(path).map_err(BufferError::read(path))?;
    let bad = |detail: String| BufferError::Segment { path: path.to_owned(), detail };
    let reader = match RecordingReader::open(BufReader::with_capacity(1 << 20, file)) {
        Ok(reader) => reader,
        // Cut before its first turn.
        Err(error) if error.is_truncation() => return Ok(true),
        Err(error) => return Err(bad(error.to_string())),
    };
    let header = reader.header().clone();
    for tick in reader {
        match tick {
            Ok(tick) => take(&header, &tick)?,
            Err(error) if error.is_truncation() => return Ok(true),
            Err(error) => return Err(bad(error.to_string())),
        }
    }
    Ok(false)
}
