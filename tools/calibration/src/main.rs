//! Drives simulated robots whose configuration is wrong, and prints what calibration finds as a table in Markdown.
//!
//! Nothing but the drive goes into the measurement; the truth only judges it.
#![forbid(unsafe_code)]

mod corrected;
mod pattern;
mod table;
mod trial;
mod truth;
mod watch;

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use clap::Parser;
use simulator::{OpenOptions, World};

use trial::Length;

/// Drives simulated robots whose configuration is wrong, and measures what calibration finds.
#[derive(Parser)]
struct Arguments {
    /// Number of robots.
    #[arg(long, default_value_t = 30)]
    robots: u64,
    /// Number of the first robot.
    #[arg(long, default_value_t = 1)]
    first: u64,
    /// Length of a drive, seconds.
    #[arg(long, default_value_t = 300.0)]
    seconds: f64,
    /// Time during which frames are taken, from the beginning of a drive, seconds; 0 for wheels and scanner alone.
    #[arg(long, default_value_t = 120.0)]
    frames: f64,
    /// Instead: change the robots while they drive, and measure what a robot finds of that itself, with this many robots for each
    /// change.
    #[arg(long, value_name = "ROBOTS")]
    watch: Option<u64>,
    /// With --watch: only this change; `none` drives undisturbed robots for --seconds.
    #[arg(long, value_name = "NAME", requires = "watch")]
    only: Option<String>,
    /// Folder for configurations of each robot before and after its calibration.
    #[arg(long, value_name = "DIR", conflicts_with = "watch")]
    configurations: Option<PathBuf>,
    /// File for every error and standard deviation, as JSON.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// The homes in which the robots drive, one after the other.
pub(crate) const HOMES: [&str; 3] = ["builtin:apartment", "builtin:house", "builtin:office"];

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    if let Some(robots) = arguments.watch {
        let seeds = arguments.first..arguments.first + robots;
        return watch::measure(seeds, arguments.only.as_deref(), arguments.seconds);
    }
    let length = Length { drive_s: arguments.seconds, frames_s: arguments.frames };
    if let Some(dir) = &arguments.configurations {
        std::fs::create_dir_all(dir)?;
    }
    let mut trials = table::Trials::default();
    for seed in arguments.first..arguments.first + arguments.robots {
        let home = HOMES[seed as usize % HOMES.len()];
        let scene = format!("{home}?seed={seed}");
        let world = Arc::new(World::open(&scene, &OpenOptions::default())?);
        let config = truth::robot(seed);
        match trial::run(&world, &config, seed, length) {
            Ok(findings) => {
                trials.add(seed, &config, &findings);
                if let Some(dir) = &arguments.configurations {
                    corrected::write(dir, seed, &config, &findings)?;
                }
            }
            Err(error) => eprintln!("robot {seed} in {scene}: {error:#}"),
        }
        eprintln!("robot {seed} of {}", arguments.first + arguments.robots - 1);
    }
    println!("{}", trials.table());
    if let Some(out) = arguments.out {
        std::fs::write(out, trials.json())?;
    }
    Ok(())
}
