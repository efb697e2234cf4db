//! Line and branch coverage of the safety plane by its own tests.
//!
//! The compiler inserts counters, and LLVM's tools of the same version read them. Branch coverage
//! is an unstable option, which the stable compiler accepts with `RUSTC_BOOTSTRAP`. Lines of tests
//! are not counted.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::{command, safety_alone};

/// Prints one line for each file and for each line or branch that no test reaches.
///
/// # Errors
/// If LLVM's tools are missing, the tests fail, or a line or branch is not reached.
pub fn run() -> Result<()> {
    let llvm = Llvm::find()?;
    let safety = safety_alone::make("coverage")?;
    let counts = safety.join("counts");
    if counts.exists() {
        fs::remove_dir_all(&counts)?;
    }
    let program = build(&safety)?;
    let mut tests = Command::new(&program);
    // With few random cases, lines that only rare cases reach are reported as not reached.
    tests
        .arg("--quiet")
        .env("PROPTEST_CASES", "4")
        .env("LLVM_PROFILE_FILE", counts.join("%p.profraw"));
    command::run(&mut tests)?;
    let raw = fs::read_dir(&counts)?.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    let merged = counts.join("merged");
    command::run(
        Command::new(&llvm.profdata).args(["merge", "-sparse", "-o"]).arg(&merged).args(raw),
    )?;
    let mut export = Command::new(&llvm.cov);
    export.args(["export", "-format=lcov", "-instr-profile"]).arg(&merged).arg(&program);
    let lcov = command::output(export.arg(safety.join("src/safety")))?;
    report(&lcov)
}

/// Builds the test executable with counters and returns its path, which cargo reports as JSON.
fn build(safety: &Path) -> Result<PathBuf> {
    let mut cargo = command::cargo();
    // The build has a target directory of its own, because some crates are rebuilt whenever
    // `RUSTC_BOOTSTRAP` changes.
    cargo
        .current_dir(safety)
        .env("RUSTC_BOOTSTRAP", "1")
        .env("CARGO_TARGET_DIR", safety.join("target"));
    cargo.args([
        "rustc",
        "--quiet",
        "--lib",
        "--profile",
        "test",
        "--message-format",
        "json",
        "--",
    ]);
    let messages =
        command::output(cargo.args(["-Cinstrument-coverage", "-Zcoverage-options=branch"]))?;
    let program =
        messages.lines().filter_map(|line| line.split_once("\"executable\":\"")).next_back();
    let program = program.and_then(|(_, rest)| rest.split_once('"'));
    Ok(program.context("cargo reported no test executable")?.0.into())
}

/// Paths of LLVM's coverage tools.
struct Llvm {
    cov: PathBuf,
    profdata: PathBuf,
}

impl Llvm {
    /// Finds the tools in rustup's component `llvm-tools` or in Debian's package. They must have
    /// the compiler's LLVM version; other versions cannot read its counters.
    fn find() -> Result<Self> {
        let about = command::output(Command::new("rustc").arg("-vV"))?;
        let major = field(&about, "LLVM version:").split('.').next().unwrap_or_default();
        let sysroot = command::output(Command::new("rustc").args(["--print", "sysroot"]))?;
        let host = field(&about, "host:");
        let component = Path::new(sysroot.trim()).join("lib/rustlib").join(host).join("bin");
        let cov = find_tool("llvm-cov", &component, major);
        let profdata = find_tool("llvm-profdata", &component, major);
        match (cov, profdata) {
            (Some(cov), Some(profdata)) => Ok(Self { cov, profdata }),
            _ => bail!(
                "llvm-cov is missing: `rustup component add llvm-tools`, or `apt install llvm-{major}`"
            ),
        }
    }
}

/// The value of a line `key value` in the output of `rustc -vV`.
fn field<'a>(about: &'a str, key: &str) -> &'a str {
    about.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default().trim()
}

fn find_tool(name: &str, component: &Path, major: &str) -> Option<PathBuf> {
    let places = [component.join(name), format!("{name}-{major}").into(), name.into()];
    places.into_iter().find(|place| command::works(Command::new(place).arg("--version")))
}

/// Counters of one file of the safety plane, without its tests.
#[derive(Debug, Default, PartialEq)]
struct Reached {
    /// Number of executions of each line.
    lines: BTreeMap<u32, u64>,
    /// Number of executions of each branch; the key is the line and lcov's name of the branch.
    branches: BTreeMap<(u32, String), u64>,
}

/// Reads LLVM's `lcov` text. The lines of a file from `first_test_line` on are tests.
fn read(lcov: &str, first_test_line: impl Fn(&str) -> u32) -> BTreeMap<String, Reached> {
    let mut files: BTreeMap<String, Reached> = BTreeMap::new();
    let mut file = String::new();
    let mut tests_from = 0;
    for line in lcov.lines() {
        let Some((key, value)) = line.split_once(':') else { continue };
        if key == "SF" {
            file = value.to_owned();
            tests_from = first_test_line(value);
            continue;
        }
        let Some((at, _)) = value.split_once(',') else { continue };
        let Some((place, count)) = value.rsplit_once(',') else { continue };
        let at: u32 = at.parse().unwrap_or(u32::MAX);
        if at >= tests_from {
            continue;
        }
        // The count is `-` for branches of a line that was not reached.
        let count = count.parse().unwrap_or(0);
        let reached = files.entry(file.clone()).or_default();
        match key {
            "DA" => *reached.lines.entry(at).or_default() += count,
            "BRDA" => *reached.branches.entry((at, place.to_owned())).or_default() += count,
            _ => {}
        }
    }
    files
}

/// The line on which the tests of a source file begin; 1 for a file that contains only tests.
fn first_test_line(file: &str) -> u32 {
    if file.ends_with("_tests.rs") {
        return 1;
    }
    let text = fs::read_to_string(file).unwrap_or_default();
    text.lines().take_while(|line| line.trim() != "#[cfg(test)]").count() as u32 + 1
}

fn report(lcov: &str) -> Result<()> {
    let mut missed = 0;
    println!("{:18} {:>12} {:>12}", "safety/", "lines", "branches");
    for (file, Reached { lines, branches }) in read(lcov, first_test_line) {
        let name = Path::new(&file).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let reached = count(lines.values());
        let taken = count(branches.values());
        println!(
            "{name:18} {:>12} {:>12}",
            format!("{reached}/{}", lines.len()),
            format!("{taken}/{}", branches.len())
        );
        for (line, _) in lines.iter().filter(|(_, count)| **count == 0) {
            println!("  {name}:{line} is not reached");
        }
        for ((line, _), _) in branches.iter().filter(|(_, count)| **count == 0) {
            println!("  {name}:{line}: a branch is never taken");
        }
        missed += lines.len() - reached + branches.len() - taken;
    }
    if missed > 0 {
        bail!("{missed} lines and branches of the safety plane are not reached by its tests");
    }
    Ok(())
}

/// Number of counters that are not 0.
fn count<'a>(counts: impl Iterator<Item = &'a u64>) -> usize {
    counts.filter(|count| **count > 0).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_are_read_from_lcov_and_lines_of_tests_are_left_out() {
        let lcov = "SF:/a/plane.rs\nDA:1,5\nDA:2,0\nBRDA:2,0,0,3\nBRDA:2,0,1,-\nBRDA:2,0,0,1\nDA:9,0\nend_of_record\n\
                    SF:/a/plane_tests.rs\nDA:1,0\nend_of_record\n";
        let files = read(lcov, |file| if file.ends_with("_tests.rs") { 1 } else { 9 });
        let branches = [((2, "2,0,0".to_owned()), 4), ((2, "2,0,1".to_owned()), 0)].into();
        let plane = Reached { lines: [(1, 5), (2, 0)].into(), branches };
        assert_eq!(files, [("/a/plane.rs".to_owned(), plane)].into());
    }
}
