//! Tests of what the LiDAR hides from the camera: a network that takes a wall for more distant than it is.

use hal::{LaserScan, Pose2, Range, ScanGeometry};

use super::tests::{camera, exact_depth, mount, room};
use super::{CellState, MapConfig, OccupancyGrid};

/// Distance of the true wall from the robot, and of the wall that the depth shows.
const TRUE_M: f64 = 1.0;
const SEEN_M: f64 = 1.8;

/// A scan of a wall across the robot's heading.
fn scan_of_a_wall(mut change: impl FnMut(usize, f64, f32) -> Range) -> LaserScan {
    let geometry = ScanGeometry::UTM_30LX;
    let ranges = (0..geometry.beams).map(|beam| {
        let angle_rad = geometry.angle_rad(beam);
        let range_m = if angle_rad.abs() < 1.4 { TRUE_M / angle_rad.cos() } else { 5.0 };
        change(beam, angle_rad, range_m as f32)
    });
    LaserScan { time_ns: 0, geometry, ranges: ranges.collect() }
}

fn whole_scan() -> LaserScan {
    scan_of_a_wall(|_, _, range_m| Range::Hit(range_m))
}

/// The map after depth of the wall at [`SEEN_M`], ten frames, with the robot `driven_m` behind where the scan was taken.
fn map_after(scan: &LaserScan, config: &MapConfig, driven_m: f64) -> OccupancyGrid {
    let mut map = OccupancyGrid::new(config).unwrap();
    let depth_of = |pose: &Pose2| {
        let t_odom_camera = mount(pose, 0.0);
        (exact_depth(&room([2.0 * SEEN_M, 6.0]), &camera(), &t_odom_camera), t_odom_camera)
    };
    map.begin_update(&Pose2::IDENTITY).unwrap();
    map.hide_behind(scan, &Pose2::IDENTITY).unwrap();
    map.finish_update();
    let pose = Pose2 { x_m: -driven_m, ..Pose2::IDENTITY };
    let (depth, t_odom_camera) = depth_of(&pose);
    for _ in 0..10 {
        map.begin_update(&pose).unwrap();
        map.integrate_depth(&depth, &camera(), &t_odom_camera).unwrap();
        map.finish_update();
    }
    map
}

/// The states before the wall, right behind it, and where the depth shows it.
fn states(map: &OccupancyGrid) -> [CellState; 3] {
    [0.8, 1.5, SEEN_M + 0.015].map(|x_m| map.state_at(x_m, 0.0))
}

#[test]
fn depth_that_ends_behind_a_wall_of_the_scan_stays_out_of_the_map() {
    let map = map_after(&whole_scan(), &MapConfig::default(), 0.0);
    assert_eq!(states(&map), [CellState::Free, CellState::Unknown, CellState::Unknown]);
    // The LiDAR knows nothing of what is a little behind its hits: a ledge, or noise.
    assert_eq!(map.state_at(TRUE_M + 0.1, 0.0), CellState::Free);
}

#[test]
fn with_a_large_margin_nothing_is_hidden() {
    let config = MapConfig { behind_hit_m: 20.0, ..MapConfig::default() };
    let map = map_after(&whole_scan(), &config, 0.0);
    assert_eq!(states(&map), [CellState::Free, CellState::Free, CellState::Occupied]);
}

#[test]
fn a_chairs_leg_hides_nothing() {
    let leg = scan_of_a_wall(|_, angle_rad, _| {
        if angle_rad.abs() < 0.03 { Range::Hit(TRUE_M as f32) } else { Range::Hit(5.0) }
    });
    let map = map_after(&leg, &MapConfig::default(), 0.0);
    assert_eq!(states(&map), [CellState::Free, CellState::Free, CellState::Occupied]);
}

#[test]
fn a_beam_that_is_lost_now_and_then_makes_no_hole_in_the_wall() {
    let holes = scan_of_a_wall(
        |beam, _, range_m| {
            if beam % 7 == 0 { Range::NoReturn } else { Range::Hit(range_m) }
        },
    );
    assert_eq!(holes.ranges[540 / 7 * 7], Range::NoReturn);
    let map = map_after(&holes, &MapConfig::default(), 0.0);
    for step in -100..=100 {
        let y_m = f64::from(step) * 0.01;
        assert_eq!(map.state_at(1.5, y_m), CellState::Unknown, "{y_m}");
    }
}

#[test]
fn without_echoes_nothing_is_hidden() {
    let glass = scan_of_a_wall(|_, _, _| Range::NoReturn);
    let map = map_after(&glass, &MapConfig::default(), 0.0);
    assert_eq!(states(&map)[1], CellState::Free);
}

#[test]
fn a_scan_hides_until_the_robot_has_driven_on() {
    let states_after =
        |driven_m| states(&map_after(&whole_scan(), &MapConfig::default(), driven_m));
    assert_eq!(states_after(0.09)[1], CellState::Unknown);
    assert_eq!(states_after(0.11)[1], CellState::Free);
}

#[test]
fn a_scan_that_is_not_of_its_geometry_is_refused() {
    let mut map = OccupancyGrid::new(&MapConfig::default()).unwrap();
    map.begin_update(&Pose2::IDENTITY).unwrap();
    let mut scan = whole_scan();
    scan.ranges.pop();
    assert!(map.hide_behind(&scan, &Pose2::IDENTITY).is_err());
    let nowhere = Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY };
    assert!(map.hide_behind(&whole_scan(), &nowhere).is_err());
}
