//! The .dat form of a URG-04LX with wheel encoders: one scan per line, 25 columns before the ranges.
//!
//! Column 1 is the time in microseconds, columns 3 and 4 are the encoder counts of the left and the right wheel, columns 26 to
//! 707 are ranges in millimetres, 0 where there is no echo. The robot's dimensions are those that the data set was published
//! with: wheels of 77 mm radius 330 mm apart, 2,000 counts for half a revolution, the scanner 145 mm ahead of the axle.

use std::f64::consts::PI;

use hal::{Pose2, Range, ScanGeometry};

use super::log::{BadLine, Line, Log, LogWheels, Odometry, Words};

const HEADER: usize = 25;
const BEAMS: usize = 682;
const WHEEL_RADIUS_M: f64 = 0.077;
const METRES_PER_COUNT: f64 = WHEEL_RADIUS_M * PI / 2000.0;
const TRACK_M: f64 = 0.33;
const LASER_FORWARD_M: f64 = 0.145;

/// The scanner according to its data sheet: 360/1024 degrees between beams, 240 degrees, 20 mm to 4 m, ten scans a second.
const GEOMETRY: ScanGeometry = ScanGeometry {
    angle_min_rad: -PI * 681.0 / 1024.0,
    angle_increment_rad: 2.0 * PI / 1024.0,
    beams: BEAMS,
    range_min_m: 0.02,
    range_max_m: 4.095,
    // The log's times are those of arrival, so that nothing is known about the times of beams.
    period_ns: 0,
    clockwise: false,
};

/// One rotation of the motor.
const SWEEP_NS: u64 = 100_000_000;

/// The first line with content begins with a number and has a column for every range.
pub(super) fn is_urg(text: &[u8]) -> bool {
    let mut lines = Words::lines(text);
    let Some(mut words) = lines
        .find_map(|mut words| words.next_word().map(|word| (word, words)))
        .filter(|(word, _)| word.parse::<u64>().is_ok())
        .map(|(_, words)| words)
    else {
        return false;
    };
    std::iter::from_fn(|| words.next_word()).count() + 1 >= HEADER
}

pub(super) fn parse(text: &[u8]) -> Result<Option<Log>, BadLine> {
    let mut lines: Vec<Line> = Vec::new();
    let mut wheel = Pose2::IDENTITY;
    let mut last: Option<[f64; 2]> = None;
    for mut words in Words::lines(text) {
        let Some(word) = words.next_word() else { continue };
        let time_us = word.parse::<u64>().ok();
        let time_us = time_us.ok_or_else(|| {
            words.refuse(format!("the time is `{word}`, which is not a whole number"))
        })?;
        words.number("column 2")?;
        let counts = [words.number("the left encoder")?, words.number("the right encoder")?];
        for column in 5..=HEADER {
            words.number(&format!("column {column}"))?;
        }
        let mut ranges = Vec::with_capacity(BEAMS);
        for beam in 1..=BEAMS {
            let range_mm = words.number(&format!("range {beam} of {BEAMS}"))?;
            ranges.push(classify(range_mm));
        }
        if let Some(last) = last {
            wheel = wheel.compose(&motion(last, counts));
        }
        last = Some(counts);
        lines.push(Line { time_s: time_us as f64 * 1e-6, wheel, ranges: Some(ranges) });
    }
    let t_base_laser = Pose2::new(LASER_FORWARD_M, 0.0, 0.0);
    let odometry = Odometry::Lines;
    let wheels = Some(LogWheels { radius_m: WHEEL_RADIUS_M, track_m: TRACK_M });
    let log = Log {
        geometry: GEOMETRY,
        sweep_ns: SWEEP_NS,
        t_base_laser,
        wheels,
        odometry,
        lines,
        other_shape: 0,
    };
    Ok((!log.lines.is_empty()).then_some(log))
}

/// Values below 20 are error codes.
fn classify(range_mm: f64) -> Range {
    if (20.0..4095.0).contains(&range_mm) {
        Range::Hit((range_mm * 1e-3) as f32)
    } else if range_mm == 0.0 || range_mm >= 4095.0 {
        Range::NoReturn
    } else {
        Range::Error
    }
}

/// Motion of the axle's middle along an arc.
fn motion(last: [f64; 2], counts: [f64; 2]) -> Pose2 {
    let [left_m, right_m] = [0, 1].map(|wheel| (counts[wheel] - last[wheel]) * METRES_PER_COUNT);
    let distance_m = 0.5 * (left_m + right_m);
    let yaw_rad = (right_m - left_m) / TRACK_M;
    let (sin, cos) = (0.5 * yaw_rad).sin_cos();
    Pose2::new(distance_m * cos, distance_m * sin, yaw_rad)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(time_us: u64, left: i64, right: i64) -> String {
        let header = vec!["0"; HEADER - 4].join(" ");
        let ranges = vec!["1500"; BEAMS].join(" ");
        format!("{time_us} 0 {left} {right} {header} {ranges} \n")
    }

    #[test]
    fn counts_become_metres_and_ranges_millimetres() {
        let text = row(1_000_000, 0, 0) + &row(1_100_000, 2000, 2000);
        assert!(is_urg(text.as_bytes()));
        let log = parse(text.as_bytes()).unwrap().unwrap();
        let line = &log.lines[1];
        assert!((line.time_s - 1.1).abs() < 1e-9);
        assert!((line.wheel.x_m - 0.077 * PI).abs() < 1e-9);
        assert_eq!(line.ranges.as_ref().unwrap()[681], Range::Hit(1.5));
    }

    #[test]
    fn a_faster_right_wheel_rotates_to_the_left() {
        assert!(motion([0.0, 0.0], [0.0, 100.0]).yaw_rad > 0.0);
    }

    #[test]
    fn a_short_row_is_refused_by_its_number() {
        let text = row(1, 0, 0) + "2 0 0 0 5\n";
        let bad = parse(text.as_bytes()).unwrap_err();
        assert_eq!((bad.line, bad.reason.as_str()), (2, "column 6 is missing"));
    }

    #[test]
    fn carmen_logs_are_not_taken_for_this_form() {
        assert!(!is_urg(b"# comment\nODOM 1 2 3"));
        assert!(!is_urg(b""));
    }
}
