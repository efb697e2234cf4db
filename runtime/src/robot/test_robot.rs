//! A robot in a small room, whose scans follow from geometry.

use hal::{CameraModel, LaserScan, Pose2, Range, RobotDescription, ScanGeometry};

use super::*;
use crate::exploration::PolicyKind;
use crate::mapping::MapConfig;
use crate::recording::RecordedTick;
use crate::session::recompute;

/// Half of the sides of a room around the origin, metres.
pub(super) const ROOM_M: [f64; 2] = [2.0, 1.4];
/// One beam per degree.
pub(super) const GEOMETRY: ScanGeometry = ScanGeometry {
    beams: 270,
    angle_min_rad: -134.5 * std::f64::consts::PI / 180.0,
    angle_increment_rad: std::f64::consts::PI / 180.0,
    ..ScanGeometry::UTM_30LX
};

pub(crate) fn config() -> RobotConfig {
    let camera = CameraModel::pinhole(64, 32, 1.5);
    let default = RobotConfig::of(&RobotDescription::default(), camera, PolicyKind::Frontier, 1);
    // A small map, because it is written to a snapshot.
    let map = MapConfig { side_cells: 256, recenter_cells: 20, ..default.map };
    RobotConfig { map, ..default }
}

pub(super) fn robot() -> Robot {
    Robot::new(config(), None).unwrap()
}

/// What the scanner measures at a true pose in a room around the origin with these half sides.
fn scan(truth: &Pose2, room_m: [f64; 2], time_ns: u64) -> LaserScan {
    let ranges = (0..GEOMETRY.beams)
        .map(|beam| Range::Hit(range_in(room_m, truth, GEOMETRY.angle_rad(beam)) as f32));
    LaserScan { time_ns, geometry: GEOMETRY, ranges: ranges.collect() }
}

/// Distance of the wall in a direction from a pose in the room.
pub(super) fn range_m(from: &Pose2, angle_rad: f64) -> f64 {
    range_in(ROOM_M, from, angle_rad)
}

fn range_in(room_m: [f64; 2], from: &Pose2, angle_rad: f64) -> f64 {
    let (sin, cos) = (from.yaw_rad + angle_rad).sin_cos();
    to_wall_m(from.x_m, cos, room_m[0]).min(to_wall_m(from.y_m, sin, room_m[1]))
}

/// Length of a ray from `at_m` to the wall that it meets on one axis.
fn to_wall_m(at_m: f64, direction: f64, half_m: f64) -> f64 {
    if direction.abs() < 1e-9 {
        return f64::INFINITY;
    }
    (half_m - at_m * direction.signum()) / direction.abs()
}

/// The robot stands at a true pose; its wheels report `wheel`.
pub(super) fn stand(robot: &mut Robot, tick: u64, truth: &Pose2, wheel: Pose2) -> Decision {
    recompute(robot, &standing(tick, truth, wheel)).unwrap()
}

/// The input of a tick in which the robot stands at a true pose and its wheels report `wheel`.
pub(crate) fn standing(tick: u64, truth: &Pose2, wheel: Pose2) -> RecordedTick {
    let time_ns = tick * 100_000_000;
    let mut input = RecordedTick::new(tick, time_ns);
    input.wheel.odom = wheel;
    input.scan_odom = wheel;
    input.scan = Some(scan(truth, ROOM_M, time_ns));
    input
}

/// As [`standing`], in another room.
pub(super) fn standing_in(
    room_m: [f64; 2],
    tick: u64,
    truth: &Pose2,
    wheel: Pose2,
) -> RecordedTick {
    let input = standing(tick, truth, wheel);
    RecordedTick { scan: Some(scan(truth, room_m, input.time_ns)), ..input }
}

/// Drives 0.9 m ahead through the room.
pub(super) fn drive(robot: &mut Robot) -> Pose2 {
    let mut truth = Pose2::IDENTITY;
    for tick in 0..30 {
        truth = Pose2::new(0.03 * tick as f64, 0.0, 0.0);
        stand(robot, tick, &truth, truth);
    }
    truth
}

pub(super) fn cells(map: &OccupancyGrid) -> Vec<(crate::mapping::Cell, u32)> {
    map.known_cells().map(|(cell, log_odds)| (cell, log_odds.to_bits())).collect()
}
