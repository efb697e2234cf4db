//! What the robot maps while it rotates with a scanner that takes a tenth of a second for a revolution.

use hal::{LaserScan, Pose2, Range, ScanGeometry, Twist2};

use super::test_robot::{ROOM_M, config, range_m};
use super::*;
use crate::localization::PoseSource;
use crate::recording::RecordedTick;
use crate::session::recompute;

const YAW_RATE_RADPS: f64 = 0.7;

/// The scan of a clockwise scanner whose middle is at `yaw_rad`.
fn scan(yaw_rad: f64, time_ns: u64) -> LaserScan {
    let geometry = ScanGeometry::LD06;
    let ranges = (0..geometry.beams).map(|beam| {
        let yaw_rad = yaw_rad + YAW_RATE_RADPS * geometry.after_middle_s(beam);
        Range::Hit(range_m(&Pose2::new(0.0, 0.0, yaw_rad), geometry.angle_rad(beam)) as f32)
    });
    LaserScan { time_ns: time_ns - geometry.period_ns / 2, geometry, ranges: ranges.collect() }
}

/// The occupied cells of a robot that rotates and reports this velocity: those at a wall, and those that are elsewhere.
fn occupied(reported: Twist2) -> [usize; 2] {
    let mut config = config();
    config.localization.source = PoseSource::Wheels;
    let mut robot = Robot::new(config, None).unwrap();
    for tick in 1..60 {
        let time_ns = tick * 100_000_000;
        let yaw_rad = YAW_RATE_RADPS * tick as f64 * 0.1;
        let mut input = RecordedTick::new(tick, time_ns);
        input.wheel.odom = Pose2::new(0.0, 0.0, yaw_rad);
        input.wheel.twist = reported;
        input.scan_odom = input.wheel.odom;
        input.scan = Some(scan(yaw_rad, time_ns));
        recompute(&mut robot, &input).unwrap();
    }
    let mut counts = [0; 2];
    for (cell, log_odds) in robot.map().known_cells() {
        let [x_m, y_m] = robot.map().center_m(cell);
        let from_wall_m = (x_m.abs() - ROOM_M[0]).abs().min((y_m.abs() - ROOM_M[1]).abs());
        if log_odds > 0.0 {
            counts[usize::from(from_wall_m > 0.04)] += 1;
        }
    }
    counts
}

#[test]
fn walls_are_where_they_are_although_the_robot_rotates_during_its_scans() {
    let rotates = Twist2 { linear_mps: 0.0, angular_radps: YAW_RATE_RADPS };
    let [at_wall, elsewhere] = occupied(rotates);
    assert!(at_wall > 100 && elsewhere == 0, "{at_wall} and {elsewhere}");
    let [_, elsewhere] = occupied(Twist2::ZERO);
    assert!(elsewhere > 20, "{elsewhere} with the motion left in");
}
