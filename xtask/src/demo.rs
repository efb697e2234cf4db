//! `cargo xtask demo`: a robot explores a home that it has never seen.

use std::time::Instant;

use anyhow::{Context, Result};

use crate::{command, onnx_runtime, paths};

const SCENE: &str = "builtin:apartment?seed=1";
const FRAMES: &str = "3000";

pub fn run() -> Result<()> {
    if let Err(error) = onnx_runtime::install() {
        // One line: the demo's depth comes from geometry and needs no network.
        println!("no `--depth network` ({error}); the demo needs none");
    }
    println!("building firmware-host in release; the first time takes some minutes");
    command::run(command::cargo().args(["build", "--release", "--locked", "--package", "firmware-host"]))?;
    let out = paths::target().join("demo");
    if out.exists() {
        std::fs::remove_dir_all(&out).with_context(|| format!("removing the last demo in {}", out.display()))?;
    }
    let robot = paths::target().join("release/firmware-host");
    let mut explore = command::program(&robot);
    explore.args(["explore", "--scene", SCENE, "--policy", "active", "--frames", FRAMES, "--seed", "1", "--out"]);
    explore.arg(&out);
    println!("> {}", command::text(&explore));
    let start = Instant::now();
    // Prints its own numbers and where they lie.
    command::run(&mut explore)?;
    let seconds = start.elapsed().as_secs_f64();
    println!("\nThe robot saw {FRAMES} frames of {SCENE} in {seconds:.0} s, with depth from its own motion.");
    println!(
        "Open the recording in Foxglove (Open local file) or Rerun (`rerun {}/recording_0000.mcap`).",
        out.display()
    );
    println!("Recompute every decision from it: {} replay {}", robot.display(), out.display());
    Ok(())
}
