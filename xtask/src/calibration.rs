//! `cargo xtask calibration`: what calibration finds about simulated robots whose configuration is wrong.

use anyhow::Result;

use crate::command;
use crate::tables::{self, Table};

/// Length of each drive, seconds.
const SECONDS: &str = "120";
/// Name of the table in `docs/data/calibration.json` and `docs/calibration.md`.
const TABLE: &str = "two-minutes";

/// Measures all robots in release, and writes the table to the documents if `update`.
pub fn run(robots: u64, frames: bool, update: bool) -> Result<()> {
    let robots = robots.to_string();
    let with_frames = if frames { SECONDS } else { "0" };
    let mut calibration = command::cargo();
    calibration
        .args(["run", "--release", "--quiet", "--locked", "--package", "calibration", "--"])
        .args(["--robots", &robots, "--seconds", SECONDS, "--frames", with_frames]);
    let printed = command::output(&mut calibration)?;
    print!("{printed}");
    if update {
        let cameras = if frames { " --frames" } else { "" };
        let made_by = format!("cargo xtask calibration --robots {robots}{cameras} --update");
        tables::update("calibration", TABLE, &made_by, &Table::printed(&printed)?)?;
    }
    Ok(())
}
