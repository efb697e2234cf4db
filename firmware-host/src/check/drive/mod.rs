//! `firmware-host check --drive`: commissioning on the floor. The robot drives a short pattern through its own safety plane, and
//! what it measures is compared with what the safety plane assumes.

mod assumed;
mod file;
mod judge;
mod measure;
#[cfg(test)]
mod tests;

use std::io::{BufRead, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result, bail};
use drivers::fault::Faults;
use monotonic_clock::MonotonicClock;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::config::Config;
use crate::failure::sentence;
use crate::report::fit;
use crate::run::devices::open_for_safety;
use crate::run::instance_lock::InstanceLock;
use assumed::Assumed;
pub use file::require;
use measure::Course;

/// Shown to the person beside the robot before it moves.
const WARNING: &str = "The robot moves by up to 0.5 m ahead, slowly, rotates by 30 degrees to the left and back, and at last rolls out without \
                       commands. Put it on the floor \
                       that it will drive on, with 1 m free ahead, and stand beside it with a hand at the emergency stop.";

/// Drives the pattern, prints what was measured beside what is assumed, and writes `commissioning.toml` beside the configuration.
/// The exit code is 1 if a measured number is worse than the assumed one.
///
/// # Errors
/// The person did not confirm, a device cannot be opened, or the safety plane stopped the robot.
pub fn run(config: &Config, path: &Path, is_confirmed: bool) -> Result<ExitCode> {
    let _lock = InstanceLock::on(&config.devices.base.bus)?;
    println!("{}", fit::text(WARNING, fit::columns()));
    if !is_confirmed {
        print!("Type yes to start: ");
        std::io::stdout().flush()?;
        confirm(&mut std::io::stdin().lock())?;
    }
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&ends))
            .context("cannot listen for signals")?;
    }
    let no_faults = Faults::new(Vec::new(), 0, Arc::new(|| 0));
    let opened = open_for_safety(config, &no_faults)?;
    let assumed = Assumed::new(config);
    let mut course = Course::new(opened.control, MonotonicClock, &assumed, ends);
    course.stop_line = opened.stop_line;
    let measured = course.drive();
    course.finish();
    let measured = measured?;
    let judgements = judge::all(&measured, &assumed);
    println!("\n{}", fit::text(&judge::table(&judgements), fit::columns()));
    match file::write(config, path, &measured, &assumed, &judgements) {
        Ok(file) => println!("\nThe numbers are in {}.", file.display()),
        // The person has them on the screen.
        Err(error) => eprintln!("warning: {}", sentence(&error)),
    }
    let is_good = judgements.iter().all(|judgement| !judgement.is_worse);
    Ok(if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Reads the answer of the person beside the robot.
///
/// # Errors
/// The answer is not `yes`.
pub fn confirm(input: &mut impl BufRead) -> Result<()> {
    let mut answer = String::new();
    input.read_line(&mut answer)?;
    if answer.trim() != "yes" {
        bail!(
            "nothing was driven: `{}` is not `yes`; --yes starts without this question",
            answer.trim()
        );
    }
    Ok(())
}
