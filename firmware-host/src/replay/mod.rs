//! `firmware-host replay RUN`: does the same input still give the same decisions?

mod compare;
mod rewrite;
mod run;

#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::Path;

use runtime::recording::{RecordedTick, RunHeader};
use runtime::snapshot::SNAPSHOT_VERSION;
use runtime::tick::Decision;

pub use compare::{Difference, differences};
pub use rewrite::rewrite;
pub use run::{Moment, ReplayError, Run, open_segment, segments};

/// Mismatching turns that are shown in full; after the first, most only follow from it.
const SHOWN_TURNS: u64 = 3;

/// Fields that are shown of one turn.
const SHOWN_FIELDS: usize = 8;

/// The loop as replay drives it, turn by turn.
pub trait Replayable {
    /// Before a turn: a network that was handed over until then is taken.
    fn hand_over(&mut self, tick: u64);
    /// Goes on where the snapshot was written.
    ///
    /// # Errors
    /// A snapshot of another version or of another robot, or one that needs a model that is not there.
    fn restore(&mut self, snapshot: &[u8]) -> anyhow::Result<()>;
    /// All that it remembers.
    fn snapshot(&self) -> Vec<u8>;
    /// Decides a recorded tick again.
    ///
    /// # Errors
    /// A frame whose bytes do not fit its size.
    fn step(&mut self, tick: &RecordedTick) -> anyhow::Result<Decision>;
}

/// Which turns are recomputed.
#[derive(Debug, Clone, Copy, Default)]
pub struct Span {
    /// From the last segment that begins with a snapshot not after this; `None`: from the first turn that can be recomputed.
    pub from: Option<Moment>,
    /// Not beyond the first turn that decides differently.
    pub until_mismatch: bool,
}

/// What a replay found.
#[derive(Debug)]
pub struct ReplayReport {
    /// Turns that were recomputed.
    pub ticks: u64,
    /// Turns whose decision is not the recorded one.
    pub mismatches: u64,
    /// Turns that are there, but not what the robot remembered of those before them.
    pub unknown: u64,
    /// What was wrong with the run first: it breaks off, or turns are missing.
    pub problem: Option<ReplayError>,
}

impl ReplayReport {
    /// Whether everything from the first recomputed turn on was recomputed and is the same.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        self.ticks > 0 && self.mismatches == 0 && self.problem.is_none()
    }
}

/// Recomputes the run at `path` (the `--out` directory of a run, or one .mcap) with the loop that `build` makes from
/// its header. Writes the first mismatches to `out`, and `replay: ticks=N mismatches=M` as the last line. A run that
/// breaks off is replayed as far as it goes; where turns are missing it goes on at the next snapshot.
///
/// # Errors
/// When no turn can be replayed at all, the loop cannot be built, or `out` cannot be written.
pub fn replay(
    path: &Path,
    span: Span,
    build: impl FnOnce(&RunHeader) -> anyhow::Result<Box<dyn Replayable>>,
    out: &mut dyn Write,
) -> anyhow::Result<ReplayReport> {
    let run = match span.from {
        Some(moment) => Run::open_before(path, moment)?,
        None => Run::open(path)?,
    };
    let start_ns = run.start_ns();
    let mut robot = build(run.header())?;
    let mut knows = run.is_at_the_start();
    let not_the_start = (!knows).then(|| run.not_the_start());
    let mut report = ReplayReport { ticks: 0, mismatches: 0, unknown: 0, problem: None };
    let mut last = None;
    for tick in run {
        let tick = match tick {
            Ok(tick) => tick,
            Err(error) => {
                knows = false;
                writeln!(out, "warning: {error}")?;
                report.problem.get_or_insert(error);
                continue;
            }
        };
        last = Some((tick.tick, tick.time_ns));
        robot.hand_over(tick.tick);
        match &tick.snapshot {
            Some(snapshot) if !knows => {
                robot.restore(snapshot)?;
                writeln!(
                    out,
                    "from the snapshot of turn {} at {:.3} s",
                    tick.tick,
                    seconds(&tick)
                )?;
                knows = true;
            }
            _ if !knows => {
                report.unknown += 1;
                continue;
            }
            _ => {}
        }
        compare_turn(robot.as_mut(), &tick, &mut report, out)?;
        if span.until_mismatch && report.mismatches > 0 {
            break;
        }
    }
    if let Some(error) = not_the_start.filter(|_| report.ticks == 0) {
        return Err(error.into());
    }
    let stopped = span.until_mismatch && report.mismatches > 0;
    if let (Some(from), Some((turn, time_ns)), false) = (span.from, last, stopped)
        && !from.is_reached(turn, time_ns, start_ns)
    {
        anyhow::bail!("{} ends before {from}: its last turn is {turn}", path.display());
    }
    conclude(path, &report, out)?;
    Ok(report)
}

fn conclude(path: &Path, report: &ReplayReport, out: &mut dyn Write) -> anyhow::Result<()> {
    if report.mismatches > SHOWN_TURNS {
        writeln!(out, "... and {} more turns", report.mismatches - SHOWN_TURNS)?;
    }
    if report.unknown > 0 {
        writeln!(
            out,
            "warning: {} turns come before a snapshot and could not be recomputed",
            report.unknown
        )?;
    }
    if report.ticks == 0 && report.problem.is_none() {
        writeln!(out, "warning: {} holds no turns, so nothing was compared", path.display())?;
    }
    Ok(writeln!(out, "replay: ticks={} mismatches={}", report.ticks, report.mismatches)?)
}

fn seconds(tick: &RecordedTick) -> f64 {
    tick.time_ns as f64 * 1e-9
}

fn compare_turn(
    robot: &mut dyn Replayable,
    tick: &RecordedTick,
    report: &mut ReplayReport,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    // Only snapshots of this version can be compared; another version's decisions can.
    let remembers_otherwise = tick.snapshot.as_ref().is_some_and(|recorded| {
        recorded.starts_with(&SNAPSHOT_VERSION.to_le_bytes()) && *recorded != robot.snapshot()
    });
    let recomputed = robot.step(tick)?;
    report.ticks += 1;
    let mut differences = match &tick.decision {
        Some(recorded) => differences(recorded, &recomputed)?,
        None => vec![Difference::not_recorded()],
    };
    if remembers_otherwise {
        differences.push(Difference::memory());
    }
    if differences.is_empty() {
        return Ok(());
    }
    report.mismatches += 1;
    if report.mismatches <= SHOWN_TURNS {
        writeln!(out, "turn {} at {:.3} s decides differently:", tick.tick, seconds(tick))?;
        for difference in differences.iter().take(SHOWN_FIELDS) {
            writeln!(out, "  {difference}")?;
        }
        if differences.len() > SHOWN_FIELDS {
            writeln!(out, "  ... and {} more fields", differences.len() - SHOWN_FIELDS)?;
        }
    }
    Ok(())
}
