//! `cargo xtask fuzz`: whatever reads bytes from outside gets all sorts of them, by LLVM's libFuzzer.
//!
//! The stable compiler is enough: coverage is a pass of LLVM's, and the address sanitizer, for which `cargo fuzz` wants the nightly
//! one, looks for errors that code without `unsafe` cannot have. Only our own crates say what was reached, so that all others are
//! those of every other build. A C++ compiler builds libFuzzer itself.

use std::fs::{self, File};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};

use crate::command;
use crate::paths;

/// What `cargo fuzz` sets, but the sanitizer.
const COVERAGE: [&str; 6] = [
    "-Cpasses=sancov-module",
    "-Cllvm-args=-sanitizer-coverage-level=4",
    "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters",
    "-Cllvm-args=-sanitizer-coverage-pc-table",
    "-Cllvm-args=-sanitizer-coverage-trace-compares",
    "-Cllvm-args=-simplifycfg-branch-fold-threshold=0",
];
/// What a committed corpus may take.
const MOST_CORPUS_BYTES: u64 = 150_000;
/// With this set we are cargo's RUSTC_WORKSPACE_WRAPPER, which it calls for our own crates only.
const AS_WRAPPER: &str = "XTASK_FUZZ_WRAPPER";
/// An input that takes longer is a finding. The slowest that is none takes a second on a busy computer.
const SLOWEST_S: u64 = 20;
/// More memory than this, MiB, is a finding.
const MOST_MEMORY_MIB: u64 = 2048;

/// Fuzzes each target, or those named, for so many seconds. With `keep`, inputs that reached new code then go into the
/// committed corpora, which are made as small as that allows.
///
/// # Errors
/// When the targets do not build, there is none of a name, or one has found something.
pub fn run(seconds: u64, keep: bool, names: &[String]) -> Result<()> {
    let targets = targets(names)?;
    let programs = build()?;
    let place = Place { programs, dir: paths::target().join("fuzz") };
    let cores =
        std::thread::available_parallelism().map_or(1, std::num::NonZero::get).min(targets.len());
    let rounds = targets.len().div_ceil(cores) as u64;
    println!(
        "{} targets, {seconds} s each, {cores} at a time: {} s",
        targets.len(),
        rounds * seconds
    );
    let next = AtomicUsize::new(0);
    let outcomes: Vec<Result<bool>> = std::thread::scope(|scope| {
        let worker = || {
            let mut outcomes = Vec::new();
            while let Some(target) = targets.get(next.fetch_add(1, Ordering::Relaxed)) {
                outcomes.push(fuzz(&place, target, seconds));
            }
            outcomes
        };
        let workers: Vec<_> = (0..cores).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap_or_default()).collect()
    });
    let outcomes = outcomes.into_iter().collect::<Result<Vec<bool>>>()?;
    if outcomes.contains(&false) || outcomes.len() != targets.len() {
        bail!(
            "fuzzing has found something; the input and what was said are in {}",
            place.dir.join("findings").display()
        );
    }
    if keep {
        targets.iter().try_for_each(|target| minimise(&place, target))?;
    }
    Ok(())
}

/// Where things lie.
struct Place {
    programs: PathBuf,
    dir: PathBuf,
}

fn committed(target: &str) -> PathBuf {
    paths::root().join("tests/fuzzing/corpus").join(target)
}

/// Those of the names, or all.
fn targets(names: &[String]) -> Result<Vec<String>> {
    let mut all = Vec::new();
    for entry in fs::read_dir(paths::root().join("tests/fuzzing/fuzz_targets"))? {
        all.extend(entry?.path().file_stem().map(|name| name.to_string_lossy().into_owned()));
    }
    all.sort();
    if let Some(unknown) = names.iter().find(|name| !all.contains(name)) {
        bail!("there is no target `{unknown}`; there are {}", all.join(", "));
    }
    Ok(if names.is_empty() { all } else { names.to_vec() })
}

/// Builds every target; the folder that they are in.
fn build() -> Result<PathBuf> {
    let mut cargo = command::cargo();
    cargo.args(["build", "--locked", "-p", "fuzzing", "--features", "libfuzzer", "--bins"]);
    cargo.env("RUSTC_WORKSPACE_WRAPPER", std::env::current_exe()?).env(AS_WRAPPER, "1");
    command::run(&mut cargo).context("the targets need a C++ compiler besides Rust's")?;
    Ok(paths::target().join("debug"))
}

/// What the compiler that cargo wants to call does with our own crates, where cargo calls us instead.
#[must_use]
pub fn as_wrapper() -> Option<ExitCode> {
    std::env::var_os(AS_WRAPPER)?;
    let mut arguments = std::env::args_os().skip(1);
    let mut rustc = Command::new(arguments.next()?);
    let compiled = rustc.args(arguments).args(COVERAGE).status();
    Some(if compiled.is_ok_and(|status| status.success()) {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Runs one target; whether it found nothing. Says so in a line.
fn fuzz(place: &Place, target: &str, seconds: u64) -> Result<bool> {
    let start = Instant::now();
    let (found, findings) = (place.dir.join("corpus").join(target), place.dir.join("findings"));
    for dir in [&found, &findings] {
        fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
    }
    if std::io::stdout().is_terminal() {
        print!("  {target} ...\r");
        let _ = std::io::stdout().flush();
    }
    let log = findings.join(format!("{target}.log"));
    let mut program = program(place, target);
    program.args([&found, &committed(target)]).arg(format!("-max_total_time={seconds}"));
    program.arg(format!("-artifact_prefix={}/{target}-", findings.display()));
    program.args(["-print_final_stats=1".to_owned(), format!("-timeout={SLOWEST_S}")]);
    let good = program
        .stderr(File::create(&log)?)
        .status()
        .with_context(|| format!("cannot start {target}"))?
        .success();
    let report = Report::read(&String::from_utf8_lossy(&fs::read(&log)?));
    let result = if good {
        "nothing found".to_owned()
    } else {
        format!("FOUND SOMETHING: {}", log.display())
    };
    let Report { runs, first, last, added } = report;
    println!(
        "  {target:12} {runs:>9} runs in {:.0} s, reaches {last} places ({} new), {added} new inputs: {result}",
        start.elapsed().as_secs_f64(),
        last.saturating_sub(first)
    );
    Ok(good)
}

fn program(place: &Place, target: &str) -> Command {
    let mut program = command::program(place.programs.join(target));
    program.stdout(std::process::Stdio::null()).arg(format!("-rss_limit_mb={MOST_MEMORY_MIB}"));
    program
}

/// The committed corpus and what was found, as few and small inputs as reach the same places.
fn minimise(place: &Place, target: &str) -> Result<()> {
    let small = place.dir.join("small").join(target);
    let _ = fs::remove_dir_all(&small);
    fs::create_dir_all(&small)?;
    let mut merge = program(place, target);
    // How often a place is reached does not count: inputs for that are many and say little.
    merge.args(["-set_cover_merge=1", "-use_counters=0"]).arg(&small);
    merge.args([&committed(target), &place.dir.join("corpus").join(target)]);
    command::run(merge.stderr(std::process::Stdio::null()))?;
    replace(&small, &committed(target))
}

/// The smallest come first: some large ones may not find room.
fn replace(from: &Path, to: &Path) -> Result<()> {
    let mut inputs = Vec::new();
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        inputs.push((entry.metadata()?.len(), entry.path()));
    }
    inputs.sort();
    let found = inputs.len();
    let mut bytes = 0;
    inputs.retain(|(size, _)| {
        bytes += size;
        bytes <= MOST_CORPUS_BYTES
    });
    fs::remove_dir_all(to).with_context(|| format!("cannot clear {}", to.display()))?;
    fs::create_dir_all(to)?;
    for (_, path) in &inputs {
        fs::copy(path, to.join(path.file_name().unwrap_or_default()))?;
    }
    println!("  {}: {} of {found} inputs", to.display(), inputs.len());
    Ok(())
}

/// What libFuzzer says of a run.
#[derive(Debug, Default, PartialEq)]
struct Report {
    runs: u64,
    /// Places in the code that the corpus reached.
    first: u64,
    /// And what was found besides.
    last: u64,
    added: u64,
}

impl Report {
    fn read(log: &str) -> Self {
        let mut report = Self::default();
        for line in log.lines() {
            let mut words = line.split_whitespace();
            let number = |word: Option<&str>| word.and_then(|word| word.parse().ok()).unwrap_or(0);
            match (words.next(), words.next(), words.next()) {
                (Some("stat::number_of_executed_units:"), runs, _) => report.runs = number(runs),
                (Some("stat::new_units_added:"), added, _) => report.added = number(added),
                (Some(at), Some(what), Some("cov:")) if at.starts_with('#') => {
                    report.last = number(words.next());
                    if what == "INITED" {
                        report.first = report.last;
                    }
                }
                _ => {}
            }
        }
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_libfuzzer_says_is_understood() {
        let log = "INFO: seed corpus: files: 3\n#4\tINITED cov: 21 ft: 22 corp: 1/1b\n#9\tNEW    cov: 25 ft: 30 corp: 2/4b\n\
                   stat::number_of_executed_units: 1000\nstat::new_units_added:          7\n";
        assert_eq!(Report::read(log), Report { runs: 1000, first: 21, last: 25, added: 7 });
    }
}
