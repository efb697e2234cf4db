//! `cargo xtask bench shards`: trainings that read shards beside trainings that read a recording into memory.

use anyhow::Result;

use crate::tables::{self, Table};
use crate::{command, paths, trainer};

/// Half a minute of a run: `prepare` needs about as long as a robot drives.
const FRAMES: &str = "300";
const SCENE: &str = "builtin:apartment?seed=1";

/// Records a simulated run, measures, and writes the table into docs/data/shards.json and docs/shards.md if `update`.
pub fn run(update: bool) -> Result<()> {
    let python = trainer::install()?;
    let build = ["build", "--release", "--quiet", "--locked", "--package=firmware-host"];
    command::run(command::cargo().args(build))?;
    let robot = paths::target().join("release/firmware-host");
    let folder = paths::target().join("bench-shards");
    let recording = folder.join("run");
    if !recording.join("summary.json").exists() {
        let mut explore = command::program(&robot);
        explore.args(["explore", "--scene", SCENE, "--frames", FRAMES, "--out"]).arg(&recording);
        command::run(&mut explore)?;
    }
    let mut bench = command::program(python);
    bench.arg(paths::root().join("tools/bench/peers/shards.py"));
    bench.arg(robot).arg(recording).arg(folder.join("work"));
    let printed = command::output(&mut bench)?;
    print!("{printed}");
    if update {
        let made_by = "cargo xtask bench shards --update";
        tables::update("shards", "reading", made_by, &Table::printed(&printed)?)?;
    }
    Ok(())
}
