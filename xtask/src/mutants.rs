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
        install.args([
            "install",
            "--quiet",
            "--locked",
            "cargo-mutants",
            "--version",
            VERSION,
            "--root",
        ]);
        command::run(install.arg(paths::target().join("tools")))?;
    }
    let mut mutants = command::cargo();
    // Few random cases: what only many of them notice is listed as missed.
    let folder = safety_alone::make("mutants")?;
    mutants.current_dir(&folder).env("PROPTEST_CASES", "4").env_remove("RUST_BACKTRACE");
    mutants.args([
        "mutants",
        "--in-place",
        "--file",
        "src/safety/*.rs",
        "--timeout",
        "40",
        "--cargo-test-arg=--lib",
    ]);
    mutants.arg("--config").arg(paths::root().join(".cargo/mutants.toml"));
    let status = mutants.args(arguments).status().context("cannot start `cargo mutants`")?;
    // 3: some never end, which fails their test as well. It says nothing of those that live.
    let missed = folder.join("mutants.out/missed.txt");
    let missed = std::fs::read_to_string(&missed).with_context(|| missed.display().to_string())?;
    ensure!(
        missed.is_empty(),
        "no test fails with these, and .cargo/mutants.toml does not list them:\n{missed}"
    );
    ensure!(matches!(status.code(), Some(0 | 3)), "`cargo mutants` failed ({status})");
    Ok(())
}
