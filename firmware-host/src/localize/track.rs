//! Drives the robot's localizer through a log, line by line.

use std::time::{Duration, Instant};

use hal::{LaserScan, Pose2};
use runtime::localization::{
    Estimate, LocalizationConfig, LocalizationError, Localizer, LostReason, WheelError,
};
use serde::Serialize;

use super::between_scans;
use super::closures::{Closures, ListedClosure};
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
    /// Each closed loop, in the order in which they were closed.
    pub listed: Vec<ListedClosure>,
    pub events: Events,
}

/// What localization said about the drive.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Events {
    /// The wheels began to contradict the scans.
    pub wheel_errors: Vec<Timed<WheelError>>,
    /// Scans did not fit any more. The wheels then give the pose, because robots that write logs are not carried.
    pub lost: Vec<Timed<LostReason>>,
}

/// An event at a time of the log.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Timed<T> {
    pub time_s: f64,
    pub kind: T,
}

impl Events {
    fn observe(&mut self, time_s: f64, estimate: &Estimate) {
        self.wheel_errors.extend(estimate.wheel_error.map(|kind| Timed { time_s, kind }));
        self.lost.extend(estimate.whereabouts.lost().map(|kind| Timed { time_s, kind }));
    }
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
    let mut events = Events::default();
    let mut closures = Closures::default();
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
        events.observe(line.time_s, &estimate);
        // Robots that write logs are not carried. Without this, a place of which no scan is known would end the map.
        localizer.continue_by_wheels();
        closures.observe(line.time_s, &localizer);
        online.push(estimate.t_map_base());
        anchors.push(Anchor::new(&localizer, &estimate.t_odom_base));
    }
    localizer.settle();
    closures.observe(log.lines.last().map_or(0.0, |line| line.time_s), &localizer);
    let mut corrected: Vec<_> = anchors.iter().map(|anchor| anchor.in_map(&localizer)).collect();
    between_scans::share_out(log, &mut corrected);
    Ok(Track {
        online,
        corrected,
        scan_times,
        closures: localizer.closures(),
        listed: closures.list(&localizer),
        events,
    })
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

#[cfg(test)]
mod tests {
    use hal::{Range, ScanGeometry};

    use super::super::log::{Line, Odometry};
    use super::*;

    /// Half of the sides of a room around the origin, metres. In a longer one the scans need several moments to contradict the wheels.
    const ROOM_M: [f64; 2] = [1.6, 1.9];
    const GEOMETRY: ScanGeometry = ScanGeometry::UTM_30LX;

    fn ranges(truth: &Pose2) -> Vec<Range> {
        let beams = 0..GEOMETRY.beams;
        let ranges = beams.map(|beam| {
            let (sin, cos) = (truth.yaw_rad + GEOMETRY.angle_rad(beam)).sin_cos();
            let along_m = (ROOM_M[0] - truth.x_m * cos.signum()) / cos.abs().max(1e-9);
            let across_m = (ROOM_M[1] - truth.y_m * sin.signum()) / sin.abs().max(1e-9);
            Range::Hit(along_m.min(across_m) as f32)
        });
        ranges.collect()
    }

    /// A drive of 1 m ahead and half a metre back, of which the wheels report `back_by_wheels` for each metre.
    fn there_and_back(back_by_wheels: f64) -> Log {
        let steps = std::iter::repeat_n((0.05, 0.05), 20)
            .chain(std::iter::repeat_n((-0.05, 0.05 * back_by_wheels), 10));
        let mut truth = Pose2::new(-0.6, 0.3, 0.0);
        let mut wheel = Pose2::IDENTITY;
        let mut lines = Vec::new();
        for (index, (forward_m, by_wheels_m)) in steps.enumerate() {
            truth = truth.compose(&Pose2::new(forward_m, 0.0, 0.0));
            wheel = wheel.compose(&Pose2::new(by_wheels_m, 0.0, 0.0));
            let time_s = 10.0 + 0.2 * index as f64;
            lines.push(Line { time_s, wheel, ranges: Some(ranges(&truth)) });
        }
        Log {
            geometry: GEOMETRY,
            sweep_ns: 0,
            t_base_laser: Pose2::IDENTITY,
            wheels: None,
            odometry: Odometry::Lines,
            lines,
            other_shape: 0,
        }
    }

    #[test]
    fn wheels_that_never_report_reversing_are_named_with_the_time_in_the_log() {
        let track = track(&there_and_back(1.0), &LocalizationConfig::default()).unwrap();
        let [error] = track.events.wheel_errors[..] else { panic!("{:?}", track.events) };
        assert_eq!(error.kind, WheelError::Reversed);
        assert!((14.0..15.0).contains(&error.time_s), "{error:?}");
        let (Some(first), Some(last)) = (track.online.first(), track.online.last()) else {
            panic!("no poses")
        };
        assert!((last.x_m - first.x_m - 0.45).abs() < 0.03, "{last:?}");
        assert_eq!(track.events.lost, []);
    }

    #[test]
    fn wheels_that_report_reversing_are_not_named() {
        let track = track(&there_and_back(-1.0), &LocalizationConfig::default()).unwrap();
        assert_eq!(track.events, Events::default());
    }
}
