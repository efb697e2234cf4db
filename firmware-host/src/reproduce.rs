//! `firmware-host reproduce`: the seconds around a stop, as a recording by itself.
//!
//! Its first turn carries what the robot remembered, so it replays alone: small enough for a bug report, exact enough for a test.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use runtime::event::{Event, SafetyEvent};
use runtime::recording::{RecordedTick, RecordingWriter, SegmentHeader, Views, sentence};

use crate::cli::ReproduceArgs;
use crate::replay::{Moment, Run, Span, open_segment, replay, segments};
use crate::replay_run::build;

/// Writes the file; exits with 1 when this program decides differently than the robot did.
///
/// # Errors
/// When there is no such moment, nothing can be recomputed before it, or the file cannot be written.
pub fn run(args: &ReproduceArgs) -> Result<ExitCode> {
    if args.out.exists() {
        bail!("{} is there already; choose another --out", args.out.display());
    }
    let about = match args.at {
        Some(moment) => at(&args.run, moment)?,
        None => last_stop(&args.run)?,
    };
    println!("turn {}: {}", about.tick, what_happened(&about));
    let part = PathBuf::from(format!("{}.part", args.out.display()));
    let written = write(args, &about, &part);
    if written.is_err() {
        // Best effort: the error itself is what counts.
        let _ = std::fs::remove_file(&part);
    }
    let turns = written?;
    std::fs::rename(&part, &args.out)
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    let mib = std::fs::metadata(&args.out)?.len() as f64 / f64::from(1 << 20);
    println!("{}: {turns} turns, {mib:.1} MiB", args.out.display());
    let report = replay(
        &args.out,
        Span::default(),
        |header| build(&args.out, header, &args.models),
        &mut std::io::stdout().lock(),
    )?;
    Ok(if report.is_exact() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn at(run: &Path, moment: Moment) -> Result<RecordedTick> {
    let turns = Run::open_before(run, moment)?;
    let start_ns = turns.start_ns();
    let mut last = 0;
    for tick in turns {
        match tick {
            Ok(tick) if moment.is_reached(tick.tick, tick.time_ns, start_ns) => return Ok(tick),
            Ok(tick) => last = tick.tick,
            Err(error) if !error.is_gap() => break,
            Err(_) => {}
        }
    }
    bail!("{} ends before {moment}: its last turn is {last}", run.display())
}

fn last_stop(run: &Path) -> Result<RecordedTick> {
    for path in segments(run)?.iter().rev() {
        let turns = open_segment(path)?.map_while(Result::ok);
        if let Some(tick) = turns.filter(|tick| stops(tick).next().is_some()).last() {
            return Ok(tick);
        }
    }
    bail!("{} holds no stop and no fault; say which moment with --at", run.display())
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
    if sentences.is_empty() { "as asked".to_owned() } else { sentences.join("; ") }
}

/// Recomputes the run up to where the file begins, so that its first turn can carry what the robot remembered; how many turns
/// were written.
fn write(args: &ReproduceArgs, about: &RecordedTick, part: &Path) -> Result<u64> {
    let ns = |seconds: f64| (seconds * 1e9) as u64;
    let (from_ns, to_ns) =
        (about.time_ns.saturating_sub(ns(args.before)), about.time_ns + ns(args.after));
    let run = Run::open(&args.run)?;
    let from_s = from_ns.saturating_sub(run.start_ns()) as f64 * 1e-9;
    let run = Run::open_before(&args.run, Moment::Seconds(from_s))?;
    let header = run.header().clone();
    let mut robot = build(&args.run, &header, &args.models)?;
    let mut knows = run.is_at_the_start();
    let mut writer: Option<RecordingWriter<BufWriter<File>>> = None;
    let mut turns = 0;
    for tick in run {
        let mut tick = match tick {
            Ok(tick) if tick.time_ns <= to_ns => tick,
            Err(error) if error.is_gap() && writer.is_none() => {
                knows = false;
                continue;
            }
            // A gap after the beginning: the file ends before it.
            _ => break,
        };
        robot.hand_over(tick.tick);
        if let (false, Some(snapshot)) = (knows, &tick.snapshot) {
            robot.restore(snapshot)?;
            knows = true;
        }
        if knows && writer.is_none() && tick.time_ns >= from_ns {
            let file = File::create_new(part)
                .with_context(|| format!("cannot create {}", part.display()))?;
            let header = SegmentHeader::new(header.clone(), 0, tick.tick, tick.time_ns);
            writer = Some(RecordingWriter::begin(BufWriter::new(file), header)?);
            tick.snapshot = Some(robot.snapshot());
        }
        if let Some(writer) = &mut writer {
            writer.write(&tick, &Views::default())?;
            turns += 1;
        }
        if knows {
            robot.step(&tick)?;
        }
    }
    let Some(writer) = writer else {
        bail!(
            "nothing at that moment can be recomputed: there is no snapshot before it; choose a later one with --at"
        )
    };
    let file = writer.finish().map_err(|(_, error)| error)?;
    file.into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()?;
    Ok(turns)
}
