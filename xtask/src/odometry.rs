//! `cargo xtask odometry`: what the errors of odometry cost, and what localization gains.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::Value;

use crate::demo;
use crate::explore::{self, Exploration, figure};
use crate::paths;
use crate::tables::{self, Table};

const HOMES: [&str; 3] = ["apartment", "house", "office"];
const COLUMNS: [&str; 12] = [
    "home",
    "seed",
    "poses and map",
    "coarse depth: delta1 unscaled, all / confident half",
    "coarse depth: right of all pixels",
    "depth that the map is made from: right of all pixels / of its more probable half",
    "constant",
    "coverage, at its true place",
    "map error p50 / p90 (cm)",
    "off by 10 cm",
    "heading at the end (deg)",
    "collisions",
];
/// The rows of each home, with the names of their folders: where poses come from, and the depth of the map, if it is not dense depth.
const ROWS: [(&str, &str); 8] = [
    ("wheels and scans", "dense"),
    ("wheels, gyroscope and scans", "gyro"),
    ("wheels and scans, network", "network"),
    ("wheels and scans, map of coarse depth", "scans"),
    ("noise of 3 % / 5 %, and scans", "noisy-dense"),
    ("noise of 3 % / 5 %, gyroscope and scans", "noisy-gyro"),
    ("wheels alone, map of coarse depth", "wheels"),
    ("error-free", "perfect-dense"),
];

/// A bad base: of the default errors of odometry, the noise is raised to 3 % of the distance and 5 % of a rotation.
const NOISY: &str = "[simulator]\nodometry_distance_noise = 0.03\nodometry_turn_noise = 0.05\n";

/// An inertial measurement unit, behind the section `[simulator]`.
const IMU: &str = "imu = true\n";

/// Explores each home with each seed and as each row says. Runs that an earlier call has finished are not repeated. With `update`,
/// the table goes into docs/data/odometry.json and docs/accuracy.md.
///
/// # Errors
/// When a run fails, or a file cannot be written.
pub fn run(frames: u64, seeds: u64, scenes: &[String], update: bool) -> Result<()> {
    explore::build()?;
    let dir = paths::target().join(format!("odometry/{frames}"));
    std::fs::create_dir_all(&dir).with_context(|| dir.display().to_string())?;
    let wheels = configuration(&dir, "wheels", "[localization]\nsource = \"wheels\"\n")?;
    let noisy = configuration(&dir, "noisy", NOISY)?;
    let gyro = configuration(&dir, "gyro", &format!("[simulator]\n{IMU}"))?;
    let noisy_gyro = configuration(&dir, "noisy-gyro", &format!("{NOISY}{IMU}"))?;
    let network = paths::root().join(demo::MODEL).display().to_string();
    let frames = frames.to_string();
    let mut labels = Vec::new();
    let mut explorations = Vec::new();
    for seed in 1..=seeds {
        let builtin = HOMES.map(|home| (home.to_owned(), format!("builtin:{home}?seed={seed}")));
        let files = scenes.iter().map(|file| (name(file), file.clone()));
        for (home, scene) in builtin.into_iter().chain(files) {
            for (row, folder) in ROWS {
                let mut arguments =
                    ["--scene", &scene, "--policy", "active"].map(String::from).to_vec();
                let length = ["--frames", &frames, "--seed", &seed.to_string()];
                arguments.extend(length.map(String::from));
                let of_row = match folder {
                    "network" => vec!["--model", &network],
                    "scans" => vec!["--depth", "coarse"],
                    "gyro" => vec!["--config", &gyro],
                    "noisy-dense" => vec!["--config", &noisy],
                    "noisy-gyro" => vec!["--config", &noisy_gyro],
                    "wheels" => vec!["--depth", "coarse", "--config", &wheels],
                    "perfect-dense" => vec!["--odometry", "perfect"],
                    _ => Vec::new(),
                };
                arguments.extend(of_row.into_iter().map(String::from));
                labels.push([home.clone(), seed.to_string(), row.to_owned()]);
                let out = dir.join(format!("{home}-{seed}-{folder}"));
                explorations.push(Exploration { arguments, out });
            }
        }
    }
    let summaries = explore::all(&explorations)?;
    let mut table = Table::new(&COLUMNS);
    for (label, summary) in labels.iter().zip(&summaries) {
        table.push(label.iter().cloned().chain(results(summary)).collect());
    }
    for (row, _) in ROWS {
        let of_row = labels.iter().zip(&summaries).filter(|(label, _)| label[2] == row);
        let of_row: Vec<&Value> = of_row.map(|(_, summary)| summary).collect();
        let label = ["mean", "", row].map(str::to_owned);
        table.push(label.into_iter().chain(results(&mean(&of_row))).collect());
    }
    print!("{}", table.markdown());
    if update {
        let files: String = scenes.iter().map(|file| format!(" --scene {}", name(file))).collect();
        let made_by =
            format!("cargo xtask odometry --frames {frames} --seeds {seeds}{files} --update");
        tables::update("odometry", "odometry", &made_by, &table)?;
    }
    Ok(())
}

/// Writes a configuration and returns its path.
fn configuration(dir: &Path, name: &str, text: &str) -> Result<String> {
    let file = dir.join(format!("{name}.toml"));
    std::fs::write(&file, text).with_context(|| file.display().to_string())?;
    Ok(file.display().to_string())
}

/// A scene file's name without folders and extension.
fn name(file: &str) -> String {
    let path = PathBuf::from(file);
    path.file_stem().map_or_else(|| file.to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// The cells of a run behind home, seed and poses.
fn results(summary: &Value) -> [String; 9] {
    let map = summary["depth_source"].as_str().unwrap_or("dense");
    [
        two(summary, "coarse/all/delta1_unscaled", "coarse/confident/delta1_unscaled"),
        format!("{:.3}", figure(summary, "/accuracy/coarse/all/right")),
        two(summary, &format!("{map}/all/right"), &format!("{map}/confident/delta1_unscaled")),
        format!("{:.3}", figure(summary, "/accuracy/constant/all/right")),
        format!("{:.1} %", 100.0 * figure(summary, "/coverage_true")),
        format!(
            "{:.1} / {:.1}",
            100.0 * figure(summary, "/map_error_m/p50"),
            100.0 * figure(summary, "/map_error_m/p90")
        ),
        format!("{:.1} %", 100.0 * figure(summary, "/map_off10")),
        format!("{:.1}", figure(summary, "/pose_error/yaw_end_deg")),
        format!("{}", figure(summary, "/collisions")),
    ]
}

/// Two accuracies in one cell.
fn two(summary: &Value, first: &str, second: &str) -> String {
    let [first, second] = [first, second].map(|key| figure(summary, &format!("/accuracy/{key}")));
    format!("{first:.3} / {second:.3}")
}

/// Every number of the summaries in the mean; collisions are added up.
fn mean(summaries: &[&Value]) -> Value {
    let Some(first) = summaries.first() else { return Value::Null };
    let mut mean = merged(first, summaries);
    let collisions = summaries.iter().filter_map(|summary| summary["collisions"].as_f64());
    mean["collisions"] = collisions.sum::<f64>().into();
    mean
}

/// `of` with each number replaced by the mean of that number in `all`.
fn merged(of: &Value, all: &[&Value]) -> Value {
    match of {
        Value::Object(entries) => entries
            .iter()
            .map(|(key, value)| {
                let values: Vec<&Value> = all.iter().filter_map(|one| one.get(key)).collect();
                (key.clone(), merged(value, &values))
            })
            .collect(),
        Value::Number(_) => {
            let numbers: Vec<f64> = all.iter().filter_map(|one| one.as_f64()).collect();
            (numbers.iter().sum::<f64>() / numbers.len() as f64).into()
        }
        other => other.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_are_averaged_at_any_depth_and_collisions_added() {
        let runs = [
            json!({ "map": { "p50": 1.0 }, "collisions": 2, "policy": "active" }),
            json!({ "map": { "p50": 2.0 }, "collisions": 1, "policy": "active" }),
        ];
        let expected = json!({ "map": { "p50": 1.5 }, "collisions": 3.0, "policy": "active" });
        assert_eq!(mean(&runs.iter().collect::<Vec<_>>()), expected);
    }
}
