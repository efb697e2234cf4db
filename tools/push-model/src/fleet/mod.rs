//! `push-model --fleet`: sends a model to many robots, ring after ring, as far as the robots' own verdicts allow.
//!
//! | file | content |
//! |---|---|
//! | `file.rs` | the fleet's file: robots, rings and limits |
//! | `rings.rs` | which robot is in which ring |
//! | `state.rs`, `disk.rs` | what each robot has answered, and the file that keeps it between two passes |
//! | `answer.rs`, `verdict.rs` | what a robot's program says, and how that changes its verdict |
//! | `rollout.rs` | the decisions: which robots are sent the model, when the next ring begins, when to halt |
//! | `pass.rs`, `parallel.rs` | one pass over the robots, several at once |
//! | `robots.rs` | asking and sending over ssh |
//! | `table.rs` | the status for people and programs |

mod answer;
mod disk;
mod file;
mod parallel;
mod pass;
#[cfg(test)]
mod pass_tests;
mod rings;
mod robots;
mod rollout;
mod state;
mod table;
mod verdict;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail};
use clap::Args;
use signed_model::Bundle;

use crate::PushArgs;
use file::Fleet;
use parallel::in_parallel;
use pass::Pass;
use robots::{RealRobots, Robots};
use rollout::Standing;
use state::Rollout;

/// The exit codes, for the help.
pub const EXIT_CODES: &str = "Exit codes: 0 the robot accepted the model; 1 it did not, or an error.\n\
    With --fleet: 0 complete or waiting; 1 halted; 2 an error in the command line, FILE or the state, or the state cannot be written.";

/// Arguments of a rollout to a fleet.
#[derive(Debug, Args)]
pub struct FleetArgs {
    /// Send the model to the robots of this TOML file in rings: canaries, a share of the others, all. Each call makes one pass:
    /// it asks the robots how their trials went, sends to those that are due, and exits. The same call again goes on.
    #[arg(long, value_name = "FILE", help_heading = "Fleet")]
    pub fleet: Option<PathBuf>,
    /// Show every robot of the rollout and send nothing. Without a model: of the rollout that began last.
    #[arg(long, requires = "fleet", conflicts_with_all = ["wait", "resume"], help_heading = "Fleet")]
    status: bool,
    /// Go on after a halt. The robots that refused the model or rolled it back count no more.
    #[arg(long, requires = "fleet", help_heading = "Fleet")]
    resume: bool,
    /// Make passes until the rollout is complete or halts.
    #[arg(long, requires = "fleet", help_heading = "Fleet")]
    wait: bool,
    /// Time between two passes with --wait.
    #[arg(long, value_name = "SECONDS", requires = "wait", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86400), help_heading = "Fleet")]
    every: u64,
    /// File that keeps the state of the rollout [default: NAME.rollout-DIGEST.json beside FILE].
    #[arg(long, value_name = "PATH", requires = "fleet", help_heading = "Fleet")]
    state: Option<PathBuf>,
    /// Number of robots that are asked or sent to at once.
    #[arg(long, value_name = "N", requires = "fleet", default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..=64), help_heading = "Fleet")]
    parallel: u16,
    /// Print one JSON object instead of text.
    #[arg(long, requires = "fleet", help_heading = "Fleet")]
    json: bool,
}

/// Runs `push-model --fleet FILE`. An error is exit code 2, because 1 means that the rollout halted.
pub fn run(push: &PushArgs, file: &Path) -> ExitCode {
    let standing = if push.fleet.status { status(push, file) } else { roll_out(push, file) };
    match standing {
        Ok(Standing::Waiting | Standing::Complete) => ExitCode::SUCCESS,
        Ok(Standing::Halted) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// Makes one pass, or with `--wait` as many as are needed.
fn roll_out(push: &PushArgs, file: &Path) -> Result<Standing> {
    let args = &push.fleet;
    let bundle = crate::signed_bundle(push)?;
    let digest = blake3::hash(&bundle.model).to_hex().to_string();
    let fleet = Fleet::read(file)?;
    let path = args.state.clone().unwrap_or_else(|| disk::path_beside(file, &digest));
    let _lock = disk::lock(&path)?;
    let mut rollout = match begun(&path, &digest, &bundle.name)? {
        Some(rollout) => rollout,
        None if args.resume => bail!(
            "no rollout of this model has begun ({} does not exist), so there is none to resume; leave --resume out",
            path.display()
        ),
        None => rings::begin(&fleet, &digest, &bundle.name, now_unix_s()),
    };
    rings::follow(&mut rollout, &fleet, now_unix_s());
    if args.resume {
        rollout.resume();
    }
    let robots = real_robots(push, &fleet, &digest, Some(&bundle));
    let pass = Pass {
        robots: &robots,
        rules: &fleet.rules,
        parallel: usize::from(args.parallel),
        now_unix_s: &now_unix_s,
        save: &|rollout| disk::write(&path, rollout),
        tell: &|line| eprintln!("{line}"),
    };
    loop {
        pass.run(&mut rollout)?;
        if !args.wait || rollout.standing() != Standing::Waiting {
            break;
        }
        wait(Duration::from_secs(args.every));
    }
    show(&rollout, &fleet, &path, push, false);
    Ok(rollout.standing())
}

/// The rollout of this model that has begun, if there is one.
fn begun(path: &Path, digest: &str, model: &str) -> Result<Option<Rollout>> {
    let rollout = disk::read(path)?;
    if let Some(other) = rollout.as_ref().filter(|rollout| rollout.digest != digest) {
        bail!(
            "{} is the state of the rollout of {} ({}), and {model} is another model ({digest}); leave --state out, or give another path",
            path.display(),
            other.model,
            other.digest
        );
    }
    Ok(rollout)
}

/// Asks all robots and shows what they say. Neither sends anything nor changes the state.
fn status(push: &PushArgs, file: &Path) -> Result<Standing> {
    let fleet = Fleet::read(file)?;
    let path = match (&push.fleet.state, &push.bundle) {
        (Some(path), _) => path.clone(),
        (None, Some(model)) => {
            let bytes = std::fs::read(model)
                .with_context(|| format!("cannot read the model {}", model.display()))?;
            disk::path_beside(file, blake3::hash(&bytes).to_hex().as_str())
        }
        (None, None) => disk::newest_beside(file)?,
    };
    let mut rollout = disk::read(&path)?.with_context(|| {
        format!(
            "no rollout has begun: {} does not exist; leave --status out to begin one",
            path.display()
        )
    })?;
    rings::follow(&mut rollout, &fleet, now_unix_s());
    let digest = rollout.digest.clone();
    let robots = real_robots(push, &fleet, &digest, None);
    let names = rollout.robots.iter().map(|record| record.name.clone()).collect();
    in_parallel(
        names,
        usize::from(push.fleet.parallel),
        &mut rollout,
        |_, _| Ok(true),
        |name| robots.ask(name),
        |rollout, name, asked| {
            if let Some(record) = rollout.robot_mut(name) {
                record.take_over(&asked, now_unix_s());
            }
            Ok(())
        },
    )?;
    show(&rollout, &fleet, &path, push, true);
    Ok(rollout.standing())
}

fn real_robots<'a>(
    push: &'a PushArgs,
    fleet: &'a Fleet,
    digest: &'a str,
    bundle: Option<&'a Bundle>,
) -> RealRobots<'a> {
    RealRobots { fleet, digest, bundle, program: &push.program, ssh: &push.ssh, gate: &push.gate }
}

fn show(rollout: &Rollout, fleet: &Fleet, path: &Path, push: &PushArgs, has_table: bool) {
    let text = if push.fleet.json {
        table::as_json(rollout, &fleet.rules, path).to_string()
    } else if has_table {
        format!("{}\n\n{}", table::robots(rollout), table::summary(rollout, &fleet.rules))
    } else {
        table::summary(rollout, &fleet.rules)
    };
    // A reader that closes the pipe does not change what the rollout did.
    let _ = crate::print(format!("{text}\n").as_bytes());
}

fn now_unix_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs()
}

fn wait(time: Duration) {
    let end = Instant::now() + time;
    loop {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return;
        }
        // It may return early.
        std::thread::park_timeout(left);
    }
}
