//! Copies recorded segments from robots; see `pull-buffer --help` and docs/pull-buffer.md.
#![forbid(unsafe_code)]

mod options;
mod progress;
mod robot;
mod store;

use std::io::Write;
use std::process::ExitCode;
use std::sync::Mutex;

use clap::Parser;
use hal::Clock;
use monotonic_clock::MonotonicClock;
use options::Options;
use progress::Display;
use robot::{Outcome, Robot};
use segment_store::source::{Location, Spec};
use segment_store::{ErrorKind, StoreError};
use store::Keys;

/// An error that needs the operator's attention.
const FAILED: u8 = 1;
/// Invalid arguments; the same code as clap uses.
const MISUSED: u8 = 2;
/// Only links failed, and the same command resumes later (`EX_TEMPFAIL` of sysexits).
const TRY_AGAIN: u8 = 75;

fn main() -> ExitCode {
    let options = Options::parse();
    if let Some(text) = options.manual() {
        // A reader that closes the pipe does not want the rest.
        let _ = std::io::stdout().write_all(&text);
        return ExitCode::SUCCESS;
    }
    match run(&options) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(code_of(&error))
        }
    }
}

fn code_of(error: &StoreError) -> u8 {
    match error.kind() {
        ErrorKind::Link => TRY_AGAIN,
        ErrorKind::Usage => MISUSED,
        ErrorKind::Disk | ErrorKind::Refused => FAILED,
    }
}

/// Pulls from every source in a thread of its own. Returns the most serious exit code.
fn run(options: &Options) -> Result<u8, StoreError> {
    let specs = specs(options)?;
    let keys = keys(options, &specs)?;
    let display = Display::new(options.json);
    let worst = Mutex::new(0);
    std::thread::scope(|scope| {
        for spec in &specs {
            let display = &display;
            let keys = &keys;
            let worst = &worst;
            scope.spawn(move || {
                let code = follow(&mut Robot::new(spec, options, keys), options, display);
                if let Ok(mut worst) = worst.lock() {
                    // Retrying later helps only when nothing else is wrong.
                    *worst =
                        if *worst == 0 || *worst == TRY_AGAIN && code != 0 { code } else { *worst };
                }
            });
        }
    });
    Ok(worst.into_inner().unwrap_or(FAILED))
}

fn specs(options: &Options) -> Result<Vec<Spec>, StoreError> {
    let specs =
        options.sources().iter().map(|text| Spec::parse(text)).collect::<Result<Vec<_>, _>>()?;
    for (at, spec) in specs.iter().enumerate() {
        if specs.iter().take(at).any(|other| other.name == spec.name) {
            let text = format!(
                "two sources are called {:?}; write NAME=SOURCE to tell them apart",
                spec.name
            );
            return Err(StoreError::Usage(text));
        }
        if let (Some(to), Location::ObjectStore(from)) =
            (options.destination_store(), &spec.location)
        {
            let text = format!(
                "{from} to {to}: cannot copy from one object store to another; use rclone or the store's own program"
            );
            return Err(StoreError::Usage(text));
        }
    }
    // Before anything is pulled.
    if let Some(layout) = options.layout {
        layout.check()?;
    }
    if let (Some(to), Some(_)) = (options.destination_store(), options.layout) {
        return Err(StoreError::Usage(format!("{to}: --as can only write into a directory")));
    }
    Ok(specs)
}

/// The keys that segments are encrypted to or decrypted with. Refuses keys that would not be used, because a segment would then
/// stay as it is.
fn keys(options: &Options, specs: &[Spec]) -> Result<Keys, StoreError> {
    if !options.encrypt_to.is_empty() && options.destination_store().is_none() {
        return Err(StoreError::Usage(format!(
            "--encrypt-to encrypts what an object store gets, but {} is a directory; give s3://BUCKET/PREFIX as DEST, or leave it out",
            options.destination().display()
        )));
    }
    let is_store = |spec: &Spec| matches!(spec.location, Location::ObjectStore(_));
    if !options.identity.is_empty() && !specs.iter().any(is_store) {
        let text = "--identity decrypts what comes from an object store, but no SOURCE is one; leave it out";
        return Err(StoreError::Usage(text.to_owned()));
    }
    Keys::read(&options.encrypt_to, &options.identity)
}

/// Pulls once or, with --follow, repeatedly. Returns the exit code.
fn follow(robot: &mut Robot<'_>, options: &Options, display: &Display) -> u8 {
    let mut clock = MonotonicClock;
    loop {
        let outcome = robot.pull(display, &mut clock);
        display.outcome(robot.spec(), &outcome, options.follow);
        match (&outcome, options.follow) {
            (Outcome { error: Some(error), .. }, false) => return code_of(error),
            // A robot that was reached before may come back; one that never answered is not waited for.
            (Outcome { error: Some(error), .. }, true)
                if error.kind() != ErrorKind::Link && !robot.has_been_reached() =>
            {
                return code_of(error);
            }
            (Outcome { error: Some(error), .. }, true) if error.kind() == ErrorKind::Disk => {
                return FAILED;
            }
            (_, false) => return if outcome.report.unread.is_empty() { 0 } else { FAILED },
            (_, true) => {
                let deadline_ns = clock.now_ns() + options.every_s * 1_000_000_000;
                clock.sleep_until_ns(deadline_ns);
            }
        }
    }
}
