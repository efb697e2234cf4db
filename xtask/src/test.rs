//! `cargo xtask test`: everything that must hold before a change is accepted.

use std::process::Command;
use std::time::Instant;

use anyhow::{Result, bail};

use crate::{command, nextest, onnx_runtime};

/// What became of a step.
enum Outcome {
    Passed,
    Failed,
    Skipped(&'static str),
}

pub fn run() -> Result<()> {
    let onnx_runtime = onnx_runtime::install()?;
    let cargo = |arguments: &str| {
        let mut cargo = command::cargo();
        cargo.args(arguments.split_whitespace()).env("ORT_DYLIB_PATH", &onnx_runtime);
        cargo
    };
    let tests = match (nextest::install(), std::env::var_os("CI").is_some()) {
        (true, true) => "nextest run --workspace --locked --profile ci",
        (true, false) => "nextest run --workspace --locked",
        (false, _) => "test --workspace --locked --lib --bins --tests",
    };
    // All steps run, also after one has failed: whoever waited for them wants to know everything at once.
    let outcomes = [
        ("format", step(&mut cargo("fmt --all --check"))),
        ("lints", step(&mut cargo("clippy --workspace --all-targets --locked -- -D warnings"))),
        ("tests", step(&mut cargo(tests))),
        ("examples in the documentation", step(&mut cargo("test --workspace --locked --doc --quiet"))),
        ("licences and sources", licences()),
    ];
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
