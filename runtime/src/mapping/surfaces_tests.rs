//! Tests of what the surfaces of a scan do to the camera's cells: depth that takes a wall for more distant than it is, or for nearer.

use hal::{LaserScan, Pose2, Range, ScanGeometry};

use super::tests::{Solid, camera, exact_depth, mount, room};
use super::{CellState, LidarUse, MapConfig, OccupancyGrid, Surfaces};
use crate::perception::DepthEstimate;

/// Distance of the true wall from the robot, and of the wall that the depth shows, metres.
const TRUE_M: f64 = 1.0;
const SEEN_M: f64 = 1.8;
/// A laser that is turned and far from the map's origin.
const SOMEWHERE: Pose2 = Pose2 { x_m: 4.0, y_m: -3.0, yaw_rad: 2.5 };

/// A scanner that sees all around, and begins behind the robot.
fn round() -> ScanGeometry {
    let angle_increment_rad = core::f64::consts::TAU / 400.0;
    let angle_min_rad = -core::f64::consts::PI;
    ScanGeometry { angle_min_rad, angle_increment_rad, beams: 400, ..ScanGeometry::UTM_30LX }
}

/// A scan of a wall across the robot's heading; `change` gives the result of a beam from its number, angle and range.
fn scan_of(geometry: ScanGeometry, mut change: impl FnMut(usize, f64, f32) -> Range) -> LaserScan {
    let ranges = (0..geometry.beams).map(|beam| {
        let angle_rad = geometry.angle_rad(beam);
        let range_m = if angle_rad.abs() < 1.4 { TRUE_M / angle_rad.cos() } else { 5.0 };
        change(beam, angle_rad, range_m as f32)
    });
    LaserScan { time_ns: 0, geometry, ranges: ranges.collect() }
}

fn hit(_: usize, _: f64, range_m: f32) -> Range {
    Range::Hit(range_m)
}

fn whole_scan() -> LaserScan {
    scan_of(ScanGeometry::UTM_30LX, hit)
}

fn surfaces_of(scan: &LaserScan) -> Surfaces {
    let mut surfaces = Surfaces::default();
    surfaces.measure(scan, &Pose2::IDENTITY, &Pose2::IDENTITY);
    surfaces
}

/// The map after ten frames of the depth of these solids.
fn map_of(solids: &[Solid], surfaces: &Surfaces, config: &MapConfig) -> OccupancyGrid {
    let depth = exact_depth(solids, &camera(), &mount(&Pose2::IDENTITY, 0.0));
    map_of_depth(&depth, surfaces, config)
}

fn map_of_depth(depth: &DepthEstimate, surfaces: &Surfaces, config: &MapConfig) -> OccupancyGrid {
    let mut map = OccupancyGrid::new(config).unwrap();
    integrate(&mut map, depth, surfaces, 10);
    map
}

fn integrate(map: &mut OccupancyGrid, depth: &DepthEstimate, surfaces: &Surfaces, frames: usize) {
    let t_odom_camera = mount(&Pose2::IDENTITY, 0.0);
    for _ in 0..frames {
        map.begin_update(&Pose2::IDENTITY).unwrap();
        map.integrate_depth(depth, &camera(), &t_odom_camera, surfaces).unwrap();
        map.finish_update();
    }
}

/// The map of depth that shows the wall at [`SEEN_M`].
fn map_after(scan: &LaserScan, config: &MapConfig) -> OccupancyGrid {
    map_of(&room([2.0 * SEEN_M, 6.0]), &surfaces_of(scan), config)
}

/// The states before the wall, behind it, and where the depth shows it.
fn states(map: &OccupancyGrid) -> [CellState; 3] {
    [0.8, 1.5, SEEN_M + 0.015].map(|x_m| map.state_at(x_m, 0.0))
}

const SEEN: [CellState; 3] = [CellState::Free, CellState::Free, CellState::Occupied];
const HIDDEN: [CellState; 3] = [CellState::Free, CellState::Unknown, CellState::Unknown];

#[test]
fn what_the_camera_shows_behind_a_wall_of_the_scan_stays_out_of_the_map() {
    let map = map_after(&whole_scan(), &MapConfig::default());
    assert_eq!(states(&map), HIDDEN);
    // Ranges and poses are noisy: up to `behind_hit_m` the LiDAR does not know better.
    assert_eq!(map.state_at(TRUE_M + 0.08, 0.0), CellState::Free);
    assert_eq!(states(&map_after(&scan_of(round(), hit), &MapConfig::default())), HIDDEN);
}

#[test]
fn a_large_margin_and_a_map_without_lidar_hide_nothing() {
    let config = MapConfig { behind_hit_m: 20.0, ..MapConfig::default() };
    assert_eq!(states(&map_after(&whole_scan(), &config)), SEEN);
    let config = MapConfig { lidar: LidarUse::Off, ..MapConfig::default() };
    assert_eq!(states(&map_after(&whole_scan(), &config)), SEEN);
}

#[test]
fn a_chairs_leg_hides_nothing() {
    let leg = scan_of(ScanGeometry::UTM_30LX, |_, angle_rad, _| {
        Range::Hit(if angle_rad.abs() < 0.03 { TRUE_M as f32 } else { 5.0 })
    });
    assert_eq!(states(&map_after(&leg, &MapConfig::default())), SEEN);
}

#[test]
fn the_edge_of_a_table_behind_a_box_is_marked_and_a_high_shelf_there_is_not() {
    // The table top leaves the image when the robot is nearer than 1.2 m; the shelf does not.
    let table = [[1.515, -0.5, 0.30], [1.7, 0.5, 0.45]];
    let shelf = [[1.515, -0.5, 0.30], [1.7, 0.5, 1.20]];
    assert_eq!(state_behind_the_box(table), CellState::Occupied);
    assert_eq!(state_behind_the_box(shelf), CellState::Unknown);
}

fn state_behind_the_box(solid: Solid) -> CellState {
    let map = map_of(&[solid], &surfaces_of(&whole_scan()), &MapConfig::default());
    map.state_at(1.515, 0.0)
}

#[test]
fn a_lone_echo_is_no_surface_at_any_distance() {
    for range_m in [0.02, 0.1, 0.3, 1.0, 5.0] {
        let echo = scan_of(ScanGeometry::UTM_30LX, |beam, _, _| {
            if beam == 540 { Range::Hit(range_m) } else { Range::NoReturn }
        });
        assert_eq!(surfaces_of(&echo).toward([6.0, 0.0]), None, "{range_m}");
    }
}

#[test]
fn a_beam_that_is_lost_now_and_then_makes_no_hole_in_the_wall() {
    let holes = scan_of(ScanGeometry::UTM_30LX, |beam, _, range_m| {
        if beam % 7 == 0 { Range::NoReturn } else { Range::Hit(range_m) }
    });
    let map = map_after(&holes, &MapConfig::default());
    for step in -100..=100 {
        let y_m = f64::from(step) * 0.01;
        assert_eq!(map.state_at(1.5, y_m), CellState::Unknown, "{y_m}");
    }
}

#[test]
fn without_echoes_and_with_ranges_that_are_no_numbers_nothing_is_hidden() {
    for range in [Range::NoReturn, Range::Error, Range::Hit(f32::NAN), Range::Hit(-1.0)] {
        let scan = scan_of(ScanGeometry::UTM_30LX, |_, _, _| range);
        assert_eq!(states(&map_after(&scan, &MapConfig::default())), SEEN, "{range:?}");
    }
}

#[test]
fn beams_that_do_not_turn_counter_clockwise_hide_nothing() {
    for angle_increment_rad in [-0.004, 0.0, f64::NAN, f64::INFINITY] {
        let geometry = ScanGeometry { angle_increment_rad, ..ScanGeometry::UTM_30LX };
        let scan = scan_of(geometry, |_, _, _| Range::Hit(1.0));
        assert_eq!(states(&map_after(&scan, &MapConfig::default())), SEEN);
    }
}

#[test]
fn a_surface_hides_what_is_behind_it_wherever_the_laser_is_and_whatever_its_first_beam() {
    for geometry in [ScanGeometry::UTM_30LX, round()] {
        let scan = scan_of(geometry, |_, _, _| Range::Hit(1.0));
        let mut surfaces = Surfaces::default();
        surfaces.measure(&scan, &SOMEWHERE, &Pose2::IDENTITY);
        for degrees in -179_i32..=180 {
            let angle_rad = f64::from(degrees).to_radians();
            let is_round = geometry.beams == 400;
            // Half the width of a surface is missing at either edge of the field of view.
            let is_seen = is_round || degrees.abs() < 129;
            let is_unseen = !is_round && degrees.abs() > 135;
            assert!(!hides(&surfaces, 1.14, angle_rad), "{degrees}");
            assert!(hides(&surfaces, 1.16, angle_rad) || !is_seen, "{degrees}");
            assert!(!hides(&surfaces, 1.16, angle_rad) || !is_unseen, "{degrees}");
        }
    }
}

fn hides(surfaces: &Surfaces, distance_m: f64, angle_rad: f64) -> bool {
    let [x_m, y_m] = [angle_rad.cos(), angle_rad.sin()].map(|part| part * distance_m);
    surfaces
        .toward(SOMEWHERE.transform(x_m, y_m).into())
        .is_some_and(|surface| surface.behind_m > 0.15)
}

/// The map of a wall across the view at this distance, seen with this confidence, while the scan measures a wall at [`TRUE_M`].
fn map_of_wall_at(x_m: f64, confidence: f32, config: &MapConfig) -> OccupancyGrid {
    let wall = [[x_m, -5.0, 0.0], [x_m + 0.2, 5.0, 2.5]];
    let t_odom_camera = mount(&Pose2::IDENTITY, 0.0);
    let mut depth = exact_depth(&[wall], &camera(), &t_odom_camera);
    depth.confidence.fill(confidence);
    map_of_depth(&depth, &surfaces_of(&whole_scan()), config)
}

#[test]
fn an_obstacle_whose_distance_agrees_with_the_surface_is_marked_at_the_surface() {
    let config = MapConfig::default();
    // Half of the depths with a confidence of 0.9 are wrong by less than 25 % * atanh(0.5) / atanh(0.9), about 9 %.
    for x_m in [0.945, 1.075] {
        let map = map_of_wall_at(x_m, 0.9, &config);
        assert_eq!(map.state_at(TRUE_M + 0.015, 0.0), CellState::Occupied, "{x_m}");
        assert_ne!(map.state_at(x_m + 0.005, 0.0), CellState::Occupied, "{x_m}");
    }
    let map = map_of_wall_at(0.885, 0.9, &config);
    assert_eq!(map.state_at(0.89, 0.0), CellState::Occupied);
}

#[test]
fn a_confident_obstacle_before_the_surface_stays_where_the_camera_shows_it() {
    // As the edge of a table top that is wider than its foot.
    let map = map_of_wall_at(0.945, 0.99, &MapConfig::default());
    assert_eq!(map.state_at(0.95, 0.0), CellState::Occupied);
}

#[test]
fn no_certainty_and_a_map_without_lidar_leave_obstacles_where_the_camera_shows_them() {
    for config in [
        MapConfig { apart_certainty: 0.0, ..MapConfig::default() },
        MapConfig { lidar: LidarUse::Off, ..MapConfig::default() },
    ] {
        let map = map_of_wall_at(0.945, 0.9, &config);
        assert_eq!(map.state_at(0.95, 0.0), CellState::Occupied);
        assert_eq!(map.state_at(TRUE_M + 0.015, 0.0), CellState::Unknown);
    }
}

#[test]
fn the_camera_sees_no_low_obstacle_through_one_that_the_map_holds_at_the_surface() {
    let table = [[1.515, -0.5, 0.30], [1.7, 0.5, 0.45]];
    let low_box = [[TRUE_M, -0.5, 0.0], [1.1, 0.5, 0.30]];
    let cupboard = [[TRUE_M, -0.5, 0.0], [1.1, 0.5, 1.20]];
    assert_eq!(state_of_table_behind(low_box, table), CellState::Occupied);
    assert_eq!(state_of_table_behind(cupboard, table), CellState::Unknown);
}

/// The state of a table's edge after the map has seen what is before it, and then depth that shows the table alone.
fn state_of_table_behind(before: Solid, table: Solid) -> CellState {
    let config = MapConfig::default();
    let surfaces = surfaces_of(&whole_scan());
    let mut map = map_of(&[before], &surfaces, &config);
    let t_odom_camera = mount(&Pose2::IDENTITY, 0.0);
    let depth = exact_depth(&[table], &camera(), &t_odom_camera);
    integrate(&mut map, &depth, &surfaces, 1);
    map.state_at(1.515, 0.0)
}

#[test]
fn a_slanting_wall_hides_what_is_behind_it_as_one_across_the_view_does() {
    // A wall 1 m away that turns 60 degrees from across the view: its ranges differ by 35 cm on the width of a surface.
    let slant_rad = 60.0_f64.to_radians();
    let scan = scan_of(ScanGeometry::UTM_30LX, |_, angle_rad, _| {
        let towards = (angle_rad - slant_rad).cos();
        if towards > 0.2 { Range::Hit((0.5 / towards) as f32) } else { Range::NoReturn }
    });
    let surface = surfaces_of(&scan).toward([1.2, 0.0]).unwrap();
    assert!((surface.point_m[0] - 1.0).abs() < 0.01, "{surface:?}");
    assert!((surface.behind_m - 0.2).abs() < 0.01, "{surface:?}");
}

#[test]
fn a_scan_hides_until_the_robot_has_driven_on_or_the_map_is_corrected() {
    assert!(hides_after(0.09, Pose2::IDENTITY));
    assert!(!hides_after(0.11, Pose2::IDENTITY));
    assert!(!hides_after(f64::NAN, Pose2::IDENTITY));
    assert!(!hides_after(0.0, Pose2 { yaw_rad: 0.01, ..Pose2::IDENTITY }));
}

fn hides_after(x_m: f64, correction: Pose2) -> bool {
    let mut surfaces = surfaces_of(&whole_scan());
    surfaces.follow(&Pose2 { x_m, ..Pose2::IDENTITY }, &correction);
    surfaces.toward([1.5, 0.0]).is_some()
}
