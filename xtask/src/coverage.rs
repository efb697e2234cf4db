//! Which lines and branches of the safety plane its own tests reach.
//!
//! The compiler counts, LLVM's tools of the same version read the counts. Branches are an unstable option of the stable compiler.
//! Lines of tests are not counted.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::{command, safety_alone};

/// Prints a line for each file and each place that no test reaches.
///
/// # Errors
/// When LLVM's tools are missing, the tests fail, or a place is not reached.
pub fn run() -> Result<()> {
    let llvm = Llvm::find()?;
    let safety = safety_alone::make("coverage")?;
    let counts = safety.join("counts");
    if counts.exists() {
        fs::remove_dir_all(&counts)?;
    }
    let program = build(&safety)?;
    let mut tests = Command::new(&program);
    // Few random cases: a place that only many of them reach shall be named.
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

/// The tests' program, which counts; cargo names it among what it made.
fn build(safety: &Path) -> Result<PathBuf> {
    let mut cargo = command::cargo();
    // Apart from all other builds: some crates are built anew when `RUSTC_BOOTSTRAP` comes or goes.
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
    Ok(program.context("cargo names no program")?.0.into())
}

/// LLVM's tools.
struct Llvm {
    cov: PathBuf,
    profdata: PathBuf,
}

impl Llvm {
    /// Of rustup's component `llvm-tools`, or of Debian's package of the compiler's own version: others cannot read its counts.
    fn find() -> Result<Self> {
        let about = command::output(Command::new("rustc").arg("-vV"))?;
        let of = |key: &str| {
            about.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default().trim()
        };
        let major = of("LLVM version:").split('.').next().unwrap_or_default();
        let sysroot = command::output(Command::new("rustc").args(["--print", "sysroot"]))?;
        let component = Path::new(sysroot.trim()).join("lib/rustlib").join(of("host:")).join("bin");
        let tool = |name: &str| {
            let places = [component.join(name), format!("{name}-{major}").into(), name.into()];
            places.into_iter().find(|place| command::works(Command::new(place).arg("--version")))
        };
        match (tool("llvm-cov"), tool("llvm-profdata")) {
            (Some(cov), Some(profdata)) => Ok(Self { cov, profdata }),
            _ => bail!(
                "llvm-cov is missing: `rustup component add llvm-tools`, or `apt install llvm-{major}`"
            ),
        }
    }
}

/// What one file of the safety plane has, without its tests.
#[derive(Debug, Default, PartialEq)]
struct Reached {
    /// How often each line was reached.
    lines: BTreeMap<u32, u64>,
    /// How often each way on from a line was taken: the line, the place in it, the way.
    branches: BTreeMap<(u32, String), u64>,
}

/// Reads LLVM's `lcov` text. Lines from `first_test_line` of a file on are tests.
fn read(lcov: &str, first_test_line: impl Fn(&str) -> u32) -> BTreeMap<String, Reached> {
    let mut files: BTreeMap<String, Reached> = BTreeMap::new();
    let (mut file, mut tests_from) = (String::new(), 0);
    for line in lcov.lines() {
        let Some((key, value)) = line.split_once(':') else { continue };
        if key == "SF" {
            (file, tests_from) = (value.to_owned(), first_test_line(value));
            continue;
        }
        let (Some((at, _)), Some((place, count))) = (value.split_once(','), value.rsplit_once(','))
        else {
            continue;
        };
        let at: u32 = at.parse().unwrap_or(u32::MAX);
        if at >= tests_from {
            continue;
        }
        // `-`: the line was not reached at all.
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

fn report(lcov: &str) -> Result<()> {
    // Files that are tests as a whole have no line before them.
    let first_test_line = |file: &str| {
        let text = if file.ends_with("_tests.rs") {
            String::new()
        } else {
            fs::read_to_string(file).unwrap_or_default()
        };
        text.lines().take_while(|line| line.trim() != "#[cfg(test)]").count() as u32 + 1
    };
    let mut missed = 0;
    println!("{:18} {:>12} {:>12}", "safety/", "lines", "branches");
    for (file, Reached { lines, branches }) in read(lcov, first_test_line) {
        let name = Path::new(&file).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (reached, taken) = (count(lines.values()), count(branches.values()));
        println!(
            "{name:18} {:>12} {:>12}",
            format!("{reached}/{}", lines.len()),
            format!("{taken}/{}", branches.len())
        );
        for (line, _) in lines.iter().filter(|(_, count)| **count == 0) {
            println!("  {name}:{line} is not reached");
        }
        for ((line, _), _) in branches.iter().filter(|(_, count)| **count == 0) {
            println!("  {name}:{line}: one way on is never taken");
        }
        missed += lines.len() - reached + branches.len() - taken;
    }
    if missed > 0 {
        bail!("{missed} lines and branches of the safety plane are not reached by its tests");
    }
    Ok(())
}

fn count<'a>(counts: impl Iterator<Item = &'a u64>) -> usize {
    counts.filter(|count| **count > 0).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_llvm_counted_is_read_and_tests_are_left_out() {
        let lcov = "SF:/a/plane.rs\nDA:1,5\nDA:2,0\nBRDA:2,0,0,3\nBRDA:2,0,1,-\nBRDA:2,0,0,1\nDA:9,0\nend_of_record\n\
                    SF:/a/plane_tests.rs\nDA:1,0\nend_of_record\n";
        let files = read(lcov, |file| if file.ends_with("_tests.rs") { 1 } else { 9 });
        let branches = [((2, "2,0,0".to_owned()), 4), ((2, "2,0,1".to_owned()), 0)].into();
        let plane = Reached { lines: [(1, 5), (2, 0)].into(), branches };
        assert_eq!(files, [("/a/plane.rs".to_owned(), plane)].into());
    }
}
