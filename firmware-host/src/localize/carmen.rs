//! Logs of the CARMEN robot toolkit: ODOM, FLASER and ROBOTLASER1 lines.
//!
//! The "corrected" logs of the Radish archive hold the answer of a SLAM program in the poses of FLASER lines and in the ODOM line
//! with time 0 behind each of them. A log is taken for corrected when an ODOM line with time 0 comes after a scan; the poses of its
//! scans are then never used. Wheel odometry is the increments between neighbouring ODOM lines, restarted at every line with
//! time 0. A log that has no ODOM lines, and is not corrected, takes its odometry from the scans' lines.

use std::f64::consts::PI;

use hal::{Pose2, Range, ScanGeometry};

use super::log::{BadLine, Line, Log, Odometry, Words};

const MAX_BEAMS: usize = 100_000;

/// A line as it stands in the log.
struct Entry {
    time_s: f64,
    content: Content,
}

enum Content {
    Odometry(Pose2),
    Scan(Scan),
}

struct Scan {
    /// Direction of the first beam and angle between beams.
    angle_min_rad: f64,
    angle_increment_rad: f64,
    /// Given by ROBOTLASER1 lines.
    range_max_m: Option<f64>,
    ranges: Vec<f64>,
    laser: Pose2,
    robot: Pose2,
}

/// Parses a whole log. `None` if it has no scans.
pub(super) fn parse(text: &[u8]) -> Result<Option<Log>, BadLine> {
    let mut entries = Vec::new();
    for mut words in Words::lines(text) {
        let entry = match words.next_word() {
            Some("ODOM") => odometry(&mut words)?,
            Some("FLASER") => front_laser(&mut words)?,
            Some("ROBOTLASER1") => robot_laser(&mut words)?,
            _ => continue,
        };
        entries.push(entry);
    }
    Ok(assemble(entries))
}

/// `ODOM x y theta tv rv accel time host logger_time`
fn odometry(words: &mut Words<'_>) -> Result<Entry, BadLine> {
    let pose = words.pose("the pose of ODOM")?;
    for what in ["tv", "rv", "accel"] {
        words.number(what)?;
    }
    Ok(Entry { time_s: words.number("the time of ODOM")?, content: Content::Odometry(pose) })
}

/// `FLASER n r1 .. rn laser_x laser_y laser_theta robot_x robot_y robot_theta time host logger_time`
fn front_laser(words: &mut Words<'_>) -> Result<Entry, BadLine> {
    let ranges = ranges(words)?;
    let laser = words.pose("the pose of the laser")?;
    let robot = words.pose("the pose of the robot")?;
    let time_s = words.number("the time of FLASER")?;
    let [angle_min_rad, angle_increment_rad] = front_laser_angles(ranges.len());
    let range_max_m = None;
    let scan = Scan { angle_min_rad, angle_increment_rad, range_max_m, ranges, laser, robot };
    Ok(Entry { time_s, content: Content::Scan(scan) })
}

/// CARMEN does not write the angles of FLASER lines. SICK scanners see 180 degrees, and leave out the last beam where the count
/// is even; the Hokuyo scanners are known by their number of beams.
fn front_laser_angles(beams: usize) -> [f64; 2] {
    let count = beams as f64;
    match beams {
        682 => [-PI * 681.0 / 1024.0, 2.0 * PI / 1024.0],
        541 | 1081 => [-0.75 * PI, 1.5 * PI / (count - 1.0)],
        _ if beams.is_multiple_of(2) => [-0.5 * PI, PI / count.max(1.0)],
        _ => [-0.5 * PI, PI / (count - 1.0).max(1.0)],
    }
}

/// `ROBOTLASER1 type start fov resolution max_range accuracy remission_mode n r1 .. rn m i1 .. im laser_pose robot_pose tv rv
/// forward_safety side_safety turn_axis time host logger_time`
fn robot_laser(words: &mut Words<'_>) -> Result<Entry, BadLine> {
    words.number("the type of the laser")?;
    let angle_min_rad = words.number("the start angle")?;
    words.number("the field of view")?;
    let angle_increment_rad = words.number("the angular resolution")?;
    let range_max_m = Some(words.number("the maximum range")?);
    words.number("the accuracy")?;
    words.number("the remission mode")?;
    let ranges = ranges(words)?;
    let remissions = words.count("the number of remissions", MAX_BEAMS)?;
    for _ in 0..remissions {
        words.number("a remission")?;
    }
    let laser = words.pose("the pose of the laser")?;
    let robot = words.pose("the pose of the robot")?;
    for what in ["tv", "rv", "the forward safety distance", "the side safety distance"] {
        words.number(what)?;
    }
    words.number("the turn axis")?;
    let time_s = words.number("the time of ROBOTLASER1")?;
    let scan = Scan { angle_min_rad, angle_increment_rad, range_max_m, ranges, laser, robot };
    Ok(Entry { time_s, content: Content::Scan(scan) })
}

fn ranges(words: &mut Words<'_>) -> Result<Vec<f64>, BadLine> {
    let count = words.count("the number of ranges", MAX_BEAMS)?;
    // The count may be wrong: memory follows the ranges that are there.
    let mut ranges = Vec::new();
    for index in 1..=count {
        ranges.push(words.number(&format!("range {index} of {count}"))?);
    }
    Ok(ranges)
}

fn assemble(entries: Vec<Entry>) -> Option<Log> {
    let first = entries.iter().find_map(|entry| match &entry.content {
        Content::Scan(scan) if !scan.ranges.is_empty() => Some(scan),
        _ => None,
    })?;
    let beams = first.ranges.len();
    let t_base_laser = first.robot.inverse().compose(&first.laser);
    let range_max_m = range_max_m(&entries);
    let geometry = ScanGeometry {
        angle_min_rad: first.angle_min_rad,
        angle_increment_rad: first.angle_increment_rad,
        beams,
        range_min_m: 0.02,
        range_max_m: range_max_m as f32,
        // The mirror of these scanners takes 13 to 27 ms; the log holds the time between scans, which is far longer.
        period_ns: 0,
        clockwise: false,
    };
    let odometry = odometry_source(&entries);
    let wheels = wheel_poses(&entries, odometry);
    let mut other_shape = 0;
    let lines = entries.into_iter().zip(wheels).map(|(entry, wheel)| {
        let ranges = match entry.content {
            Content::Scan(scan) if scan.ranges.len() == beams => Some(scan.ranges),
            Content::Scan(_) => {
                other_shape += 1;
                None
            }
            Content::Odometry(_) => None,
        };
        let ranges = ranges
            .map(|ranges| ranges.into_iter().map(|range| classify(range, range_max_m)).collect());
        Line { time_s: entry.time_s, wheel, ranges }
    });
    let lines = lines.collect();
    Some(Log { geometry, sweep_ns: 0, t_base_laser, wheels: None, odometry, lines, other_shape })
}

impl Entry {
    fn is_scan(&self) -> bool {
        matches!(self.content, Content::Scan(_))
    }

    /// An ODOM line that holds what the wheels said, and no answer of another program.
    fn is_wheel_report(&self) -> bool {
        matches!(self.content, Content::Odometry(_)) && self.time_s != 0.0
    }

    fn is_answer(&self) -> bool {
        matches!(self.content, Content::Odometry(_)) && self.time_s == 0.0
    }
}

fn odometry_source(entries: &[Entry]) -> Odometry {
    let corrected = entries.iter().skip_while(|entry| !entry.is_scan()).any(Entry::is_answer);
    let has_reports = entries.iter().any(Entry::is_wheel_report);
    match (corrected, has_reports) {
        (true, true) => Odometry::BetweenAnswers,
        (true, false) => Odometry::Absent,
        (false, true) => Odometry::Lines,
        (false, false) => Odometry::Scans,
    }
}

/// Scanners report the largest value that they know where there is no echo. FLASER lines do not say which it is, so that it is the
/// largest one in the log.
fn range_max_m(entries: &[Entry]) -> f64 {
    let scans = entries.iter().filter_map(|entry| match &entry.content {
        Content::Scan(scan) => Some(scan),
        Content::Odometry(_) => None,
    });
    let given = scans.clone().find_map(|scan| scan.range_max_m);
    let largest = scans.flat_map(|scan| scan.ranges.iter().copied()).fold(0.0, f64::max);
    given.filter(|max_m| *max_m > 0.0).map_or(largest, |max_m| max_m.min(largest))
}

fn classify(range_m: f64, range_max_m: f64) -> Range {
    if range_m >= 0.995 * range_max_m {
        Range::NoReturn
    } else if range_m > 0.0 {
        Range::Hit(range_m as f32)
    } else {
        Range::Error
    }
}

/// The pose by the wheels for every line, beginning at the identity.
fn wheel_poses(entries: &[Entry], odometry: Odometry) -> Vec<Pose2> {
    let mut wheel = Pose2::IDENTITY;
    let mut last: Option<Pose2> = None;
    let mut poses = Vec::with_capacity(entries.len());
    for entry in entries {
        let reported = match (&entry.content, odometry) {
            (Content::Odometry(pose), Odometry::Lines | Odometry::BetweenAnswers) => Some(*pose),
            (Content::Scan(scan), Odometry::Scans) => Some(scan.robot),
            _ => None,
        };
        if let Some(pose) = reported {
            let restarts = odometry == Odometry::BetweenAnswers && entry.is_answer();
            if let Some(last) = last.filter(|_| !restarts) {
                wheel = wheel.compose(&last.inverse().compose(&pose));
            }
            last = Some(pose);
        }
        poses.push(wheel);
    }
    if odometry == Odometry::Lines {
        interpolate_scans(entries, &mut poses);
    }
    poses
}

/// Moves the wheel poses of scans to their own time, between the ODOM lines around them.
fn interpolate_scans(entries: &[Entry], poses: &mut [Pose2]) {
    let mut before = None;
    for index in 0..entries.len() {
        if entries[index].is_wheel_report() {
            before = Some(index);
            continue;
        }
        // The next ODOM line is one of the next few lines.
        let mut near = index + 1..entries.len().min(index + 20);
        let after = near.find(|after| entries[*after].is_wheel_report());
        let (Some(before), Some(after)) = (before, after) else { continue };
        let [begin_s, time_s, end_s] = [before, index, after].map(|at| entries[at].time_s);
        if begin_s < time_s && time_s < end_s {
            let share = (time_s - begin_s) / (end_s - begin_s);
            poses[index] = between(&poses[before], &poses[after], share);
        }
    }
}

fn between(from: &Pose2, to: &Pose2, share: f64) -> Pose2 {
    let motion = from.inverse().compose(to);
    from.compose(&Pose2::new(share * motion.x_m, share * motion.y_m, share * motion.yaw_rad))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(text: &str) -> Log {
        parse(text.as_bytes()).unwrap().unwrap()
    }

    const FLASER: &str = "FLASER 4 1.5 81.83 0 2 9 9 9 9 9 9";

    #[test]
    fn the_answer_in_a_corrected_log_is_no_input() {
        let text = format!(
            "ODOM 0 0 0 0 0 0 1.0 h 1.0\nODOM 1 0 0 0 0 0 2.0 h 2\n{FLASER} 2.0 h 2.0\nODOM 9 9 9 0 0 0 0 h 0\n\
             NEFF 12\nODOM 10 9 9 0 0 0 3.0 h 3"
        );
        let log = log(&text);
        assert_eq!(log.lines.len(), 5);
        let last = log.lines[4].wheel;
        // One metre in x of a frame that is rotated by 9 radians.
        assert!((last.x_m - 1.0 - 9.0_f64.cos()).abs() < 1e-9, "{last:?}");
        assert!((last.y_m + 9.0_f64.sin()).abs() < 1e-9);
        assert_eq!(log.lines[2].wheel, Pose2::new(1.0, 0.0, 0.0));
    }

    #[test]
    fn the_largest_value_is_no_return_and_zero_is_an_error() {
        let log = log(&format!("{FLASER} 2.0 h 2.0\n"));
        let ranges = log.lines[0].ranges.as_ref().unwrap();
        assert_eq!(ranges[..], [Range::Hit(1.5), Range::NoReturn, Range::Error, Range::Hit(2.0)]);
    }

    #[test]
    fn a_scan_between_two_odometry_lines_has_the_pose_of_its_own_time() {
        let text = format!("ODOM 0 0 0 0 0 0 1 h 1\n{FLASER} 1.25 h 1\nODOM 1 0 0 0 0 0 2 h 2");
        assert!((log(&text).lines[1].wheel.x_m - 0.25).abs() < 1e-12);
    }

    #[test]
    fn a_log_without_odometry_lines_takes_the_odometry_of_its_scans() {
        let text = "FLASER 1 1.0 0 0 0 0 0 0 1 h 1\nFLASER 1 1.0 5 0 0 5 0 0 2 h 2";
        assert_eq!(log(text).lines[1].wheel, Pose2::new(5.0, 0.0, 0.0));
    }

    #[test]
    fn a_corrected_log_without_wheel_reports_has_no_odometry() {
        let text =
            format!("{FLASER} 1 h 1\nODOM 9 9 9 0 0 0 0 h 0\nFLASER 1 1.0 5 0 0 5 0 0 2 h 2");
        let log = log(&text);
        assert_eq!(log.odometry, Odometry::Absent);
        assert!(log.lines.iter().all(|line| line.wheel == Pose2::IDENTITY));
    }

    #[test]
    fn robotlaser_lines_say_their_angles_and_the_place_of_the_laser() {
        let text =
            "ROBOTLASER1 0 -1.57 3.14 0.0314 30 0.01 0 2 1 2 0 0.1 0 0 0 0 0 0 0 0 0 0 7.5 h 7.5";
        let log = log(text);
        assert_eq!(log.geometry.angle_increment_rad, 0.0314);
        assert_eq!(log.t_base_laser, Pose2::new(0.1, 0.0, 0.0));
        assert_eq!(log.lines[0].time_s, 7.5);
    }

    #[test]
    fn a_wrong_value_is_named_with_its_line() {
        let bad = refused("# x\nODOM 0 0 nan 0 0 0 1 h 1");
        assert_eq!(bad.line, 2);
        assert_eq!(
            bad.reason,
            "the pose of ODOM is `nan`, which is not a finite number below 1e12"
        );
        assert_eq!(refused("FLASER 3 1.0 2.0").reason, "range 3 of 3 is missing");
        let bad = refused("FLASER 99999999999 1");
        assert!(bad.reason.contains("not a whole number up to 100000"), "{}", bad.reason);
    }

    fn refused(text: &str) -> BadLine {
        parse(text.as_bytes()).unwrap_err()
    }

    #[test]
    fn a_log_without_scans_is_none() {
        assert_eq!(parse(b"ODOM 0 0 0 0 0 0 1 h 1").unwrap(), None);
        assert_eq!(parse(b"\xff\xfe\n\n").unwrap(), None);
    }
}
