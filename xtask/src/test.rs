//! `cargo xtask test`: the checks that a change must pass.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread::JoinHandle;
use std::time::Instant;

use anyhow::{Result, bail, ensure};

use crate::{
    command, docs, ignored, licences, memory_folder, nextest, onnx_runtime, paths, peers, quality,
    real_time, trainer,
};

/// Duration of the first run on 2 cores without the trainer, rounded up: build and lints 6 minutes, tests 6.5, quality 0.7. Machines on
/// which the cores are shared need up to twice as long.
const FIRST_RUN_MIN: u32 = 15;
const LATER_RUN_MIN: u32 = 8;

/// How often each of the tests that kill programs does so.
const KILLS: &str = "200";
const FEW_KILLS: &str = "6 of each are among the tests; `cargo xtask test --all` kills 200 times";
/// Ignored tests of the live view that measure or draw, and have no peer.
const NO_MEASUREMENTS: &str =
    "--skip cost_of_the_view --skip figures_of_the_link --skip screenshots_for_the_documentation";
const NO_SMALL_BUILD: &str = "`cargo xtask test --all` checks that it compiles";
const NO_SITE: &str = "its links are checked by a test; `cargo xtask docs` builds it";

/// What is built, once for all steps: the workspace with the features that are off by default.
const TESTED: &str = "--workspace --features pull-buffer/object-store --locked";

/// `cargo build` with the features and lints of the tests, so that what they built is not built again.
///
/// # Errors
/// When clippy is not installed.
pub fn cargo_build() -> Result<Command> {
    let mut cargo = command::cargo();
    cargo.arg("build").args(TESTED.split_whitespace());
    Lints::new()?.during(&mut cargo);
    Ok(cargo)
}

/// The result of a step.
pub enum Outcome {
    Passed,
    Failed,
    Skipped(&'static str),
}

/// A step's name, result and duration in seconds.
pub type Step = (&'static str, (Outcome, f64));

/// Runs all steps, even after one has failed, so that one run shows every failure.
///
/// # Errors
/// When a step has failed.
pub fn run(all: bool) -> Result<()> {
    println!(
        "On 2 cores the first run takes {FIRST_RUN_MIN} minutes and a later one {LATER_RUN_MIN}; on shared cores up to twice as long."
    );
    let onnx_runtime = onnx_runtime::install()?;
    let lints = Lints::new()?;
    let memory = memory_folder::new()?;
    let cargo = |arguments: &str| {
        let mut cargo = command::cargo();
        cargo.args(arguments.split_whitespace()).env("ORT_DYLIB_PATH", &onnx_runtime);
        cargo.envs(memory.as_ref().map(|memory| ("TMPDIR", memory.path())));
        lints.during(&mut cargo);
        cargo
    };
    let ci = std::env::var_os("CI").is_some();
    // Most of that time is spent waiting for downloads, while the workspace is built.
    let trainer = (all || ci).then(|| std::thread::spawn(trainer::install));
    let has_nextest = nextest::install();
    let build = match has_nextest {
        true => format!("nextest run {TESTED} --no-run"),
        false => format!("test {TESTED} --lib --bins --tests --no-run"),
    };
    let beside_peers = match has_nextest {
        true => format!(
            "nextest run {TESTED} --run-ignored only -E not(test(shared_scenes)|package(pull-buffer)|package(push-model)|binary(live))"
        ),
        false => {
            format!("test {TESTED} --tests -- --ignored {NO_MEASUREMENTS} {}", ignored::skipped())
        }
    };
    let kills = match has_nextest {
        true => format!("nextest run {TESTED} --profile kills"),
        false => format!("test {TESTED} --tests killed"),
    };
    let mut outcomes = vec![
        ("format", step(command::cargo().args(["fmt", "--all", "--check"]))),
        ("build and lints", step(&mut cargo(&build))),
    ];
    match has_nextest {
        true => outcomes.extend(tests(&cargo, ci)?),
        false => {
            let all = format!("test {TESTED} --lib --bins --tests");
            outcomes.push(("tests", step(&mut cargo(&all))));
        }
    }
    outcomes.extend([
        ("quality of depth and map", quality()),
        (
            "tests beside other people's software",
            match peers::of_tests(all || ci)? {
                Some(python) => step(cargo(&beside_peers).env("HIL_PYTHON", python)),
                None => (Outcome::Skipped("`cargo xtask test --all` installs it"), 0.0),
            },
        ),
        (
            "kills",
            match all {
                true => step(cargo(&kills).env("KILLS", KILLS)),
                false => (Outcome::Skipped(FEW_KILLS), 0.0),
            },
        ),
        (
            "examples in the documentation",
            step(&mut cargo(&format!("test {TESTED} --doc --quiet"))),
        ),
        (
            "pull-buffer without optional features",
            match all || ci {
                true => step(&mut cargo("check --locked --package pull-buffer")),
                false => (Outcome::Skipped(NO_SMALL_BUILD), 0.0),
            },
        ),
        ("licences and sources", licences::check(all || ci)),
        (
            "documentation site",
            if all || ci { timed(docs::run) } else { (Outcome::Skipped(NO_SITE), 0.0) },
        ),
    ]);
    outcomes.extend(ignored::steps(&cargo, TESTED, has_nextest, ci));
    outcomes.extend(without_ssh(ci).map(|outcome| ("tests over ssh", (outcome, 0.0))));
    outcomes.extend(trainer_steps(trainer)?);
    conclude(&outcomes)
}

/// Runs the tests in real time, and beside them the others.
fn tests(cargo: &dyn Fn(&str) -> Command, ci: bool) -> Result<[Step; 2]> {
    let [profile, real_time_profile] = if ci { ["ci", "ci-real-time"] } else { ["default"; 2] };
    let mut real_time = cargo(&format!("nextest run {TESTED} --profile {real_time_profile} -E"));
    real_time.arg(real_time::FILTER);
    let mut others = cargo(&format!("nextest run {TESTED} --profile {profile} -E"));
    others.arg(format!("not ({})", real_time::FILTER));
    let [real_time, others] = real_time::run_beside(real_time, &others)?;
    Ok([("tests in real time", real_time), ("other tests", others)])
}

fn conclude(outcomes: &[Step]) -> Result<()> {
    println!();
    let mut failed = Vec::new();
    let mut skipped = 0;
    for (name, (outcome, seconds)) in outcomes {
        match outcome {
            Outcome::Passed => println!("  passed   {name} ({seconds:.0} s)"),
            Outcome::Skipped(why) => {
                skipped += 1;
                println!("  skipped  {name}: {why}");
            }
            Outcome::Failed => {
                println!("  FAILED   {name} ({seconds:.0} s)");
                failed.push(*name);
            }
        }
    }
    if !failed.is_empty() {
        bail!("failed: {}", failed.join(", "));
    }
    match skipped {
        0 => println!("xtask test: all {} steps passed", outcomes.len()),
        _ => println!("xtask test: {} steps passed, {skipped} skipped", outcomes.len() - skipped),
    }
    Ok(())
}

/// Clippy's compiler, which builds the workspace's crates, so that lints need no second compilation.
struct Lints {
    compiler: PathBuf,
}

impl Lints {
    fn new() -> Result<Self> {
        let sysroot = command::output(command::program("rustc").args(["--print", "sysroot"]))?;
        let compiler = Path::new(sysroot.trim()).join("bin/clippy-driver");
        ensure!(
            compiler.exists(),
            "{} is missing: `rustup component add clippy`",
            compiler.display()
        );
        Ok(Self { compiler })
    }

    /// Makes a cargo command lint the crates that it compiles, with warnings as errors. `cargo clippy` sets the same two
    /// variables.
    fn during(&self, cargo: &mut Command) {
        cargo.env("RUSTC_WORKSPACE_WRAPPER", &self.compiler);
        cargo.env("CLIPPY_ARGS", "-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__");
    }
}

/// Runs the quality gate with the program that the tests use.
fn quality() -> (Outcome, f64) {
    timed(|| quality::run(&paths::target().join("debug/firmware-host"), false))
}

fn timed(work: impl FnOnce() -> Result<()>) -> (Outcome, f64) {
    let start = Instant::now();
    let outcome = match work() {
        Ok(()) => Outcome::Passed,
        Err(error) => {
            eprintln!("{error:#}");
            Outcome::Failed
        }
    };
    (outcome, start.elapsed().as_secs_f64())
}

/// Reports the tests over ssh as skipped if there is no sshd, because they are among the other tests and ignored then.
fn without_ssh(ci: bool) -> Option<Outcome> {
    let skipped = Outcome::Skipped("sshd is missing: `apt-get install openssh-server`");
    let missing = if ci { Outcome::Failed } else { skipped };
    (!Path::new("/usr/sbin/sshd").exists()).then_some(missing)
}

/// Lints, types and tests of the trainer, when `installing` has ended. Without `--all` and outside of CI nothing is installed, and they
/// are skipped if PyTorch (5 GB) is not there.
fn trainer_steps(installing: Option<JoinHandle<Result<PathBuf>>>) -> Result<Vec<Step>> {
    if installing.is_none() && !trainer::is_installed() {
        let why = "PyTorch is not installed; `cargo xtask test --all` installs it (5 GB)";
        return Ok(vec![("trainer", (Outcome::Skipped(why), 0.0))]);
    }
    let python = match installing.map(JoinHandle::join) {
        Some(Ok(installed)) => installed?,
        Some(Err(_)) => bail!("the installation of the trainer panicked"),
        None => trainer::install()?,
    };
    let processes = trainer::test_processes();
    let pytest =
        format!("pytest --quiet --numprocesses {processes} --dist loadgroup --durations 15");
    Ok(vec![
        ("trainer: format", module("ruff format --check .", &python)),
        ("trainer: lints", module("ruff check .", &python)),
        ("trainer: types", module("mypy", &python)),
        ("trainer: tests", module(&pytest, &python)),
    ])
}

fn module(arguments: &str, python: &Path) -> (Outcome, f64) {
    let mut module = command::program(python);
    module
        .current_dir(paths::root().join("tools/trainer"))
        // One thread in each process of the tests, because there is a process for each processor.
        .env("OMP_NUM_THREADS", "1")
        .arg("-m")
        .args(arguments.split_whitespace());
    step(&mut module)
}

pub fn step(command: &mut Command) -> (Outcome, f64) {
    println!("\n> {}", command::text(command));
    timed(|| command::run(command))
}
