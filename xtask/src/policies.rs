//! `cargo xtask policies`: explores the built-in homes with every policy and prints a table.

use anyhow::Result;
use serde_json::Value;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::explore::{self, Exploration, figure};
use crate::paths;
use crate::tables::{self, Table};

const HOMES: [&str; 3] = ["apartment", "house", "office"];
const POLICIES: [&str; 6] =
    ["random", "heuristic", "forward", "inconsistency", "frontier", "active"];
const COLUMNS: [&str; 9] = [
    "home",
    "seed",
    "policy",
    "coverage",
    "at its true place",
    "path (m)",
    "collisions",
    "trips",
    "stuck frames (longest)",
];
const MEANS: [&str; 4] = ["policy", "coverage", "at its true place", "collisions"];

/// Explores each home with each policy and each seed. Runs that an earlier call has finished are not repeated. With `update`,
/// the tables go into docs/data/policies.json and docs/policies.md.
pub fn run(frames: u64, seeds: u64, update: bool) -> Result<()> {
    explore::build()?;
    let mut labels = Vec::new();
    let mut explorations = Vec::new();
    for home in HOMES {
        for seed in 1..=seeds {
            let scene = format!("builtin:{home}?seed={seed}");
            let length = [frames, seed].map(|number| number.to_string());
            for policy in POLICIES {
                let arguments = ["--scene", &scene, "--policy", policy];
                let length = ["--frames", &length[0], "--seed", &length[1]];
                let arguments =
                    [arguments, length].concat().into_iter().map(String::from).collect();
                let out = paths::target().join(format!("policies/{frames}/{home}-{seed}-{policy}"));
                labels.push([home.to_owned(), seed.to_string(), policy.to_owned()]);
                explorations.push(Exploration { arguments, out });
            }
        }
    }
    let summaries = explore::all(&explorations)?;
    let mut table = Table::new(&COLUMNS);
    for (label, summary) in labels.iter().zip(&summaries) {
        table.push(label.iter().cloned().chain(results(summary)).collect());
    }
    let means = means(&summaries);
    print!("{}{}", table.markdown(), means.markdown());
    if update {
        let made_by = format!("cargo xtask policies --frames {frames} --seeds {seeds} --update");
        let tables = [("policies", &table), ("policy_means", &means)];
        tables::update_all("policies", &made_by, &tables)?;
    }
    Ok(())
}

/// A row for each policy: means over its runs.
fn means(summaries: &[Value]) -> Table {
    let mut table = Table::new(&MEANS);
    for (at, policy) in POLICIES.into_iter().enumerate() {
        // Every home and seed has one run of each policy, in this order.
        let summaries: Vec<&Value> = summaries.iter().skip(at).step_by(POLICIES.len()).collect();
        let collisions: f64 = figures(&summaries, "/collisions").iter().sum();
        table.push(vec![
            policy.to_owned(),
            mean_percent(&figures(&summaries, "/coverage")),
            mean_percent(&figures(&summaries, "/coverage_true")),
            format!("{collisions:.0} in {} runs", summaries.len()),
        ]);
    }
    table
}

fn figures(summaries: &[&Value], path: &str) -> Vec<f64> {
    summaries.iter().map(|summary| figure(summary, path)).collect()
}

/// The mean and half of its 95 % interval, in percent.
fn mean_percent(shares: &[f64]) -> String {
    let (mean, half) = interval(shares);
    format!("{:.0} % +- {:.0}", 100.0 * mean, 100.0 * half)
}

/// The mean and half the width of its 95 % interval, by Student's t over the runs.
fn interval(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let t = StudentsT::new(0.0, 1.0, count - 1.0).map(|t| t.inverse_cdf(0.975));
    (mean, t.map_or(f64::NAN, |t| t * (variance / count).sqrt()))
}

/// The cells of a run behind home, seed and policy.
fn results(summary: &Value) -> [String; 6] {
    let coverage = figure(summary, "/coverage");
    let right = figure(summary, "/coverage_true");
    let path_m = figure(summary, "/path_m");
    [
        format!("{:.0} %", 100.0 * coverage),
        format!("{:.0} %", 100.0 * right),
        format!("{path_m:.1}"),
        summary["collisions"].to_string(),
        summary["bumper_trips"].to_string(),
        format!("{} ({})", summary["stuck_frames"], summary["stuck_longest_frames"]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_is_that_of_students_t() {
        // Mean 3, standard deviation 1.5811, five values: 3 +- 2.776 * 1.5811 / sqrt(5).
        let (mean, half) = interval(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        assert!((mean - 3.0).abs() < 1e-12 && (half - 1.963).abs() < 1e-3, "{mean} {half}");
        assert!(interval(&[1.0]).1.is_nan());
    }
}
