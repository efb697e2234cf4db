//! `cargo xtask calibration`: what calibration finds about simulated robots whose configuration is wrong.

use anyhow::Result;

use crate::command;
use crate::tables::{self, Table};

/// Tables and the lengths of their drives: seconds, and seconds with frames.
const TABLES: [(&str, &str, &str); 2] =
    [("two-minutes", "120", "120"), ("five-minutes", "300", "0")];

/// Measures all robots in release, and writes the tables to the documents if `update`.
pub fn run(robots: u64, update: bool) -> Result<()> {
    for (name, seconds, frames) in TABLES {
        let mut calibration = command::cargo();
        calibration.args([
            "run",
            "--release",
            "--quiet",
            "--locked",
            "--package",
            "calibration",
            "--",
        ]);
        calibration.args([
            "--robots",
            &robots.to_string(),
            "--seconds",
            seconds,
            "--frames",
            frames,
        ]);
        let printed = command::output(&mut calibration)?;
        print!("{printed}");
        if update {
            let made_by = "cargo xtask calibration --update";
            tables::update("calibration", name, made_by, &Table::printed(&printed)?)?;
        }
    }
    Ok(())
}
