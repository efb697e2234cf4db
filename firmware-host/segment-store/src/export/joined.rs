//! A run as one plain MCAP file.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::error::BufferError;
use crate::recover::{Recovered, Rewriter, failure, write_new};

/// Joins segments, in this order, into the new file `to`: every message of every complete chunk, with one index.
///
/// # Errors
/// When a segment is no MCAP file, or `to` is there already or cannot be written.
pub fn joined(segments: &[PathBuf], to: &Path) -> Result<Recovered, BufferError> {
    write_new(to, |sink| {
        let mut rewriter = Rewriter::begin(sink).map_err(|error| failure(error, to, to))?;
        for segment in segments {
            let file = File::open(segment).map_err(BufferError::read(segment))?;
            rewriter.add(&file).map_err(|error| failure(error, segment, to))?;
        }
        rewriter.finish().map(|(_, done)| done).map_err(|error| failure(error, to, to))
    })
}
