//! A recording with something changed.

use std::path::Path;

use runtime::recording::{RecordedTick, Views};

use super::run::Run;
use crate::record::{Recorder, RecorderOptions, RecordingSummary};

/// Copies the run at `from` into the directory `to`, every turn passed through `edit`. A test that flips one recorded
/// input this way must make `replay` report a mismatch: pictures sit compressed behind checksums, so no byte of a file
/// can be flipped without the file being corrupt. Pictures for people (map, path, depth) are not copied.
///
/// # Errors
/// When `from` cannot be read to its end or `to` cannot be written.
pub fn rewrite(
    from: &Path,
    to: &Path,
    mut edit: impl FnMut(&mut RecordedTick),
) -> anyhow::Result<RecordingSummary> {
    let run = Run::open(from)?;
    let mut recorder = Recorder::start(RecorderOptions::simulation(to), run.header().clone())?;
    for tick in run {
        let mut tick = tick?;
        edit(&mut tick);
        recorder.record(tick, Views::default())?;
    }
    Ok(recorder.finish()?)
}
