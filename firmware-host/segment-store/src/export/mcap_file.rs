//! Export of a run as one MCAP file.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::error::StoreError;
use crate::recover::{Recovered, Rewriter, failure, write_new};

/// Joins segments in the given order into the new file `to`: all messages of all intact chunks, with one index.
///
/// # Errors
/// When a segment is not an MCAP file, or `to` exists already or cannot be written.
pub fn mcap(segments: &[PathBuf], to: &Path) -> Result<Recovered, StoreError> {
    write_new(to, |sink| {
        let mut rewriter = Rewriter::begin(sink).map_err(|error| failure(error, to, to))?;
        for segment in segments {
            let file = File::open(segment).map_err(StoreError::read(segment))?;
            rewriter.add(&file).map_err(|error| failure(error, segment, to))?;
        }
        rewriter.finish().map(|(_, recovered)| recovered).map_err(|error| failure(error, to, to))
    })
}
