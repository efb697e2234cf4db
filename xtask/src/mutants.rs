//! Mutation tests of the safety plane: every mutant must fail a test of the safety plane's own
//! folder.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

use crate::{command, paths, safety_alone};

/// This version of cargo-mutants is installed if there is none. Any other version that is installed
/// already is used.
const VERSION: &str = "27.1.0";
/// The mutants that may survive, each with a reason.
const CONFIG: &str = ".cargo/mutants.toml";

/// Runs all mutants; `arguments` are passed on to `cargo mutants`. There are about 1,000 of them, at 3 s each on
/// two cores: `--shard 0/20` runs a twentieth.
///
/// # Errors
/// If cargo-mutants cannot be installed, an exclusion in `.cargo/mutants.toml` does not match
/// exactly one mutant, or a mutant survives that is not excluded there.
pub fn run(arguments: &[String]) -> Result<()> {
    if !command::works(command::cargo().args(["mutants", "--version"])) {
        install()?;
    }
    let folder = safety_alone::make("mutants")?;
    check_exclusions(&folder)?;
    let mut mutants = command::cargo();
    // With few random cases, a mutant that only rare cases detect counts as missed.
    mutants.current_dir(&folder).env("PROPTEST_CASES", "4").env_remove("RUST_BACKTRACE");
    mutants.args([
        "mutants",
        "--in-place",
        "--file",
        "src/safety/*.rs",
        // The tests take 1 s; a mutant that never ends is detected.
        "--timeout",
        "12",
        "--cargo-test-arg=--lib",
    ]);
    mutants.arg("--config").arg(paths::root().join(CONFIG));
    let status = mutants.args(arguments).status().context("cannot start `cargo mutants`")?;
    let missed = folder.join("mutants.out/missed.txt");
    let missed = fs::read_to_string(&missed).with_context(|| missed.display().to_string())?;
    ensure!(
        missed.is_empty(),
        "no test fails with these mutants, and {CONFIG} does not exclude them:\n{missed}"
    );
    // Exit code 3: some mutants timed out, which counts as detected. The code does not depend on
    // missed mutants.
    ensure!(matches!(status.code(), Some(0 | 3)), "`cargo mutants` failed ({status})");
    Ok(())
}

fn install() -> Result<()> {
    let mut install = command::cargo();
    install.args(["install", "--quiet", "--locked", "cargo-mutants", "--version", VERSION]);
    command::run(install.arg("--root").arg(paths::target().join("tools")))
}

/// Fails if an exclusion does not match exactly one mutant: it is out of date, or it excuses more
/// than its reason covers.
fn check_exclusions(folder: &Path) -> Result<()> {
    let mut list = command::cargo();
    list.current_dir(folder).args(["mutants", "--no-config", "--list", "--colors", "never"]);
    let mutants = command::output(list.args(["--file", "src/safety/*.rs"]))?;
    let patterns: Vec<String> = mutants.lines().filter_map(pattern_of).collect();
    let config = fs::read_to_string(paths::root().join(CONFIG)).context(CONFIG)?;
    let wrong: Vec<String> = exclusions(&config)
        .map(|exclusion| (exclusion, patterns.iter().filter(|known| *known == exclusion).count()))
        .filter(|(_, matches)| *matches != 1)
        .map(|(exclusion, matches)| format!("{exclusion} ({matches} matches)"))
        .collect();
    if !wrong.is_empty() {
        bail!("exclusions in {CONFIG} that do not match exactly one mutant:\n{}", wrong.join("\n"));
    }
    Ok(())
}

/// The patterns in `exclude_re`, one on each line in single quotes.
fn exclusions(config: &str) -> impl Iterator<Item = &str> {
    config.lines().filter_map(|line| line.trim().strip_prefix('\'')?.strip_suffix("',"))
}

/// The exact pattern of a mutant as `cargo mutants --list` prints it, for any line of the file.
fn pattern_of(mutant: &str) -> Option<String> {
    let (file, rest) = mutant.split_once(':')?;
    let (_line, rest) = rest.split_once(':')?;
    Some(format!(r"^{}:\d+:{}$", escaped(file), escaped(rest)))
}

/// Escapes the characters that have a meaning in a regular expression.
fn escaped(text: &str) -> String {
    let mut escaped = String::new();
    for character in text.chars() {
        if r"\.+*?()|[]{}^$".contains(character) {
            escaped.push('\\');
        }
        escaped.push(character);
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pattern_of_a_mutant_leaves_the_line_open_and_escapes_operators() {
        let mutant = "src/safety/rear.rs:217:52: replace + with - in observed_gap_m";
        assert_eq!(
            pattern_of(mutant).as_deref(),
            Some(r"^src/safety/rear\.rs:\d+:52: replace \+ with - in observed_gap_m$")
        );
        assert_eq!(pattern_of("no mutant"), None);
    }

    #[test]
    fn exclusions_are_read_without_comments() {
        let config = "exclude_re = [\n    # A reason.\n    '^a$',\n    '^b$',\n]\n";
        assert_eq!(exclusions(config).collect::<Vec<_>>(), ["^a$", "^b$"]);
    }
}
