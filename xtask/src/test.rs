//! `cargo xtask test`: everything that must hold before a change is accepted.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::{Result, bail};

use crate::{command, nextest, onnx_runtime, paths, peers, trainer};

/// So often a program is killed in each of the tests that do that.
const KILLS: &str = "200";
const FEW_KILLS: &str = "6 of each are among the tests; `cargo xtask test --all` kills 200 times";

/// With what is left out by default.
const LINTS: &str = "clippy --workspace --all-targets --features pull-buffer/object-store,pull-buffer/lerobot,firmware-host/lerobot --locked -- -D warnings";

/// What tests build, once for all steps.
const TESTED: &str =
    "--workspace --features segment-store/lerobot,pull-buffer/object-store --locked";

/// What became of a step.
enum Outcome {
    Passed,
    Failed,
    Skipped(&'static str),
}

pub fn run(all: bool) -> Result<()> {
    let onnx_runtime = onnx_runtime::install()?;
    let cargo = |arguments: &str| {
        let mut cargo = command::cargo();
        cargo.args(arguments.split_whitespace()).env("ORT_DYLIB_PATH", &onnx_runtime);
        cargo
    };
    let ci = std::env::var_os("CI").is_some();
    let has_nextest = nextest::install();
    let tests = match (has_nextest, ci) {
        (true, true) => format!("nextest run {TESTED} --profile ci"),
        (true, false) => format!("nextest run {TESTED}"),
        (false, _) => format!("test {TESTED} --lib --bins --tests"),
    };
    let beside_peers = match has_nextest {
        true => format!("nextest run {TESTED} --run-ignored only"),
        false => format!("test {TESTED} --tests -- --ignored"),
    };
    let kills = match has_nextest {
        true => format!("nextest run {TESTED} --profile kills"),
        false => format!("test {TESTED} --tests killed"),
    };
    // All steps run, also after one has failed: whoever waited for them wants to know everything at once.
    let mut outcomes = vec![
        ("format", step(&mut cargo("fmt --all --check"))),
        ("lints", step(&mut cargo(LINTS))),
        ("tests", step(&mut cargo(&tests))),
        (
            "tests beside other people's software",
            match peers::of_tests(all || ci)? {
                Some(python) => step(cargo(&beside_peers).env("HIL_PYTHON", python)),
                None => (Outcome::Skipped("`cargo xtask test --all` installs it"), 0.0),
            },
        ),
        (
            "kills",
            if all {
                step(cargo(&kills).env("KILLS", KILLS))
            } else {
                (Outcome::Skipped(FEW_KILLS), 0.0)
            },
        ),
        (
            "examples in the documentation",
            step(&mut cargo(&format!("test {TESTED} --doc --quiet"))),
        ),
        ("licences and sources", licences()),
    ];
    outcomes.extend(without_ssh(ci).map(|outcome| ("tests over ssh", (outcome, 0.0))));
    outcomes.extend(trainer_steps(all || ci)?);
    println!();
    let mut failed = Vec::new();
    for (name, (outcome, seconds)) in &outcomes {
        match outcome {
            Outcome::Passed => println!("  passed   {name} ({seconds:.0} s)"),
            Outcome::Skipped(why) => println!("  skipped  {name}: {why}"),
            Outcome::Failed => {
                println!("  FAILED   {name} ({seconds:.0} s)");
                failed.push(*name);
            }
        }
    }
    if !failed.is_empty() {
        bail!("failed: {}", failed.join(", "));
    }
    println!("xtask test: all passed");
    Ok(())
}

/// Tests over ssh are among the tests, and pass without an sshd: nobody shall take that for more than it is.
fn without_ssh(ci: bool) -> Option<Outcome> {
    let skipped = Outcome::Skipped("there is no sshd: `apt-get install openssh-server`");
    let missing = if ci { Outcome::Failed } else { skipped };
    (!Path::new("/usr/sbin/sshd").exists()).then_some(missing)
}

/// Lints, types and tests of the trainer. PyTorch is large (5 GB, minutes): without `--all` and outside of CI, only who has
/// it already pays for it.
fn trainer_steps(install: bool) -> Result<Vec<(&'static str, (Outcome, f64))>> {
    if !install && !trainer::is_installed() {
        let why = "PyTorch is not installed; `cargo xtask test --all` installs it (5 GB)";
        return Ok(vec![("trainer", (Outcome::Skipped(why), 0.0))]);
    }
    let python = trainer::install()?;
    let module = |arguments: &str| {
        let mut module = command::program(&python);
        module
            .current_dir(paths::root().join("tools/trainer"))
            .arg("-m")
            .args(arguments.split_whitespace());
        step(&mut module)
    };
    Ok(vec![
        ("trainer: format", module("ruff format --check .")),
        ("trainer: lints", module("ruff check .")),
        ("trainer: types", module("mypy")),
        ("trainer: tests", module("pytest --quiet")),
    ])
}

fn step(command: &mut Command) -> (Outcome, f64) {
    println!("\n> {}", command::text(command));
    let start = Instant::now();
    let outcome = match command::run(command) {
        Ok(()) => Outcome::Passed,
        Err(error) => {
            eprintln!("{error:#}");
            Outcome::Failed
        }
    };
    (outcome, start.elapsed().as_secs_f64())
}

/// Advisories need a database from the network and change without us; a build must not fail by them.
fn licences() -> (Outcome, f64) {
    let mut deny = command::cargo();
    if command::works(command::cargo().args(["deny", "--version"])) {
        return step(deny.args(["deny", "check", "bans", "licenses", "sources"]));
    }
    (Outcome::Skipped("cargo-deny is not installed (`cargo install --locked cargo-deny`)"), 0.0)
}
