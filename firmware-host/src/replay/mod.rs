//! `firmware-host replay RUN`: does the same input still give the same decisions?

mod compare;
mod rewrite;
mod run;

#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::Path;

use runtime::recording::{RecordedTick, RunHeader};
use runtime::tick::{Decision, TickInput};

pub use compare::{Difference, differences};
pub use rewrite::rewrite;
pub use run::{ReplayError, Run, open_segment, segments};

/// Mismatching turns that are shown in full; after the first, most only follow from it.
const SHOWN_TURNS: u64 = 3;

/// Fields that are shown of one turn.
const SHOWN_FIELDS: usize = 8;

/// The loop as replay drives it: from a fresh start, turn by turn.
pub trait Replayable {
    /// Takes a turn.
    fn step(&mut self, input: &TickInput<'_>) -> Decision;
}

/// What a replay found.
#[derive(Debug)]
pub struct ReplayReport {
    /// Turns that were recomputed.
    pub ticks: u64,
    /// Turns whose decision is not the recorded one.
    pub mismatches: u64,
    /// Why the replay ended before the run's end, if so.
    pub problem: Option<ReplayError>,
}

impl ReplayReport {
    /// Whether the whole run was recomputed and is the same.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        self.ticks > 0 && self.mismatches == 0 && self.problem.is_none()
    }
}

/// Recomputes the run at `path` (the `--out` directory of a run, or one .mcap) with the loop that `build` makes from
/// its header. Writes the first mismatches to `out`, and `replay: ticks=N mismatches=M` as the last line. A run that
/// breaks off is replayed as far as it goes.
///
/// # Errors
/// When no turn can be replayed at all, the loop cannot be built, or `out` cannot be written.
pub fn replay(
    path: &Path,
    build: impl FnOnce(&RunHeader) -> anyhow::Result<Box<dyn Replayable>>,
    out: &mut dyn Write,
) -> anyhow::Result<ReplayReport> {
    let run = Run::open(path)?;
    let mut robot = build(run.header())?;
    let mut report = ReplayReport { ticks: 0, mismatches: 0, problem: None };
    for tick in run {
        match tick {
            Ok(tick) => compare_turn(robot.as_mut(), &tick, &mut report, out)?,
            Err(error) => report.problem = Some(error),
        }
    }
    if report.mismatches > SHOWN_TURNS {
        writeln!(out, "... and {} more turns", report.mismatches - SHOWN_TURNS)?;
    }
    if let Some(problem) = &report.problem {
        writeln!(out, "warning: {problem}")?;
    } else if report.ticks == 0 {
        writeln!(out, "warning: {} holds no turns, so nothing was compared", path.display())?;
    }
    writeln!(out, "replay: ticks={} mismatches={}", report.ticks, report.mismatches)?;
    Ok(report)
}

fn compare_turn(
    robot: &mut dyn Replayable,
    tick: &RecordedTick,
    report: &mut ReplayReport,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    let recomputed = robot.step(&tick.input()?);
    report.ticks += 1;
    let differences = match &tick.decision {
        Some(recorded) => differences(recorded, &recomputed)?,
        None => vec![Difference::not_recorded()],
    };
    if differences.is_empty() {
        return Ok(());
    }
    report.mismatches += 1;
    if report.mismatches <= SHOWN_TURNS {
        writeln!(out, "turn {} at {:.3} s decides differently:", tick.tick, tick.time_ns as f64 * 1e-9)?;
        for difference in differences.iter().take(SHOWN_FIELDS) {
            writeln!(out, "  {difference}")?;
        }
        if differences.len() > SHOWN_FIELDS {
            writeln!(out, "  ... and {} more fields", differences.len() - SHOWN_FIELDS)?;
        }
    }
    Ok(())
}
