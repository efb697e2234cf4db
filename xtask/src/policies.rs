//! `cargo xtask policies`: every policy on the built-in homes, as a table.

use anyhow::{Context, Result};
use serde_json::Value;

use crate::{command, paths};

const HOMES: [&str; 3] = ["apartment", "house", "office"];
const POLICIES: [&str; 6] =
    ["random", "heuristic", "forward", "inconsistency", "frontier", "active"];

/// Explores each home with each policy and each seed; runs whose summary is there already are only read.
pub fn run(frames: u64, seeds: u64) -> Result<()> {
    command::run(command::cargo().args([
        "build",
        "--release",
        "--locked",
        "--package",
        "firmware-host",
    ]))?;
    let robot = paths::target().join("release/firmware-host");
    println!(
        "| home | seed | policy | coverage | path (m) | collisions | trips | stuck frames (longest) |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for home in HOMES {
        for seed in 1..=seeds {
            for policy in POLICIES {
                let out = paths::target().join(format!("policies/{frames}/{home}-{seed}-{policy}"));
                if !out.join("summary.json").exists() {
                    let mut explore = command::program(&robot);
                    explore.args(["explore", "--no-recording", "--policy", policy]);
                    explore.args(["--scene", &format!("builtin:{home}?seed={seed}")]);
                    explore
                        .args([
                            "--frames",
                            &frames.to_string(),
                            "--seed",
                            &seed.to_string(),
                            "--out",
                        ])
                        .arg(&out);
                    let output = explore.output().with_context(|| command::text(&explore))?;
                    anyhow::ensure!(
                        output.status.success(),
                        "{}",
                        String::from_utf8_lossy(&output.stderr)
                    );
                }
                let text = std::fs::read_to_string(out.join("summary.json"))?;
                println!("| {home} | {seed} | {policy} | {} |", row(&serde_json::from_str(&text)?));
            }
        }
    }
    Ok(())
}

fn row(summary: &Value) -> String {
    let number = |key: &str| summary[key].as_f64().unwrap_or(f64::NAN);
    format!(
        "{:.0} % | {:.1} | {} | {} | {} ({})",
        100.0 * number("coverage"),
        number("path_m"),
        summary["collisions"],
        summary["bumper_trips"],
        summary["stuck_frames"],
        summary["stuck_longest_frames"],
    )
}
