//! Copies a recording with changes, for tests of `replay`.

use std::path::Path;

use runtime::recording::{RecordedTick, Views};

use super::run::Run;
use crate::record::{Recorder, RecorderOptions, RecordingSummary};

/// Copies the run at `from` into the directory `to` and passes every tick through `edit`. Tests use it to change a recorded
/// input, which `replay` must detect. Changing bytes of the file instead would be detected by its checksums. Map, path and
/// depth for viewers are not copied.
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
