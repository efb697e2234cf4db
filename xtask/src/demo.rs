//! `cargo xtask demo`: a simulated robot explores a home and writes images, a summary and a recording.

use std::time::Instant;

use anyhow::{Context, Result};

use crate::{command, onnx_runtime, paths};

const SCENE: &str = "builtin:apartment?seed=1";
const FRAMES: &str = "3000";
/// The default network; firmware-host/models/README.md describes it.
pub const MODEL: &str = "firmware-host/models/default.onnx";

pub fn run() -> Result<()> {
    let model = match onnx_runtime::install() {
        Ok(_) => Some(paths::root().join(MODEL)),
        Err(error) => {
            // A missing network is not an error: the robot also explores without one.
            println!(
                "no depth network ({error}); the robot explores with dense depth, which needs none"
            );
            None
        }
    };
    println!("building firmware-host in release; the first time takes some minutes");
    command::run(command::cargo().args([
        "build",
        "--release",
        "--locked",
        "--package",
        "firmware-host",
    ]))?;
    let out = paths::target().join("demo");
    if out.exists() {
        std::fs::remove_dir_all(&out)
            .with_context(|| format!("removing the last demo in {}", out.display()))?;
    }
    let robot = paths::target().join("release/firmware-host");
    let mut explore = command::program(&robot);
    explore.args([
        "explore",
        "--scene",
        SCENE,
        "--policy",
        "active",
        "--frames",
        FRAMES,
        "--seed",
        "1",
        "--animation",
        "--out",
    ]);
    explore.arg(&out);
    if let Some(model) = &model {
        explore.arg("--model").arg(model);
    }
    println!("> {}", command::text(&explore));
    let start = Instant::now();
    // The program prints its results and the paths of its files.
    command::run(&mut explore)?;
    let seconds = start.elapsed().as_secs_f64();
    let depth = if model.is_some() {
        "its own motion, refined by the default network"
    } else {
        "its own motion"
    };
    println!(
        "\nThe robot saw {FRAMES} frames of {SCENE} in {seconds:.0} s, with depth from {depth}."
    );
    println!("See the map grow: {}/animation.png in a browser.", out.display());
    println!(
        "For Foxglove and Rerun: {} buffer export {} --as viewer --out run.mcap (docs/recording.md).",
        robot.display(),
        out.display()
    );
    let with_model = model.map_or(String::new(), |model| format!(" --model {}", model.display()));
    println!(
        "Recompute every decision from it: {} replay {}{with_model}",
        robot.display(),
        out.display()
    );
    Ok(())
}
