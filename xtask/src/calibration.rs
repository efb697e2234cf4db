//! `cargo xtask calibration`: what calibration finds about simulated robots whose configuration is wrong.

use anyhow::Result;

use crate::command;
use crate::tables::{self, Table};

/// A table of `docs/data/calibration.json` and `docs/calibration.md`.
struct Drives {
    table: &'static str,
    /// Length of each drive, seconds.
    seconds: &'static str,
    /// Time during which frames are taken, seconds.
    frames: &'static str,
}

/// Cameras are measured too, from rendered frames.
const TWO_MINUTES: Drives = Drives { table: "two-minutes", seconds: "120", frames: "120" };
/// Wheels and scanner alone: what a longer drive gains.
const TEN_MINUTES: Drives = Drives { table: "ten-minutes", seconds: "600", frames: "0" };

/// Measures all robots in release, and writes the tables to the documents if `update`.
pub fn run(robots: u64, update: bool) -> Result<()> {
    for drives in [TWO_MINUTES, TEN_MINUTES] {
        let Drives { table, seconds, frames } = drives;
        let mut calibration = command::cargo();
        calibration
            .args(["run", "--release", "--quiet", "--locked", "--package", "calibration", "--"])
            .args(["--robots", &robots.to_string(), "--seconds", seconds, "--frames", frames]);
        let printed = command::output(&mut calibration)?;
        println!("{seconds} s\n\n{printed}");
        if update {
            let made_by = format!("cargo xtask calibration --robots {robots} --update");
            tables::update("calibration", table, &made_by, &Table::printed(&printed)?)?;
        }
    }
    Ok(())
}
