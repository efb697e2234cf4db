//! Drives the robot's localizer through a log, line by line.

use std::time::{Duration, Instant};

use hal::{LaserScan, Pose2};
use runtime::localization::{LocalizationConfig, LocalizationError, Localizer};

use super::between_scans;
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
    pub closures: u64,
}

/// Localizes along the whole log.
///
/// # Errors
/// A scanner that cannot localize.
pub fn track(log: &Log, config: &LocalizationConfig) -> Result<Track, LocalizationError> {
    let mut localizer = Localizer::new(config, log.geometry, log.t_base_laser)?;
    let mut scan = LaserScan::empty(log.geometry);
    let mut online = Vec::with_capacity(log.lines.len());
    let mut anchors = Vec::with_capacity(log.lines.len());
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
        // Robots that write logs are not carried. Without this, a place of which no scan is known would end the map.
        localizer.continue_by_wheels();
        online.push(estimate.t_map_base());
        anchors.push(Anchor::new(&localizer, &estimate.t_odom_base));
    }
    localizer.settle();
    let mut corrected: Vec<_> = anchors.iter().map(|anchor| anchor.in_map(&localizer)).collect();
    between_scans::share_out(log, &mut corrected);
    Ok(Track { online, corrected, scan_times, closures: localizer.closures() })
}

/// A pose that moves with its submap when a loop is closed.
struct Anchor {
    submap: usize,
    t_submap_base: Pose2,
}

impl Anchor {
    fn new(localizer: &Localizer, t_odom_base: &Pose2) -> Self {
        let submap = localizer.submap();
        let t_odom_submap = localizer.submap_in_odom(submap).unwrap_or_default();
        Self { submap, t_submap_base: t_odom_submap.inverse().compose(t_odom_base) }
    }

    fn in_map(&self, localizer: &Localizer) -> Pose2 {
        let t_map_submap = localizer.submap_in_map(self.submap).unwrap_or_default();
        t_map_submap.compose(&self.t_submap_base)
    }
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}
