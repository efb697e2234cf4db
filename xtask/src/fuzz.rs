//! `cargo xtask fuzz`: fuzzes everything that reads bytes from outside, with LLVM's libFuzzer.
//!
//! The stable compiler suffices: coverage is a pass of LLVM, and the address sanitizer, for which `cargo fuzz` needs a nightly
//! compiler, finds errors that code without `unsafe` cannot have. Only the project's own crates are built with coverage, so
//! that the builds of all other crates are shared with other chores. libFuzzer itself is built by a C++ compiler.

use std::fs::{self, File};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};

use crate::command;
use crate::paths;

/// The compiler options of `cargo fuzz` without the sanitizer.
const COVERAGE: [&str; 6] = [
    "-Cpasses=sancov-module",
    "-Cllvm-args=-sanitizer-coverage-level=4",
    "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters",
    "-Cllvm-args=-sanitizer-coverage-pc-table",
    "-Cllvm-args=-sanitizer-coverage-trace-compares",
    "-Cllvm-args=-simplifycfg-branch-fold-threshold=0",
];
/// Maximum size of a committed corpus.
const MOST_CORPUS_BYTES: u64 = 150_000;
/// When this variable is set, cargo has called this program as its RUSTC_WORKSPACE_WRAPPER, which it does for the workspace's
/// crates only.
const AS_WRAPPER: &str = "XTASK_FUZZ_WRAPPER";
/// An input that takes longer is a finding. The slowest committed input takes one second on a busy computer.
const SLOWEST_S: u64 = 20;
/// More memory than this, MiB, is a finding.
const MOST_MEMORY_MIB: u64 = 2048;

/// Fuzzes the named targets, or all of them, for `seconds` each. With `keep`, inputs that reach new code are then added to
/// the committed corpora, and these are minimized.
///
/// # Errors
/// When the targets cannot be built, a name is unknown, or a target has found something.
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
            "fuzzing has found something; the input and the output of the target are in {}",
            place.dir.join("findings").display()
        );
    }
    if keep {
        targets.iter().try_for_each(|target| minimise(&place, target))?;
    }
    Ok(())
}

/// Folders of a run.
struct Place {
    programs: PathBuf,
    dir: PathBuf,
}

fn committed(target: &str) -> PathBuf {
    paths::root().join("tests/fuzzing/corpus").join(target)
}

/// The named targets, or all if no name is given.
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

/// Builds every target. Returns their folder.
fn build() -> Result<PathBuf> {
    let mut cargo = command::cargo();
    cargo.args(["build", "--locked", "-p", "fuzzing", "--features", "libfuzzer", "--bins"]);
    cargo.env("RUSTC_WORKSPACE_WRAPPER", std::env::current_exe()?).env(AS_WRAPPER, "1");
    command::run(&mut cargo).context("the targets need a C++ compiler besides Rust's")?;
    Ok(paths::target().join("debug"))
}

/// Compiles a crate of the workspace with coverage, when cargo calls this program instead of the compiler.
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

/// Runs one target and prints the result on a line. Returns whether it found nothing.
fn fuzz(place: &Place, target: &str, seconds: u64) -> Result<bool> {
    let start = Instant::now();
    let found = place.dir.join("corpus").join(target);
    let findings = place.dir.join("findings");
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

/// Merges the committed corpus with the inputs that were found, into few and small inputs that reach the same code.
fn minimise(place: &Place, target: &str) -> Result<()> {
    let small = place.dir.join("small").join(target);
    let _ = fs::remove_dir_all(&small);
    fs::create_dir_all(&small)?;
    let mut merge = program(place, target);
    // Inputs that differ only in how often they reach code are not kept, because there are very many of them.
    merge.args(["-set_cover_merge=1", "-use_counters=0"]).arg(&small);
    merge.args([&committed(target), &place.dir.join("corpus").join(target)]);
    command::run(merge.stderr(std::process::Stdio::null()))?;
    replace(&small, &committed(target))
}

/// Copies the smallest inputs first, because large ones may exceed the size of the corpus.
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

/// libFuzzer's statistics of a run.
#[derive(Debug, Default, PartialEq)]
struct Report {
    runs: u64,
    /// Number of places in the code that the corpus reached.
    first: u64,
    /// Number of places that the new inputs reached in addition.
    last: u64,
    added: u64,
}

impl Report {
    fn read(log: &str) -> Self {
        let mut report = Self::default();
        for line in log.lines() {
            let mut words = line.split_whitespace();
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

/// The number in a word; 0 if there is none.
fn number(word: Option<&str>) -> u64 {
    word.and_then(|word| word.parse().ok()).unwrap_or(0)
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
