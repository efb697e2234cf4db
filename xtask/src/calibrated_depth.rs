//! `cargo xtask calibration --depth`: depth and map of robots before and after their calibration.

use std::path::Path;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::explore::{self, Exploration, figure};
use crate::tables::{self, Table};
use crate::{command, paths};

/// The homes of the tool `calibration`, by the number of the robot.
const HOMES: [&str; 3] = ["apartment", "house", "office"];
const FRAMES: &str = "600";
/// Each robot's configurations, with the names of their files.
const ROWS: [(&str, &str); 3] =
    [("wrong", "before"), ("calibrated", "after"), ("nominal robot", "nominal")];
const COLUMNS: [&str; 9] = [
    "robot",
    "configuration",
    "coarse depth: delta1 unscaled, all / confident half",
    "dense depth: right of all pixels",
    "dense depth: right of the more probable half",
    "constant",
    "coverage, at its true place",
    "off by 10 cm",
    "collisions",
];

/// Calibrates robots, explores with their configurations before and after, and writes the table to the documents if `update`.
pub fn run(robots: u64, update: bool) -> Result<()> {
    let dir = paths::target().join("calibration");
    if dir.exists() {
        std::fs::remove_dir_all(&dir).with_context(|| dir.display().to_string())?;
    }
    let mut calibration = command::cargo();
    calibration
        .args(["run", "--release", "--quiet", "--locked", "--package", "calibration", "--"])
        .args(["--robots", &robots.to_string(), "--seconds", "120", "--frames", "120"])
        .arg("--configurations")
        .arg(&dir);
    command::run(&mut calibration)?;
    explore::build()?;
    let mut explorations = Vec::new();
    for robot in 1..=robots {
        explorations.extend(ROWS.map(|(_, file)| exploration(&dir, robot, file)));
    }
    let summaries = explore::all(&explorations)?;
    let mut table = Table::new(&COLUMNS);
    for (index, summary) in summaries.iter().enumerate() {
        table.push(cells(
            &(index / ROWS.len() + 1).to_string(),
            ROWS[index % ROWS.len()].0,
            &[summary],
        ));
    }
    for (row, (name, _)) in ROWS.into_iter().enumerate() {
        let of_row: Vec<&Value> = summaries.iter().skip(row).step_by(ROWS.len()).collect();
        table.push(cells("mean", name, &of_row));
    }
    print!("{}", table.markdown());
    if update {
        let made_by = format!("cargo xtask calibration --depth --robots {robots} --update");
        tables::update("calibration", "depth", &made_by, &table)?;
    }
    Ok(())
}

fn exploration(dir: &Path, robot: u64, file: &str) -> Exploration {
    let home = HOMES[robot as usize % HOMES.len()];
    let config = dir.join(format!("{robot}-{file}.toml")).display().to_string();
    let scene = format!("builtin:{home}?seed={robot}");
    let seed = robot.to_string();
    let arguments = ["--scene", &scene, "--config", &config, "--frames", FRAMES, "--seed", &seed];
    Exploration {
        arguments: arguments.map(String::from).to_vec(),
        out: dir.join(format!("{robot}-{file}")),
    }
}

/// A row of means; collisions are added up.
fn cells(robot: &str, configuration: &str, summaries: &[&Value]) -> Vec<String> {
    let sum = |key: &str| summaries.iter().map(|summary| figure(summary, key)).sum::<f64>();
    let mean = |key: &str| sum(key) / summaries.len() as f64;
    vec![
        robot.to_owned(),
        configuration.to_owned(),
        format!(
            "{:.3} / {:.3}",
            mean("/accuracy/coarse/all/delta1_unscaled"),
            mean("/accuracy/coarse/confident/delta1_unscaled")
        ),
        format!("{:.3}", mean("/accuracy/dense/all/right")),
        format!("{:.3}", mean("/accuracy/dense/confident/delta1_unscaled")),
        format!("{:.3}", mean("/accuracy/constant/all/right")),
        format!("{:.1} %", 100.0 * mean("/coverage_true")),
        format!("{:.1} %", 100.0 * mean("/map_off10")),
        format!("{}", sum("/collisions")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_row_has_means_and_the_sum_of_collisions() {
        let summaries = [0.4, 0.6].map(|share| {
            let depth = json!({
                "all": { "right": share, "delta1_unscaled": share },
                "confident": { "delta1_unscaled": share },
            });
            json!({
                "accuracy": { "coarse": depth, "dense": depth, "constant": depth },
                "coverage_true": share,
                "map_off10": share,
                "collisions": 1,
            })
        });
        let row = cells("mean", "wrong", &summaries.iter().collect::<Vec<_>>());
        let half = ["0.500 / 0.500", "0.500", "0.500", "0.500", "50.0 %", "50.0 %", "2"];
        assert_eq!(row, [["mean", "wrong"].as_slice(), &half].concat());
        assert_eq!(row.len(), COLUMNS.len());
    }
}
