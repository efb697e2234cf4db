//! `firmware-host reproduce`: extracts the seconds around a stop into a recording of their own.
//!
//! The first tick of the new file carries a snapshot of the robot's state, so the file can be
//! replayed without the rest of the run. It is small enough for a bug report and exact enough for a
//! regression test.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use runtime::event::{Event, SafetyEvent};
use runtime::recording::{RecordedTick, RecordingWriter, SegmentHeader, Views, sentence};

use crate::cli::ReproduceArgs;
use crate::output::Output;
use crate::replay::{Moment, Run, Span, open_segment, replay, segments};
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
    let part = PathBuf::from(format!("{}.part", args.out.display()));
    let written = write(args, &about, &part);
    if written.is_err() {
        // Best effort: the error of the write is the one to report.
        let _ = std::fs::remove_file(&part);
    }
    let ticks = written?;
    std::fs::rename(&part, &args.out)
        .with_context(|| format!("cannot write {}", args.out.display()))?;
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

fn at(run: &Path, moment: Moment) -> Result<RecordedTick> {
    let ticks = Run::open_before(run, moment)?;
    let start_ns = ticks.start_ns();
    let mut last = 0;
    for tick in ticks {
        match tick {
            Ok(tick) if moment.is_reached(tick.tick, tick.time_ns, start_ns) => return Ok(tick),
            Ok(tick) => last = tick.tick,
            Err(error) if !error.is_gap() => break,
            Err(_) => {}
        }
    }
    bail!("{} ends before {moment}: its last tick is {last}", run.display())
}

fn last_stop(run: &Path) -> Result<RecordedTick> {
    for path in segments(run)?.iter().rev() {
        let ticks = open_segment(path)?.map_while(Result::ok);
        if let Some(tick) = ticks.filter(|tick| stops(tick).next().is_some()).last() {
            return Ok(tick);
        }
    }
    bail!("{} contains no stop and no fault; choose a moment with --at", run.display())
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

/// Recomputes the run up to where the file begins, so that the first tick of the file can carry a
/// snapshot of the robot's state. Returns the number of ticks written.
fn write(args: &ReproduceArgs, about: &RecordedTick, part: &Path) -> Result<u64> {
    let from_ns = about.time_ns.saturating_sub(nanoseconds(args.before));
    let to_ns = about.time_ns + nanoseconds(args.after);
    let run = Run::open(&args.run)?;
    let from_s = from_ns.saturating_sub(run.start_ns()) as f64 * 1e-9;
    let run = Run::open_before(&args.run, Moment::Seconds(from_s))?;
    let header = run.header().clone();
    let mut robot = build(&args.run, &header, &args.models)?;
    // Whether the robot's state is that of the recorded robot.
    let mut in_sync = run.is_at_the_start();
    let mut writer: Option<RecordingWriter<BufWriter<File>>> = None;
    let mut ticks = 0;
    for tick in run {
        let mut tick = match tick {
            Ok(tick) if tick.time_ns <= to_ns => tick,
            Err(error) if error.is_gap() && writer.is_none() => {
                in_sync = false;
                continue;
            }
            // The file ends before a gap in the recording.
            _ => break,
        };
        robot.hand_over(tick.tick);
        if let (false, Some(snapshot)) = (in_sync, &tick.snapshot) {
            robot.restore(snapshot)?;
            in_sync = true;
        }
        if in_sync && writer.is_none() && tick.time_ns >= from_ns {
            let file = File::create_new(part)
                .with_context(|| format!("cannot create {}", part.display()))?;
            let header = SegmentHeader::new(header.clone(), 0, tick.tick, tick.time_ns);
            writer = Some(RecordingWriter::begin(BufWriter::new(file), header)?);
            tick.snapshot = Some(robot.snapshot());
        }
        if let Some(writer) = &mut writer {
            writer.write(&tick, &Views::default())?;
            ticks += 1;
        }
        if in_sync {
            robot.step(&tick)?;
        }
    }
    let Some(writer) = writer else {
        bail!(
            "this moment cannot be recomputed because there is no snapshot before it; choose a later one \
             with --at"
        )
    };
    let file = writer.finish().map_err(|(_, error)| error)?;
    file.into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()?;
    Ok(ticks)
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}
