//! Tests of drops, on a floor with a shaft. The exact depth is computed by intersecting rays.

use hal::{LaserScan, Pose2, Pose3, Range, ScanGeometry};
use proptest::prelude::*;

use super::tests::{camera, mount};
use super::*;
use crate::perception::DepthEstimate;
use crate::planning::{Costmap, PlanConfig, Planner};

/// A window that reaches beyond the stairs.
fn wide() -> MapConfig {
    MapConfig { side_cells: 400, recenter_cells: 20, drop_range_m: 4.0, ..MapConfig::default() }
}

/// A shaft with vertical walls in an infinite floor, metres.
struct Shaft {
    x_m: [f64; 2],
    y_m: [f64; 2],
    depth_m: f64,
}

/// Stairs down that begin 3 m ahead of the origin.
const STAIRS: Shaft = Shaft { x_m: [3.0, 5.4], y_m: [-0.6, 0.6], depth_m: 2.6 };

impl Shaft {
    fn holds(&self, x_m: f64, y_m: f64) -> bool {
        (self.x_m[0]..self.x_m[1]).contains(&x_m) && (self.y_m[0]..self.y_m[1]).contains(&y_m)
    }

    /// How far a ray that enters the shaft at `at` continues inside, in lengths of its direction.
    fn inside(&self, at: [f64; 2], direction: [f64; 3]) -> f64 {
        let sides = [self.x_m, self.y_m];
        let to_walls = [0, 1].map(|axis| {
            let end = sides[axis][usize::from(direction[axis] > 0.0)];
            (end - at[axis]) / direction[axis]
        });
        let to_ground = self.depth_m / -direction[2];
        to_walls.into_iter().filter(|length| *length >= 0.0).fold(to_ground, f64::min)
    }
}

/// Exact depth of a floor with or without a shaft, with full confidence; nothing else is there.
fn depth_of(shaft: Option<&Shaft>, t_odom_camera: &Pose3) -> DepthEstimate {
    let camera = camera();
    let origin = t_odom_camera.translation.vector;
    let mut estimate = DepthEstimate::none(camera.width, camera.height);
    for v in 0..camera.height {
        for u in 0..camera.width {
            let direction = t_odom_camera.rotation * camera.ray(u as f64, v as f64);
            if direction.z >= 0.0 {
                continue;
            }
            let to_floor = -origin.z / direction.z;
            let at = [origin.x + to_floor * direction.x, origin.y + to_floor * direction.y];
            let inside = shaft
                .filter(|shaft| shaft.holds(at[0], at[1]))
                .map_or(0.0, |shaft| shaft.inside(at, [direction.x, direction.y, direction.z]));
            estimate.depth.values_mut()[v * camera.width + u] = (to_floor + inside) as f32;
            estimate.confidence[v * camera.width + u] = 1.0;
        }
    }
    estimate
}

fn observe(grid: &mut OccupancyGrid, shaft: Option<&Shaft>, robot: &Pose2) {
    let camera_pose = mount(robot, 0.0);
    observe_depth(grid, &depth_of(shaft, &camera_pose), robot, &camera_pose);
}

fn observe_depth(
    grid: &mut OccupancyGrid,
    depth: &DepthEstimate,
    robot: &Pose2,
    t_odom_camera: &Pose3,
) {
    grid.begin_update(robot).unwrap();
    grid.integrate_depth(depth, &camera(), t_odom_camera, &Surfaces::default()).unwrap();
    grid.finish_update();
}

/// A map after a robot has driven 0.6 m towards a shaft.
fn map_of(shaft: &Shaft) -> OccupancyGrid {
    let mut grid = OccupancyGrid::new(&wide()).unwrap();
    for step in 0..20 {
        observe(&mut grid, Some(shaft), &Pose2::new(f64::from(step) * 0.03 - 0.3, 0.0, 0.0));
    }
    grid
}

fn map_of_stairs() -> OccupancyGrid {
    map_of(&STAIRS)
}

fn occupied(grid: &OccupancyGrid) -> Vec<[f64; 2]> {
    grid.known_cells()
        .filter(|(_, log_odds)| *log_odds > 0.0)
        .map(|(cell, _)| grid.center_m(cell))
        .collect()
}

#[test]
fn stairs_down_are_occupied_from_their_edge_on_and_the_floor_around_them_is_not() {
    let grid = map_of_stairs();
    let drops = occupied(&grid);
    assert!(drops.len() > 100, "{}", drops.len());
    for [x_m, y_m] in &drops {
        let beyond = x_m - STAIRS.x_m[0] > -0.03 && y_m.abs() < STAIRS.y_m[1] + 0.03;
        assert!(beyond, "floor at {x_m} {y_m} is a drop");
    }
    // A robot of 0.16 m radius finds no path between the marks along the edge.
    for step in -10..=10 {
        let y_m = f64::from(step) * 0.05;
        let near = drops.iter().any(|drop| (drop[0] - 3.05).hypot(drop[1] - y_m) < 0.15);
        assert!(near, "no mark at the edge beside y = {y_m}");
    }
}

#[test]
fn however_doubtful_obstacles_may_be_no_path_leads_over_stairs() {
    let grid = map_of_stairs();
    let mut costmap = Costmap::new(&PlanConfig::default()).unwrap();
    costmap.update_with_doubt(&grid, 1000.0);
    let edge = occupied(&grid);
    assert!(!edge.is_empty());
    for [x_m, y_m] in edge {
        assert_eq!(costmap.weight(grid.cell_at(x_m, y_m)), None, "({x_m}, {y_m})");
    }
}

/// Distance to the nearest of some places, metres.
fn to_nearest_m(places: &[[f64; 2]], [x_m, y_m]: [f64; 2]) -> f64 {
    places.iter().map(|at| (at[0] - x_m).hypot(at[1] - y_m)).fold(f64::INFINITY, f64::min)
}

/// The drops in the middle of 5 x 5 drops.
fn middles(grid: &OccupancyGrid) -> Vec<[f64; 2]> {
    let is_drop = |cell: Cell| grid.log_odds(cell) > 0.0;
    let mut drops: Vec<Cell> = grid.known_cells().map(|(cell, _)| cell).collect();
    drops.retain(|cell| (-2..=2).all(|dy| (-2..=2).all(|dx| is_drop(cell.offset(dx, dy)))));
    drops.into_iter().map(|cell| grid.center_m(cell)).collect()
}

#[test]
fn the_planner_keeps_its_margin_from_stairs_in_addition_to_that_from_obstacles() {
    let grid = map_of_stairs();
    let drops = occupied(&grid);
    let stairs = middles(&grid);
    assert!(!stairs.is_empty());
    for drop_margin_m in [0.0, 0.2, 0.3] {
        let config = PlanConfig { drop_margin_m, ..PlanConfig::default() };
        let obstacle_m = config.footprint_radius_m + config.margin_m;
        let stairs_m = obstacle_m + drop_margin_m + 2.0 * grid.cell_m();
        let mut costmap = Costmap::new(&config).unwrap();
        for doubtful_log_odds in [0.0, 1000.0] {
            costmap.update_with_doubt(&grid, doubtful_log_odds);
            let free = grid.known_cells().filter(|(_, log_odds)| *log_odds < 0.0);
            for (cell, _) in free {
                let at = grid.center_m(cell);
                let spare_m = (to_nearest_m(&drops, at) - obstacle_m)
                    .min(to_nearest_m(&stairs, at) - stairs_m);
                if spare_m.abs() > grid.cell_m() {
                    assert_eq!(costmap.is_passable(cell), spare_m > 0.0, "{spare_m} m to spare");
                }
            }
        }
    }
}

#[test]
fn drops_that_are_too_narrow_for_stairs_are_like_other_obstacles_to_the_planner() {
    let grid = map_of(&Shaft { y_m: [-0.06, 0.06], ..STAIRS });
    let drops = occupied(&grid);
    assert!(!drops.is_empty() && middles(&grid).is_empty());
    let config = PlanConfig::default();
    let obstacle_m = config.footprint_radius_m + config.margin_m;
    let mut costmap = Costmap::new(&config).unwrap();
    costmap.update(&grid);
    let free = grid.known_cells().filter(|(_, log_odds)| *log_odds < 0.0);
    let centers = free.map(|(cell, _)| (cell, to_nearest_m(&drops, grid.center_m(cell))));
    for (cell, away_m) in centers.filter(|(_, away_m)| *away_m > obstacle_m + grid.cell_m()) {
        assert!(costmap.is_passable(cell), "{away_m} m away");
    }
}

#[test]
fn a_robot_that_notices_stairs_beside_it_drives_away_from_them_first() {
    let grid = map_of_stairs();
    let drops = occupied(&grid);
    let mut costmap = Costmap::new(&PlanConfig::default()).unwrap();
    costmap.update(&grid);
    let mut planner = Planner::new(1_000_000);
    for start_m in [[2.7, 0.0], [2.9, 0.3], [2.95, -0.5], [2.97, 0.0]] {
        let start = grid.cell_at(start_m[0], start_m[1]);
        assert!(!costmap.is_passable(start));
        let path = planner.plan(&costmap, start, grid.cell_at(1.0, 0.0)).unwrap();
        let away_m: Vec<f64> =
            path.iter().map(|cell| to_nearest_m(&drops, grid.center_m(*cell))).collect();
        for pair in away_m.windows(2).take_while(|pair| pair[0] < 0.46) {
            assert!(pair[1] > pair[0] - 1.5 * grid.cell_m(), "{away_m:?} from {start_m:?}");
        }
        assert!(away_m.iter().all(|away_m| *away_m > 0.0), "{away_m:?} from {start_m:?}");
    }
}

#[test]
fn rays_and_scans_that_pass_above_stairs_leave_them_occupied() {
    let mut grid = map_of_stairs();
    let before = occupied(&grid);
    let geometry = ScanGeometry::UTM_30LX;
    let ranges = vec![Range::Hit(6.0); geometry.beams];
    let scan = LaserScan { time_ns: 0, geometry, ranges };
    // From 1.3 m before the edge the camera sees the floor beyond it only.
    let robot = Pose2::new(1.7, 0.0, 0.0);
    let camera_pose = mount(&robot, 0.0);
    let depth = depth_of(Some(&STAIRS), &camera_pose);
    for _ in 0..50 {
        grid.begin_update(&robot).unwrap();
        grid.integrate_scan(&scan, &Sweep::at_rest(robot)).unwrap();
        grid.integrate_depth(&depth, &camera(), &camera_pose, &Surfaces::default()).unwrap();
        grid.finish_update();
    }
    for [x_m, y_m] in before {
        assert_eq!(grid.state_at(x_m, y_m), CellState::Occupied, "{x_m} {y_m}");
    }
}

#[test]
fn stairs_are_occupied_although_scans_had_cleared_the_space_above_them() {
    let mut grid = OccupancyGrid::new(&wide()).unwrap();
    let geometry = ScanGeometry::UTM_30LX;
    let scan = LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(6.0); geometry.beams] };
    for _ in 0..100 {
        grid.begin_update(&Pose2::new(1.8, 0.0, 0.0)).unwrap();
        grid.integrate_scan(&scan, &Sweep::at_rest(Pose2::new(1.8, 0.0, 0.0))).unwrap();
        grid.finish_update();
    }
    assert_eq!(grid.state_at(3.2, 0.0), CellState::Free);
    for _ in 0..3 {
        observe(&mut grid, Some(&STAIRS), &Pose2::IDENTITY);
    }
    assert!(occupied(&grid).iter().any(|drop| drop[0] < 3.1));
}

#[test]
fn floor_that_is_seen_where_a_drop_was_clears_it() {
    let mut grid = map_of_stairs();
    for step in 0..20 {
        observe(&mut grid, None, &Pose2::new(f64::from(step) * 0.03 - 0.3, 0.0, 0.0));
    }
    assert_eq!(occupied(&grid), Vec::<[f64; 2]>::new());
}

#[test]
fn a_depth_marks_a_drop_only_as_far_as_its_confidence_allows() {
    assert_eq!(drops(1.2, 0.8), 0, "a quarter is the error of 80 % of the depths");
    assert_eq!(drops(1.6, 0.8), 0);
    assert!(drops(1.8, 0.8) > 100);
    assert_eq!(drops(1.3, 0.95), 0);
    assert!(drops(1.5, 0.95) > 100);
    assert!(drops(1.2, 1.0) > 100, "exact depth has no error");
    assert_eq!(drops(1.02, 1.0), 0, "2 cm lower is still the floor");
    assert_eq!(drops(1.6, f32::NAN), 0);
}

/// The cells of drops where every depth on the right half of the image is too large by one factor.
fn drops(factor: f32, confidence: f32) -> usize {
    let camera_pose = mount(&Pose2::IDENTITY, 0.0);
    let mut depth = depth_of(None, &camera_pose);
    for row in depth.depth.values_mut().chunks_exact_mut(640) {
        row[320..].iter_mut().for_each(|depth_m| *depth_m *= factor);
    }
    depth.confidence.fill(confidence);
    let config = wide();
    let mut grid = OccupancyGrid::new(&config).unwrap();
    observe_depth(&mut grid, &depth, &Pose2::IDENTITY, &camera_pose);
    occupied(&grid).len()
}

#[test]
fn depth_that_is_wrong_as_a_whole_is_no_drop() {
    let camera_pose = mount(&Pose2::IDENTITY, 0.0);
    let mut depth = depth_of(None, &camera_pose);
    depth.depth.values_mut().iter_mut().for_each(|depth_m| *depth_m *= 4.0);
    let mut grid = OccupancyGrid::new(&wide()).unwrap();
    observe_depth(&mut grid, &depth, &Pose2::IDENTITY, &camera_pose);
    assert!(occupied(&grid).is_empty());
}

#[test]
fn a_drop_ends_the_free_floor_of_a_camera_that_looks_down() {
    let shaft = Shaft { x_m: [1.5, 2.7], y_m: [-2.0, 2.0], depth_m: 2.6 };
    let pose = mount(&Pose2::IDENTITY, 0.5);
    let mut frame = SingleFrameMap::default();
    let mut mapper = FrameMapper::new(&wide()).unwrap();
    mapper.map(&depth_of(Some(&shaft), &pose), &camera(), &pose, &mut frame).unwrap();
    assert_eq!(frame.state(Cell::new(44, 0)), CellState::Free, "1.3 m ahead");
    for x in 51..66 {
        assert_ne!(frame.state(Cell::new(x, 0)), CellState::Free, "column {x} is in the shaft");
    }
}

#[test]
fn floor_whose_depth_is_too_small_is_an_obstacle_only_if_its_confidence_excludes_the_floor() {
    assert_eq!(marked_floor(0.85, 0.9), 0, "12 cm above the floor, and the error is 25 %");
    assert!(marked_floor(0.85, 0.999) > 100);
    assert!(marked_floor(0.6, 0.9) > 100, "32 cm above the floor");
    assert_eq!(marked_floor(0.95, 1.0), 0, "4 cm above the floor");
}

/// Occupied cells after a camera that looks down has seen an empty floor whose depths are too small by a factor.
fn marked_floor(factor: f32, confidence: f32) -> usize {
    let pose = mount(&Pose2::IDENTITY, 0.5);
    let mut depth = depth_of(None, &pose);
    depth.depth.values_mut().iter_mut().for_each(|depth_m| *depth_m *= factor);
    depth.confidence.fill(confidence);
    let mut grid = OccupancyGrid::new(&wide()).unwrap();
    observe_depth(&mut grid, &depth, &Pose2::IDENTITY, &pose);
    occupied(&grid).len()
}

#[test]
fn floor_that_should_be_seen_and_has_no_depth_is_unknown() {
    let pose = mount(&Pose2::IDENTITY, 0.5);
    let mut depth = depth_of(None, &pose);
    // No depth from 1.0 to 1.4 m ahead: a black hole, or a floor that mirrors.
    for v in 0..192 {
        let range_m = 0.8 / (0.5 + ((v as f64 - camera().cy) / camera().fy).atan()).tan();
        if (1.0..1.4).contains(&range_m) {
            depth.confidence[v * 640..(v + 1) * 640].fill(0.0);
        }
    }
    let mut frame = SingleFrameMap::default();
    let mut mapper = FrameMapper::new(&wide()).unwrap();
    mapper.map(&depth, &camera(), &pose, &mut frame).unwrap();
    assert_eq!(frame.state(Cell::new(30, 0)), CellState::Free, "0.9 m ahead");
    for x in 35..66 {
        assert_eq!(frame.state(Cell::new(x, 0)), CellState::Unknown, "column {x}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_floor_as_uneven_as_the_standard_allows_has_no_drop(
        pitch_down_rad in 0.0..0.6f64, believed_rad in -0.004..0.004f64, yaw_rad in -3.2..3.2f64,
    ) {
        let robot = Pose2::new(0.1, -0.2, yaw_rad);
        let depth = depth_of(None, &mount(&robot, pitch_down_rad));
        let mut grid = OccupancyGrid::new(&wide()).unwrap();
        observe_depth(&mut grid, &depth, &robot, &mount(&robot, pitch_down_rad + believed_rad));
        prop_assert!(occupied(&grid).is_empty());
    }
}
