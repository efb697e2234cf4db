//! Localizes along real logs with the robot's own code, and prints the errors against ground truth as a table in Markdown.
//!
//! The logs are not part of the project. Their folder is an argument; without it, it is `shared/data/lidar` beside the repository.
#![forbid(unsafe_code)]

mod closures;
mod drives;
mod kiss_icp;
mod relations;
mod relocalize;
mod rover;
mod separate;
mod tour;
mod trajectory;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Parser;
use firmware_host::cli::LocalizeArgs;
use firmware_host::localize;
use serde_json::Value;

use relations::{Clock, Errors, Relation};
use trajectory::Trajectory;

/// Localizes along real logs and measures the error against ground truth.
#[derive(Parser)]
struct Arguments {
    /// Folder of the logs and relations.
    #[arg(long, value_name = "DIR", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/lidar"))]
    logs: PathBuf,
    /// Folder for trajectories and views from above.
    #[arg(long, value_name = "DIR", default_value = "target/localization")]
    out: PathBuf,
    /// Instead of the logs: trials of finding a lost robot, this many in each simulated home.
    #[arg(long, value_name = "TRIALS")]
    relocalize: Option<usize>,
    /// Instead of the logs: trials of robots that are put where their map does not say what they see, this many in each simulated home.
    #[arg(long, value_name = "TRIALS", conflicts_with = "relocalize")]
    separate: Option<usize>,
    /// Instead of the logs: errors and costs of drives with 1,081 beams in simulated homes, the last of them for an hour.
    #[arg(long, conflicts_with_all = ["relocalize", "separate"])]
    drives: bool,
}

/// A log and what is known about it.
struct Case {
    name: &'static str,
    log: &'static str,
    /// The file of relations, and how their times become the log's.
    truth: Option<(&'static str, Clock)>,
    /// What others reached, in words.
    published: &'static str,
}

const CASES: [Case; 3] = [
    Case {
        name: "Intel",
        log: "intel-corrected.log.gz",
        truth: Some(("intel.relations.gz", Clock::INTEL)),
        published: "GMapping .0261 / .94; Cartographer .0229 / .453; graph SLAM .031 m (Kuemmerle 2009)",
    },
    Case {
        name: "FR079",
        log: "freiburg-079-corrected.log.gz",
        truth: Some(("fr079.relations.gz", Clock::FREIBURG)),
        published: "GMapping .0486 / 1.00; Cartographer .0452 / .538; graph SLAM .056 m (Kuemmerle 2009)",
    },
    Case { name: "URG-04LX", log: "urg04lx-exp1.dat.gz", truth: None, published: "" },
];

const COLUMNS: [&str; 9] = [
    "log",
    "poses",
    "relations",
    "error (m / deg)",
    "standard deviation (m / deg)",
    "pairs over 30 s (m / deg)",
    "closures",
    "ms a scan p50 / p99",
    "published",
];

fn main() -> Result<()> {
    let Arguments { logs, out, relocalize, separate, drives } = Arguments::parse();
    if let Some(trials) = relocalize {
        return find_lost_robots(trials);
    }
    if let Some(trials) = separate {
        return join_maps(trials);
    }
    if drives {
        return drive_through_homes();
    }
    if !logs.is_dir() {
        println!("skipped: {} is absent, and the logs are not part of the project", logs.display());
        return Ok(());
    }
    let mut rows = Vec::new();
    let mut below = String::new();
    for case in &CASES {
        let out = out.join(case.name);
        rows.extend(measure(case, &logs, &out)?);
        below += &closures(case, &logs, &out)?;
    }
    print_table(&COLUMNS, &rows);
    print!("{below}");
    Ok(())
}

fn print_table<Row: AsRef<[String]>>(columns: &[&str], rows: &[Row]) {
    println!("| {} |\n|{}", columns.join(" | "), "---|".repeat(columns.len()));
    for row in rows {
        println!("| {} |", row.as_ref().join(" | "));
    }
}

/// Home of about 150 m2 in which a robot drives for an hour.
const HOUR_HOME: &str = "builtin:house?seed=1";

fn drive_through_homes() -> Result<()> {
    // First, because its memory is what the process grows by: later drives use what this one has freed.
    let mut hour = drives::row(HOUR_HOME, false)?;
    hour[0].push_str(", an hour");
    let mut rows = Vec::new();
    for home in relocalize::HOMES {
        let row = drives::row(home, true)?;
        eprintln!("{}", row.join("  "));
        rows.push(row);
    }
    rows.push(hour);
    print_table(&drives::COLUMNS, &rows);
    Ok(())
}

const TRIAL_COLUMNS: [&str; 7] = [
    "simulated home",
    "trials",
    "found",
    "with 3 scans",
    "wrong",
    "error p50 / max (m)",
    "seconds p50 / p95",
];

/// Restarts robots at random places of every home, in its map and in the map of the next home.
fn find_lost_robots(trials: usize) -> Result<()> {
    let homes = relocalize::HOMES;
    let mapped: Vec<_> = homes.iter().map(|home| relocalize::map(home)).collect::<Result<_>>()?;
    let mut rows = Vec::new();
    let [mut all, mut others] = [relocalize::Results::default(), relocalize::Results::default()];
    for (index, home) in homes.iter().enumerate() {
        let results = relocalize::trials(&mapped[index], &mapped[index], trials)?;
        rows.push(results.row(home));
        all.add(&results);
        let next = &mapped[(index + 1) % homes.len()];
        others.add(&relocalize::trials(&mapped[index], next, trials.div_ceil(5))?);
        eprintln!("{}", results.row(home).join("  "));
    }
    rows.push(all.row("all"));
    rows.push(others.row("in the map of another home"));
    print_table(&TRIAL_COLUMNS, &rows);
    Ok(())
}

/// Puts robots where half of a home was never mapped, where all furniture was moved, and into another home than the map's.
fn join_maps(trials: usize) -> Result<()> {
    let homes = relocalize::HOMES;
    let mut rows = Vec::new();
    for kind in 0..separate::Differs::all(homes[0]).len() {
        let mut all = separate::Results::default();
        let mut words = "";
        for (index, home) in homes.iter().enumerate() {
            let other_home = homes[(index + 1) % homes.len()];
            let (differs, in_words) = separate::Differs::all(other_home)[kind];
            words = in_words;
            // Each drive through another home takes the whole five minutes.
            let is_other = matches!(differs, separate::Differs::OtherHome(_));
            let count = if is_other { trials.div_ceil(5) } else { trials };
            let results = separate::trials(home, differs, count)?;
            let row = results.row(&format!("{home}, {words}"));
            eprintln!("{}", row.join("  "));
            rows.push(row);
            all.add(&results);
        }
        rows.push(all.row(&format!("all, {words}")));
    }
    print_table(&separate::COLUMNS, &rows);
    Ok(())
}

/// The rows of a log: the wheels alone, and the robot's poses at the time and at the end.
fn measure(case: &Case, folder: &Path, out: &Path) -> Result<Vec<Vec<String>>> {
    let log = folder.join(case.log);
    localize::run(&LocalizeArgs { log: log.clone(), out: out.to_path_buf() })?;
    let summary = summary(out)?;
    let runs = [
        ("wheels", Trajectory::by_wheels(&log)?),
        ("online", Trajectory::read(&out.join("online.tum"), &log)?),
        ("after all closures", Trajectory::read(&out.join("trajectory.tum"), &log)?),
    ];
    let mut rows = Vec::new();
    for (poses, trajectory) in &runs {
        let is_last = *poses == "after all closures";
        let mut row = vec![case.name.to_owned(), (*poses).to_owned()];
        row.extend(errors(case, folder, trajectory)?);
        row.extend(if is_last { costs(&summary) } else { [const { String::new() }; 2] });
        row.push(if is_last { case.published.to_owned() } else { String::new() });
        rows.push(row);
    }
    Ok(rows)
}

/// Sentences about the closures of a log that [`measure`] has localized along. Writes each closure with its error.
fn closures(case: &Case, folder: &Path, out: &Path) -> Result<String> {
    let Some((file, clock)) = &case.truth else { return Ok(String::new()) };
    let relations = Relation::read(&folder.join(file))?;
    let trajectory = Trajectory::read(&out.join("trajectory.tum"), &folder.join(case.log))?;
    let accepted = summary(out)?["closures"].as_u64().unwrap_or_default();
    let report = closures::Report::new(out, accepted, &relations, clock, &trajectory)?;
    std::fs::write(out.join("closures_checked.csv"), report.csv())?;
    Ok(report.sentences(case.name))
}

fn errors(case: &Case, folder: &Path, trajectory: &Trajectory) -> Result<[String; 4]> {
    let Some((file, clock)) = &case.truth else { return Ok([const { String::new() }; 4]) };
    let relations = Relation::read(&folder.join(file))?;
    let all = Errors::of(&relations, clock, trajectory, 0.0);
    let far = Errors::of(&relations, clock, trajectory, 30.0);
    Ok([all.count.to_string(), all.means(), all.deviations(), far.means()])
}

fn costs(summary: &Value) -> [String; 2] {
    let times = &summary["scan_ms"];
    let [p50, p99] = ["p50", "p99"].map(|key| times[key].as_f64().unwrap_or(f64::NAN));
    let closures = summary["closures"].to_string();
    [closures, format!("{p50:.2} / {p99:.2}")]
}

fn summary(out: &Path) -> Result<Value> {
    let path = out.join("summary.json");
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}
