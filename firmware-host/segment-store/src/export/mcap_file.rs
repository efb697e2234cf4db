//! Export of a run as one MCAP file.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::ticks::{check_order, no_tick};
use crate::error::StoreError;
use crate::recover::{Recovered, Rewriter, failure, write_new};

/// Joins segments in the given order into the new file `to`: all messages of all intact chunks, with one index.
///
/// # Errors
/// When a segment is not an MCAP file, the segments are out of order or have no tick, or `to` exists already or cannot be
/// written.
pub fn mcap(segments: &[PathBuf], to: &Path) -> Result<Recovered, StoreError> {
    check_order(segments)?;
    write_new(to, |sink| {
        let mut rewriter = Rewriter::begin(sink).map_err(|error| failure(error, to, to))?;
        for segment in segments {
            let file = File::open(segment).map_err(StoreError::read(segment))?;
            rewriter.add(&file).map_err(|error| failure(error, segment, to))?;
        }
        let (_, done) = rewriter.finish().map_err(|error| failure(error, to, to))?;
        if done.ticks == 0 { Err(no_tick(segments)) } else { Ok(done) }
    })
}
