//! `cargo xtask stairs`: explores homes with stairs down, with the default camera, and with the paper's level one without and with
//! cliff sensors.

use anyhow::{Context, Result};
use serde_json::Value;

use crate::explore::{self, Exploration, figure};
use crate::paths;
use crate::tables::{self, Table};

/// A mount of the camera and the homes that are explored with it.
struct Mount {
    /// As the table names it.
    camera: &'static str,
    /// The last part of the names of its runs' folders.
    name: &'static str,
    config: &'static str,
    /// The homes, each with the number of its seeds.
    homes: [(&'static str, u64); 3],
}

/// The constants of the map were chosen with the first ten homes and four of the others.
const MOUNTS: [Mount; 3] = [
    Mount {
        camera: "16 degrees down (default)",
        name: "default",
        config: "",
        homes: [("apartment", 8), ("house", 7), ("office", 5)],
    },
    Mount {
        camera: "level",
        name: "level-preset",
        config: include_str!("../../firmware-host/presets/level-camera.toml"),
        homes: [("apartment", 4), ("house", 3), ("office", 3)],
    },
    Mount {
        camera: "level, with cliff sensors",
        name: "level-cliff-sensors",
        config: concat!(
            include_str!("../../firmware-host/presets/level-camera.toml"),
            "\n[simulator]\ncliff_sensors = true\n"
        ),
        homes: [("apartment", 4), ("house", 3), ("office", 3)],
    },
];
const COLUMNS: [&str; 8] = [
    "home",
    "seed",
    "camera",
    "within 0.1 m of an edge",
    "fell",
    "coverage at its true place",
    "coarse depth: right of all pixels",
    "collisions",
];

/// Explores each home with each mount. Runs that an earlier call has finished are not repeated. With `update`, the table goes
/// into docs/data/stairs.json and docs/faults.md.
///
/// # Errors
/// When a run fails, or a file cannot be written.
pub fn run(frames: u64, update: bool) -> Result<()> {
    explore::build()?;
    let dir = paths::target().join(format!("stairs/{frames}"));
    std::fs::create_dir_all(&dir).with_context(|| dir.display().to_string())?;
    let mut labels = Vec::new();
    let mut explorations = Vec::new();
    for mount in &MOUNTS {
        let name = mount.name;
        let file = dir.join(format!("{name}.toml"));
        std::fs::write(&file, mount.config).with_context(|| file.display().to_string())?;
        for (home, seed) in mount.homes() {
            let scene = format!("builtin:{home}?seed={seed}&stairs=1");
            let config = file.display().to_string();
            let length = [frames, seed].map(|number| number.to_string());
            let arguments = ["--scene", &scene, "--policy", "active", "--config", &config];
            let length = ["--frames", &length[0], "--seed", &length[1]];
            labels.push([home.to_owned(), seed.to_string(), mount.camera.to_owned()]);
            explorations.push(Exploration {
                arguments: arguments.iter().chain(&length).map(ToString::to_string).collect(),
                out: dir.join(format!("{home}-{seed}-{name}")),
            });
        }
    }
    let summaries = explore::all(&explorations)?;
    let mut table = Table::new(&COLUMNS);
    for (label, summary) in labels.iter().zip(&summaries) {
        table.push(label.iter().cloned().chain(Results::of(summary).cells()).collect());
    }
    for mount in &MOUNTS {
        let of_mount = labels.iter().zip(&summaries).filter(|(label, _)| label[2] == mount.camera);
        let of_mount: Vec<&Value> = of_mount.map(|(_, summary)| summary).collect();
        let label = ["all", "", mount.camera].map(str::to_owned);
        let all = Results::of_all(&of_mount);
        table.push(label.into_iter().chain(all.cells()).collect());
    }
    print!("{}", table.markdown());
    if update {
        let made_by = format!("cargo xtask stairs --frames {frames} --update");
        tables::update("stairs", "stairs", &made_by, &table)?;
    }
    Ok(())
}

impl Mount {
    /// The homes with their seeds.
    fn homes(&self) -> impl Iterator<Item = (&'static str, u64)> {
        self.homes.into_iter().flat_map(|(home, seeds)| (1..=seeds).map(move |seed| (home, seed)))
    }
}

/// The figures of one run, or of several: counts added up, shares in the mean.
struct Results {
    approaches: u64,
    falls: u64,
    coverage: f64,
    right: f64,
    collisions: u64,
}

impl Results {
    fn of(summary: &Value) -> Self {
        Self {
            // Absent if there were none.
            approaches: summary["edge_approaches"].as_u64().unwrap_or(0),
            falls: u64::from(summary["fell"] == true),
            coverage: figure(summary, "/coverage_true"),
            right: figure(summary, "/accuracy/coarse/all/right"),
            collisions: summary["collisions"].as_u64().unwrap_or(0),
        }
    }

    fn of_all(summaries: &[&Value]) -> Self {
        let all: Vec<Self> = summaries.iter().map(|summary| Self::of(summary)).collect();
        Self {
            approaches: all.iter().map(|run| run.approaches).sum(),
            falls: all.iter().map(|run| run.falls).sum(),
            coverage: mean(&all, |run| run.coverage),
            right: mean(&all, |run| run.right),
            collisions: all.iter().map(|run| run.collisions).sum(),
        }
    }

    fn cells(&self) -> [String; 5] {
        [
            self.approaches.to_string(),
            self.falls.to_string(),
            format!("{:.0} %", 100.0 * self.coverage),
            format!("{:.3}", self.right),
            self.collisions.to_string(),
        ]
    }
}

fn mean(all: &[Results], share: fn(&Results) -> f64) -> f64 {
    all.iter().map(share).sum::<f64>() / all.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn counts_are_added_up_and_shares_are_means() {
        let all = Results::of_all(&[&run(0, false, 0.8), &run(3, true, 0.4)]);
        assert_eq!(all.cells(), ["3", "1", "60 %", "0.500", "2"]);
        // A run without a fall has no key for it.
        assert_eq!(Results::of(&json!({ "edge_approaches": 0 })).cells()[1], "0");
    }

    fn run(approaches: u64, fell: bool, coverage: f64) -> Value {
        json!({ "edge_approaches": approaches, "fell": fell, "coverage_true": coverage,
            "accuracy": { "coarse": { "all": { "right": 0.5 } } }, "collisions": 1 })
    }
}
