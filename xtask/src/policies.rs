//! `cargo xtask policies`: explores the built-in homes with every policy and prints a table.

use anyhow::Result;
use serde_json::Value;

use crate::tables::{self, Table};
use crate::{explore, paths};

const HOMES: [&str; 3] = ["apartment", "house", "office"];
const POLICIES: [&str; 6] =
    ["random", "heuristic", "forward", "inconsistency", "frontier", "active"];
const COLUMNS: [&str; 8] = [
    "home",
    "seed",
    "policy",
    "coverage",
    "path (m)",
    "collisions",
    "trips",
    "stuck frames (longest)",
];

/// Explores each home with each policy and each seed. Runs that an earlier call has finished are not repeated. With `update`,
/// the table goes into docs/data/policies.json and docs/policies.md.
pub fn run(frames: u64, seeds: u64, update: bool) -> Result<()> {
    explore::build()?;
    let mut table = Table::new(&COLUMNS);
    for home in HOMES {
        for seed in 1..=seeds {
            for policy in POLICIES {
                let out = paths::target().join(format!("policies/{frames}/{home}-{seed}-{policy}"));
                let scene = format!("builtin:{home}?seed={seed}");
                let arguments = ["--scene", &scene, "--policy", policy];
                let length = ["--frames", &frames.to_string(), "--seed", &seed.to_string()];
                let summary = explore::explore(&[arguments, length].concat(), &out)?;
                let mut cells = vec![home.to_owned(), seed.to_string(), policy.to_owned()];
                cells.extend(results(&summary));
                table.push(cells);
                eprintln!("explored {home} {seed} with {policy}");
            }
        }
    }
    print!("{}", table.markdown());
    if update {
        let made_by = format!("cargo xtask policies --frames {frames} --seeds {seeds} --update");
        tables::update("policies", "policies", &made_by, &table)?;
    }
    Ok(())
}

/// The cells of a run behind home, seed and policy.
fn results(summary: &Value) -> [String; 5] {
    let coverage = summary["coverage"].as_f64().unwrap_or(f64::NAN);
    let path_m = summary["path_m"].as_f64().unwrap_or(f64::NAN);
    [
        format!("{:.0} %", 100.0 * coverage),
        format!("{path_m:.1}"),
        summary["collisions"].to_string(),
        summary["bumper_trips"].to_string(),
        format!("{} ({})", summary["stuck_frames"], summary["stuck_longest_frames"]),
    ]
}
