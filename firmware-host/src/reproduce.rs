//! `firmware-host reproduce`: extracts the seconds around a stop into a recording of their own.
//!
//! The first tick of the new file carries a snapshot of the robot's state, so the file can be
//! replayed without the rest of the run. It is small enough for a bug report and exact enough for a
//! regression test.

use std::fmt::Display;
use std::fs::File;
use std::io::{BufWriter, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Error, Result, anyhow, bail};
use runtime::event::{Event, SafetyEvent};
use runtime::recording::{RecordedTick, RecordingWriter, SegmentHeader, Views, sentence};

use crate::cli::ReproduceArgs;
use crate::output::Output;
use crate::record::segment_name;
use crate::replay::{Moment, ReplayError, Run, Span, open_segment, replay, segments};
use crate::replay_run::build;

/// Writes the file and replays it. Exits with 1 if this program decides differently than the robot
/// did.
///
/// # Errors
/// If the run has no such moment, the state before it cannot be recomputed, or the file cannot be
/// written.
pub fn run(args: &ReproduceArgs) -> Result<ExitCode> {
    if args.out.exists() {
        bail!("{} already exists; choose another --out", args.out.display());
    }
    let about = match args.at {
        Some(moment) => at(&args.run, moment)?,
        None => last_stop(&args.run)?,
    };
    println!("tick {}: {}", about.tick, what_happened(&about));
    let part = Part::create(&args.out)?;
    let ticks = write(args, &about, &part)?;
    part.keep()?;
    let mib = std::fs::metadata(&args.out)?.len() as f64 / f64::from(1 << 20);
    println!("{}: {ticks} ticks, {mib:.1} MiB", args.out.display());
    let report = replay(
        &args.out,
        Span::default(),
        |header| build(&args.out, header, &args.models),
        &mut Output,
    )?;
    Ok(if report.is_exact() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The first tick at or after this moment, unless the moment lies where ticks are missing.
fn at(run: &Path, moment: Moment) -> Result<RecordedTick> {
    let ticks = Run::open_before(run, moment)?;
    let start_ns = ticks.start_ns();
    let mut last = 0;
    let mut missing = Some("the recording begins after it".to_owned());
    for tick in ticks {
        match tick {
            Ok(tick) if moment.is_reached(tick.tick, tick.time_ns, start_ns) => {
                if let Some(missing) = missing.filter(|_| is_before(moment, &tick, start_ns)) {
                    bail!(
                        "{moment} cannot be reproduced: {missing}; choose an --at from tick {} on",
                        tick.tick
                    );
                }
                return Ok(tick);
            }
            Ok(tick) => {
                last = tick.tick;
                missing = None;
            }
            Err(error) if error.is_gap() => missing = Some(what_is_missing(&error)),
            Err(error) => {
                bail!("{moment} cannot be reproduced: {error}; choose an --at up to tick {last}")
            }
        }
    }
    bail!("{} ends before {moment}: its last tick is {last}", run.display())
}

/// Whether the moment lies before this tick by more than rounding.
fn is_before(moment: Moment, tick: &RecordedTick, start_ns: u64) -> bool {
    match moment {
        Moment::Tick(number) => number < tick.tick,
        Moment::Seconds(seconds) => {
            seconds + 1e-6 < tick.time_ns.saturating_sub(start_ns) as f64 * 1e-9
        }
    }
}

fn what_is_missing(error: &ReplayError) -> String {
    match error {
        ReplayError::Gap { path, expected, found } => {
            let last = found.saturating_sub(1);
            format!("ticks {expected} to {last} are missing ({})", file_name(path))
        }
        ReplayError::SegmentOrder { expected, .. } => {
            format!("{} is missing", segment_name(*expected))
        }
        other => other.to_string(),
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn last_stop(run: &Path) -> Result<RecordedTick> {
    let mut damage = Vec::new();
    let stop = segments(run)?.iter().rev().find_map(|path| last_stop_of(path, &mut damage));
    let damage = damage.join("; ");
    match stop {
        Some(stop) => {
            if !damage.is_empty() {
                eprintln!("warning: a later stop may be in what cannot be read; {damage}");
            }
            Ok(stop)
        }
        None if damage.is_empty() => {
            bail!("{} contains no stop and no fault; choose a moment with --at", run.display())
        }
        None => bail!("no stop in what can be read; {damage}; choose a moment with --at"),
    }
}

/// The last stop of a segment. What cannot be read of it is added to `damage`.
fn last_stop_of(path: &Path, damage: &mut Vec<String>) -> Option<RecordedTick> {
    let ticks = open_segment(path).inspect_err(|error| damage.push(error.to_string())).ok()?;
    let mut last = None;
    let mut stop = None;
    for tick in ticks {
        match tick {
            Ok(tick) => {
                last = Some(tick.tick);
                let has_stop = stops(&tick).next().is_some();
                if has_stop {
                    stop = Some(tick);
                }
            }
            Err(error) => {
                let after = last.map_or_else(String::new, |tick| format!(" after tick {tick}"));
                damage.push(format!("{} is damaged{after}: {error}", file_name(path)));
                break;
            }
        }
    }
    stop
}

fn stops(tick: &RecordedTick) -> impl Iterator<Item = &Event> {
    tick.decision.iter().flat_map(|decision| &decision.events).filter(|event| {
        matches!(
            event,
            Event::Safety { what: SafetyEvent::Tripped { .. } | SafetyEvent::Faulted { .. } }
        )
    })
}

fn what_happened(tick: &RecordedTick) -> String {
    let sentences: Vec<String> = stops(tick).map(|event| sentence(event).1).collect();
    if sentences.is_empty() { "the moment given by --at".to_owned() } else { sentences.join("; ") }
}

/// The unfinished file, under a name that nothing else has. It is removed unless it is kept.
struct Part<'a> {
    path: PathBuf,
    out: &'a Path,
}

impl<'a> Part<'a> {
    fn create(out: &'a Path) -> Result<Self> {
        let process = std::process::id();
        let mut attempt = 0;
        loop {
            let path = PathBuf::from(format!("{}.{process}-{attempt}.part", out.display()));
            match File::create_new(&path) {
                Ok(_) => return Ok(Self { path, out }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => attempt += 1,
                Err(error) => {
                    bail!("cannot write {}: {error}; choose another --out", out.display())
                }
            }
        }
    }

    fn unwritable(&self, error: &dyn Display) -> Error {
        let out = self.out.display();
        anyhow!("cannot write {out}: {error}; free disk space or choose another --out")
    }

    fn keep(self) -> Result<()> {
        // Another process may have made the file in the meantime.
        if self.out.exists() {
            bail!("{} already exists; choose another --out", self.out.display());
        }
        std::fs::rename(&self.path, self.out).map_err(|error| self.unwritable(&error))
    }
}

impl Drop for Part<'_> {
    fn drop(&mut self) {
        // Best effort: it is absent if it was kept, and another error has been reported.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Writes the ticks around `about`. Returns their number.
fn write(args: &ReproduceArgs, about: &RecordedTick, part: &Part<'_>) -> Result<u64> {
    let from_ns = about.time_ns.saturating_sub(nanoseconds(args.before));
    let start_ns = Run::open_before(&args.run, Moment::Tick(about.tick))?.start_ns();
    let from_s = from_ns.saturating_sub(start_ns) as f64 * 1e-9;
    let mut missing = None;
    // A segment that cannot be read ends the first attempt; the second one begins after it.
    for moment in [Moment::Seconds(from_s), Moment::Tick(about.tick)] {
        let run = match Run::open_before(&args.run, moment) {
            Ok(run) => run,
            Err(error) => {
                missing = Some(error.to_string());
                continue;
            }
        };
        if let Some(ticks) = extract(args, about, run, part, &mut missing)? {
            return Ok(ticks);
        }
    }
    let tick = about.tick;
    match missing {
        Some(missing) => bail!(
            "tick {tick} cannot be reproduced: {missing}, and no snapshot lies between that and tick {tick}; \
             choose an earlier --at, or one in the next segment"
        ),
        None => bail!(
            "tick {tick} cannot be reproduced: there is no snapshot before it; choose a later one with --at"
        ),
    }
}

/// Recomputes a run up to where the file begins, so that the first tick of the file can carry a
/// snapshot of the robot's state. Where ticks are missing before `about`, the file begins at the next
/// snapshot. Returns the number of ticks written; `None` if `about` cannot be recomputed.
fn extract(
    args: &ReproduceArgs,
    about: &RecordedTick,
    run: Run,
    part: &Part<'_>,
    missing: &mut Option<String>,
) -> Result<Option<u64>> {
    let from_ns = about.time_ns.saturating_sub(nanoseconds(args.before));
    let to_ns = about.time_ns + nanoseconds(args.after);
    let header = run.header().clone();
    let mut robot = build(&args.run, &header, &args.models)?;
    // Whether the robot's state is that of the recorded robot.
    let mut in_sync = run.is_at_the_start();
    let mut writer: Option<RecordingWriter<BufWriter<File>>> = None;
    let mut ticks = 0;
    let mut has_moment = false;
    for tick in run {
        let mut tick = match tick {
            Ok(tick) if tick.time_ns <= to_ns => tick,
            Ok(_) => break,
            // The file ends before a gap in the recording.
            Err(_) if has_moment => break,
            Err(error) => {
                *missing = Some(what_is_missing(&error));
                in_sync = false;
                writer = None;
                ticks = 0;
                continue;
            }
        };
        robot.hand_over(tick.tick);
        let mut begins_late = None;
        if let (false, Some(snapshot)) = (in_sync, &tick.snapshot) {
            robot.restore(snapshot)?;
            in_sync = true;
            begins_late = missing.as_deref();
        }
        if !in_sync && tick.tick >= about.tick {
            break;
        }
        if in_sync && writer.is_none() && tick.time_ns >= from_ns {
            if let Some(missing) = begins_late {
                println!("{missing}: the file begins at tick {}", tick.tick);
            }
            let file = File::create(&part.path).map_err(|error| part.unwritable(&error))?;
            let header = SegmentHeader::new(header.clone(), 0, tick.tick, tick.time_ns);
            let begun = RecordingWriter::begin(BufWriter::new(file), header);
            writer = Some(begun.map_err(|error| part.unwritable(&error))?);
            tick.snapshot = Some(robot.snapshot());
        }
        if let Some(writer) = &mut writer {
            let written = writer.write(&tick, &Views::default());
            written.map_err(|error| part.unwritable(&error))?;
            ticks += 1;
            has_moment |= tick.tick == about.tick;
        }
        if in_sync {
            robot.step(&tick)?;
        }
    }
    let Some(writer) = writer.filter(|_| has_moment) else { return Ok(None) };
    let file = writer.finish().map_err(|(_, error)| part.unwritable(&error))?;
    let file = file.into_inner().map_err(|error| part.unwritable(error.error()))?;
    file.sync_all().map_err(|error| part.unwritable(&error))?;
    Ok(Some(ticks))
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}
