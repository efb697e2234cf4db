//! `firmware-host localize`: runs the robot's localization over a recorded log of another robot.

mod between_scans;
mod carmen;
mod closures;
pub mod log;
mod track;
mod trajectory;
mod urg;
mod view;

use std::path::Path;
use std::time::Duration;

use anyhow::Result;
use runtime::localization::LocalizationConfig;
use serde::Serialize;

use crate::cli::LocalizeArgs;
use crate::report::another_run::refuse_run;
use crate::report::atomic::{ReportError, prepare_dir, write_atomically};
use crate::report::summary::SUMMARY_FILE;
use log::Log;
use track::{Events, Track};

/// The poses as they were known at their times. No other command writes it.
const ONLINE_FILE: &str = "online.tum";

/// Standard deviation of one range of the scanners of logs. Public logs are of SICK scanners, whose ranges repeat within 10 to 15 mm; the robot's
/// default is that of a small scanner (docs/localization.md).
const RANGE_NOISE_M: f64 = 0.012;
/// Each loop that was closed.
const CLOSURES_FILE: &str = "closures.csv";

/// The content of `summary.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Summary {
    scans: usize,
    /// Time of the localizer for each scan, milliseconds.
    scan_ms: Times,
    closures: u64,
    /// Length of the final path.
    path_m: f64,
    #[serde(flatten)]
    events: Events,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Times {
    p50: f64,
    p99: f64,
    max: f64,
}

/// Localizes along a log, and writes the trajectories, a view from above and a summary.
///
/// # Errors
/// A log that cannot be read, or a folder that cannot be written.
pub fn run(args: &LocalizeArgs) -> Result<()> {
    // The results of an earlier `localize` are replaced, those of any other command are not.
    if !args.out.join(ONLINE_FILE).exists() {
        refuse_run(&args.out)?;
    }
    let log = Log::read(&args.log)?;
    prepare_dir(&args.out)?;
    if log.other_shape > 0 {
        let beams = log.geometry.beams;
        eprintln!("warning: {} scans do not have {beams} beams and are left out", log.other_shape);
    }
    println!("odometry: {}", log.odometry);
    let config =
        LocalizationConfig { range_noise_m: RANGE_NOISE_M, ..LocalizationConfig::default() };
    let track = track::track(&log, &config)?;
    write(&args.out, "trajectory.tum", &trajectory::tum(&log, &track.corrected))?;
    write(&args.out, ONLINE_FILE, &trajectory::tum(&log, &track.online))?;
    write(&args.out, CLOSURES_FILE, &closures::csv(&track.listed))?;
    let summary = summary(&track);
    write(&args.out, SUMMARY_FILE, &serde_json::to_string_pretty(&summary)?)?;
    view::draw(&log, &track.corrected).write_png(&args.out.join("map.png"))?;
    println!(
        "{} scans, {:.1} m, {} closures, {:.2} ms a scan",
        summary.scans, summary.path_m, summary.closures, summary.scan_ms.p50
    );
    Ok(())
}

fn write(folder: &Path, name: &str, text: &str) -> Result<(), ReportError> {
    write_atomically(&folder.join(name), text.as_bytes())
}

fn summary(track: &Track) -> Summary {
    let mut times = track.scan_times.clone();
    times.sort_unstable();
    Summary {
        scans: times.len(),
        scan_ms: Times {
            p50: share(&times, 0.5),
            p99: share(&times, 0.99),
            max: share(&times, 1.0),
        },
        closures: track.closures,
        path_m: trajectory::length_m(&track.corrected),
        events: track.events.clone(),
    }
}

/// The time in milliseconds that this share of the sorted times does not exceed.
fn share(times: &[Duration], share: f64) -> f64 {
    let rank = (share * times.len() as f64).ceil() as usize;
    times.get(rank.saturating_sub(1)).map_or(0.0, |time| time.as_secs_f64() * 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_times_that_were_measured() {
        let times: Vec<_> = (1..=200).map(Duration::from_millis).collect();
        assert_eq!([0.5, 0.99, 1.0].map(|part| share(&times, part)), [100.0, 198.0, 200.0]);
        assert_eq!(share(&[], 0.5), 0.0);
    }
}
