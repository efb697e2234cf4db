//! Mutants of the safety plane: every small change of it that could be a mistake must fail a test of its own folder.

use anyhow::{Context, Result, ensure};

use crate::{command, paths, safety_alone};

/// The version that is installed where there is none; any other that is already there will do.
const VERSION: &str = "27.1.0";

/// Runs them all, with the arguments passed on to `cargo mutants`. One core, an hour.
///
/// # Errors
/// When cargo-mutants cannot be installed, and when a mutant survives that is not in `.cargo/mutants.toml`.
pub fn run(arguments: &[String]) -> Result<()> {
    if !command::works(command::cargo().args(["mutants", "--version"])) {
        let mut install = command::cargo();
        install.args(["install", "--quiet", "--locked", "cargo-mutants", "--version", VERSION, "--root"]);
        command::run(install.arg(paths::target().join("tools")))?;
    }
    let mut mutants = command::cargo();
    // Few random cases: what only many of them notice is listed as missed.
    mutants.current_dir(safety_alone::make("mutants")?).env("PROPTEST_CASES", "4").env_remove("RUST_BACKTRACE");
    mutants.args(["mutants", "--in-place", "--file", "src/safety/*.rs", "--timeout", "40", "--cargo-test-arg=--lib"]);
    mutants.arg("--config").arg(paths::root().join(".cargo/mutants.toml"));
    let status = mutants.args(arguments).status().context("cannot start `cargo mutants`")?;
    // 3: none lives, and some never end. Those have failed their test as well.
    ensure!(
        matches!(status.code(), Some(0 | 3)),
        "`cargo mutants` failed ({status}); what lives is listed above as MISSED"
    );
    Ok(())
}
