//! Poses of the lines between two scans, once the poses of both scans are known.
//!
//! As a log is read, the pose between scans follows the wheels from the last scan. Afterwards the next scan's pose is known
//! too: what the wheels got wrong between the two is shared out in proportion to the path.

use hal::Pose2;

use super::log::{Line, Log};

/// Metres of path that a radian of rotation counts as: half the track of a small robot is less, but rotation is where wheels are
/// most often wrong.
const METRES_PER_RADIAN: f64 = 0.5;

/// Corrects the poses of lines without a scan. `poses` has one pose for each line.
pub(super) fn share_out(log: &Log, poses: &mut [Pose2]) {
    let mut last: Option<usize> = None;
    for (index, line) in log.lines.iter().enumerate() {
        if line.ranges.is_none() {
            continue;
        }
        if let Some(last) = last {
            share_out_between(&log.lines[last..=index], &mut poses[last..=index]);
        }
        last = Some(index);
    }
}

/// The first and the last line are scans.
fn share_out_between(lines: &[Line], poses: &mut [Pose2]) {
    let [first, .., last] = poses else { return };
    let ([start, ..], [.., end]) = (lines, lines) else { return };
    let by_wheels = start.wheel.inverse().compose(&end.wheel);
    let wrong = by_wheels.inverse().compose(&first.inverse().compose(last));
    let total = way(lines);
    let first = *first;
    let count = poses.len();
    for index in 1..count - 1 {
        let share = if total > 0.0 { way(&lines[..=index]) / total } else { 0.0 };
        let there = start.wheel.inverse().compose(&lines[index].wheel);
        let part = Pose2::new(share * wrong.x_m, share * wrong.y_m, share * wrong.yaw_rad);
        poses[index] = first.compose(&there).compose(&part);
    }
}

fn way(lines: &[Line]) -> f64 {
    let steps = lines.windows(2).map(|pair| {
        let step = pair[0].wheel.inverse().compose(&pair[1].wheel);
        step.x_m.hypot(step.y_m) + METRES_PER_RADIAN * step.yaw_rad.abs()
    });
    steps.sum()
}

#[cfg(test)]
mod tests {
    use super::super::log::Odometry;
    use super::*;
    use hal::ScanGeometry;

    fn log(wheels: &[f64]) -> Log {
        let last = wheels.len() - 1;
        let lines = wheels.iter().enumerate().map(|(index, x_m)| Line {
            time_s: index as f64,
            wheel: Pose2::new(*x_m, 0.0, 0.0),
            ranges: (index == 0 || index == last).then(Vec::new),
        });
        Log {
            geometry: ScanGeometry::UTM_30LX,
            t_base_laser: Pose2::IDENTITY,
            sweep_ns: 0,
            wheels: None,
            odometry: Odometry::Lines,
            lines: lines.collect(),
            other_shape: 0,
        }
    }

    #[test]
    fn what_the_wheels_got_wrong_is_shared_out_along_the_way() {
        let log = log(&[0.0, 0.1, 0.5, 1.0]);
        let mut poses: Vec<_> = log.lines.iter().map(|line| line.wheel).collect();
        poses[3].y_m = 0.2;
        share_out(&log, &mut poses);
        let across: Vec<_> = poses.iter().map(|pose| (pose.y_m * 1e6).round() / 1e6).collect();
        assert_eq!(across, [0.0, 0.02, 0.1, 0.2]);
    }

    #[test]
    fn lines_of_a_robot_that_stands_stay_at_the_scan_before_them() {
        let log = log(&[1.0, 1.0, 1.0]);
        let mut poses = vec![Pose2::new(5.0, 0.0, 0.0); 3];
        share_out(&log, &mut poses);
        assert_eq!(poses[1], poses[0]);
    }
}
