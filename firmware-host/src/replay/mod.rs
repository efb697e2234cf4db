//! `firmware-host replay RUN`: recomputes the decisions of a recorded run and compares them with the recorded ones.

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

/// Number of mismatching ticks that are shown in full. Most of the others only follow from the first.
const SHOWN_TICKS: u64 = 3;

/// Number of differing fields that are shown of one tick.
const SHOWN_FIELDS: usize = 8;

/// The loop of a recorded run, which replay steps tick by tick.
pub trait Replayable {
    /// Loads the network that the run used from this tick on, if it changed.
    fn hand_over(&mut self, tick: u64);
    /// Restores the robot's memory from a snapshot.
    ///
    /// # Errors
    /// When the snapshot is of another version or another robot, or needs a model that is missing.
    fn restore(&mut self, snapshot: &[u8]) -> anyhow::Result<()>;
    /// The robot's memory.
    fn snapshot(&self) -> Vec<u8>;
    /// Recomputes the decision of a recorded tick.
    ///
    /// # Errors
    /// When a frame's bytes do not fit its size.
    fn step(&mut self, tick: &RecordedTick) -> anyhow::Result<Decision>;
}

/// Which ticks are recomputed.
#[derive(Debug, Clone, Copy, Default)]
pub struct Span {
    /// Begin at the last segment with a snapshot at or before this moment; `None`: at the first tick that can be recomputed.
    pub from: Option<Moment>,
    /// Stop after the first tick whose decision differs.
    pub until_mismatch: bool,
}

/// Result of a replay.
#[derive(Debug)]
pub struct ReplayReport {
    /// Number of ticks that were recomputed.
    pub ticks: u64,
    /// Number of ticks whose recomputed decision differs from the recorded one.
    pub mismatches: u64,
    /// Number of ticks that could not be recomputed because the robot's memory before them is unknown.
    pub unknown: u64,
    /// The first defect of the run: it is truncated, or ticks are missing.
    pub problem: Option<ReplayError>,
}

impl ReplayReport {
    /// Whether every tick from the first recomputed one on was recomputed and has the same decision.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        self.ticks > 0 && self.mismatches == 0 && self.problem.is_none()
    }
}

/// Recomputes the run at `path` (the `--out` directory of a run, or one .mcap file) with the loop that `build` creates from
/// its header. Writes the first mismatches to `out`, and `replay: ticks=N mismatches=M` as the last line. A truncated run
/// is replayed up to its end. Where ticks are missing, the replay goes on at the next snapshot.
///
/// # Errors
/// When no tick can be replayed, the loop cannot be built, or `out` cannot be written.
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
    let mut memory_known = run.is_at_the_start();
    let not_the_start = (!memory_known).then(|| run.not_the_start());
    let mut report = ReplayReport { ticks: 0, mismatches: 0, unknown: 0, problem: None };
    let mut last = None;
    for tick in run {
        let tick = match tick {
            Ok(tick) => tick,
            Err(error) => {
                memory_known = false;
                writeln!(out, "warning: {error}")?;
                report.problem.get_or_insert(error);
                continue;
            }
        };
        last = Some((tick.tick, tick.time_ns));
        robot.hand_over(tick.tick);
        match &tick.snapshot {
            Some(snapshot) if !memory_known => {
                robot.restore(snapshot)?;
                writeln!(
                    out,
                    "replaying from the snapshot of tick {} at {:.3} s",
                    tick.tick,
                    seconds(&tick)
                )?;
                memory_known = true;
            }
            _ if !memory_known => {
                report.unknown += 1;
                continue;
            }
            _ => {}
        }
        compare_tick(robot.as_mut(), &tick, &mut report, out)?;
        if span.until_mismatch && report.mismatches > 0 {
            break;
        }
    }
    if let Some(error) = not_the_start.filter(|_| report.ticks == 0) {
        return Err(error.into());
    }
    let stopped = span.until_mismatch && report.mismatches > 0;
    if let (Some(from), Some((tick, time_ns)), false) = (span.from, last, stopped)
        && !from.is_reached(tick, time_ns, start_ns)
    {
        anyhow::bail!("{} ends before {from}: its last tick is {tick}", path.display());
    }
    conclude(path, &report, out)?;
    Ok(report)
}

fn conclude(path: &Path, report: &ReplayReport, out: &mut dyn Write) -> anyhow::Result<()> {
    if report.mismatches > SHOWN_TICKS {
        writeln!(out, "... and {} more ticks", report.mismatches - SHOWN_TICKS)?;
    }
    if report.unknown > 0 {
        writeln!(
            out,
            "warning: {} ticks before the first snapshot could not be recomputed",
            report.unknown
        )?;
    }
    if report.ticks == 0 && report.problem.is_none() {
        writeln!(out, "warning: {} has no ticks, so nothing was compared", path.display())?;
    }
    Ok(writeln!(out, "replay: ticks={} mismatches={}", report.ticks, report.mismatches)?)
}

fn seconds(tick: &RecordedTick) -> f64 {
    tick.time_ns as f64 * 1e-9
}

fn compare_tick(
    robot: &mut dyn Replayable,
    tick: &RecordedTick,
    report: &mut ReplayReport,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    // Snapshots of other versions cannot be compared; their decisions can.
    let memory_differs = tick.snapshot.as_ref().is_some_and(|recorded| {
        recorded.starts_with(&SNAPSHOT_VERSION.to_le_bytes()) && *recorded != robot.snapshot()
    });
    let recomputed = robot.step(tick)?;
    report.ticks += 1;
    let mut differences = match &tick.decision {
        Some(recorded) => differences(recorded, &recomputed)?,
        None => vec![Difference::not_recorded()],
    };
    if memory_differs {
        differences.push(Difference::memory());
    }
    if differences.is_empty() {
        return Ok(());
    }
    report.mismatches += 1;
    if report.mismatches <= SHOWN_TICKS {
        writeln!(out, "tick {} at {:.3} s: the decision differs:", tick.tick, seconds(tick))?;
        for difference in differences.iter().take(SHOWN_FIELDS) {
            writeln!(out, "  {difference}")?;
        }
        if differences.len() > SHOWN_FIELDS {
            writeln!(out, "  ... and {} more fields", differences.len() - SHOWN_FIELDS)?;
        }
    }
    Ok(())
}
