//! Explorations whose summaries make tables.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use crate::{command, paths};

/// Builds the program that [`explore`] starts.
///
/// # Errors
/// When it does not compile.
pub fn build() -> Result<()> {
    let build = ["build", "--release", "--locked", "--package", "firmware-host"];
    command::run(command::cargo().args(build))
}

/// The summary of `firmware-host explore ARGUMENTS --out OUT`, without recording. A run that an earlier call has finished is not
/// repeated.
///
/// # Errors
/// When the exploration fails, or its summary cannot be read.
pub fn explore(arguments: &[&str], out: &Path) -> Result<Value> {
    let file = out.join("summary.json");
    if !file.exists() {
        let mut program = command::program(paths::target().join("release/firmware-host"));
        program.args(["explore", "--no-recording"]).args(arguments).arg("--out").arg(out);
        let output = program.output().with_context(|| command::text(&program))?;
        ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let text = std::fs::read_to_string(&file).with_context(|| file.display().to_string())?;
    let summary: Value = serde_json::from_str(&text).with_context(|| file.display().to_string())?;
    // It has a summary, too, of the part that was driven.
    let is_whole = summary["end_reason"] != "interrupted";
    ensure!(is_whole, "{} was interrupted: remove this folder, and run again", out.display());
    Ok(summary)
}
