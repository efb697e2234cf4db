//! `cargo xtask demo`: a robot explores a home that it has never seen.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::{command, onnx_runtime, paths};

const SCENE: &str = "builtin:apartment?seed=1";
const FRAMES: &str = "1500";

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
    let mut explore = command::program(paths::target().join("release/firmware-host"));
    explore
        .args(["explore", "--scene", SCENE, "--policy", "active", "--frames", FRAMES, "--seed", "1", "--out"])
        .arg(&out);
    println!("> {}", command::text(&explore));
    let start = Instant::now();
    command::run(&mut explore)?;
    println!("\nThe robot explored {SCENE} for {FRAMES} frames in {:.0} s.", start.elapsed().as_secs_f64());
    print_numbers(&out.join("summary.json"))?;
    print_places(&out);
    Ok(())
}

/// A key without a value is absent from the summary, and then from this list.
fn print_numbers(summary: &Path) -> Result<()> {
    let text = std::fs::read_to_string(summary).with_context(|| format!("reading {}", summary.display()))?;
    let summary: Value = serde_json::from_str(&text).with_context(|| format!("reading {}", summary.display()))?;
    let number = |pointer: &str| summary.pointer(pointer).and_then(Value::as_f64);
    let lines = [
        ("share of the reachable floor mapped", number("/coverage")),
        ("path driven, m", number("/path_m")),
        ("collisions", number("/collisions")),
        ("frames stuck", number("/stuck_frames")),
        ("depth within 25 % of the truth, confident half", number("/accuracy/coarse/confident/delta1_unscaled")),
        ("the same, all pixels with depth", number("/accuracy/coarse/all/delta1_unscaled")),
    ];
    for (name, value) in lines.iter().filter_map(|(name, value)| Some((name, (*value)?))) {
        println!("  {name}: {}", (value * 1000.0).round() / 1000.0);
    }
    Ok(())
}

fn print_places(out: &Path) {
    println!("Look at:");
    let places = [
        ("map.png", "the map and the path over it"),
        ("depth.png", "picture, coarse depth, true depth, error"),
        ("summary.json", "the numbers"),
    ];
    for (name, what) in places {
        let path = out.join(name);
        if path.exists() {
            println!("  {}  {what}", path.display());
        }
    }
    for recording in recordings(out) {
        println!("  {}  everything the robot saw and decided", recording.display());
    }
    println!("  The recording opens in Foxglove (Open local file) and in Rerun (`rerun FILE.mcap`).");
    println!("  `target/release/firmware-host replay {}` recomputes every decision from it.", out.display());
}

fn recordings(out: &Path) -> Vec<std::path::PathBuf> {
    let folders = [out.to_owned(), out.join("recording")];
    let entries = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten();
    let mut files: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    files.sort();
    files
}
