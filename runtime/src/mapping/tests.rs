//! Tests of the map in a synthetic home. The exact depth is computed by intersecting rays with
//! boxes.

use hal::{CameraModel, DepthMap, Pose2, Pose3, camera_mount};
use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::perception::DepthEstimate;

/// An axis-aligned box as its minimum and maximum corner, metres.
pub(super) type Solid = [[f64; 3]; 2];

pub(super) fn camera() -> CameraModel {
    CameraModel::pinhole(640, 192, core::f64::consts::FRAC_PI_2)
}

fn small() -> MapConfig {
    MapConfig { side_cells: 200, recenter_cells: 20, ..MapConfig::default() }
}

pub(super) fn mount(pose: &Pose2, pitch_down_rad: f64) -> Pose3 {
    pose.to_pose3() * camera_mount(0.0, 0.8, pitch_down_rad)
}

/// Four walls around a floor of `size_m` centred on the origin, from the floor to 2.5 m.
pub(super) fn room(size_m: [f64; 2]) -> Vec<Solid> {
    let [x, y] = size_m.map(|size| size / 2.0);
    let t = 0.2;
    vec![
        [[x, -y - t, 0.0], [x + t, y + t, 2.5]],
        [[-x - t, -y - t, 0.0], [-x, y + t, 2.5]],
        [[-x, y, 0.0], [x, y + t, 2.5]],
        [[-x, -y - t, 0.0], [x, -y, 2.5]],
    ]
}

/// Where a ray enters a box, in multiples of the direction's length; infinite if it misses the box.
fn enter(solid: &Solid, origin: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
    let mut near = 0.0f64;
    let mut far = f64::INFINITY;
    for axis in 0..3 {
        let crossings =
            [0, 1].map(|end: usize| (solid[end][axis] - origin[axis]) / direction[axis]);
        near = near.max(crossings[0].min(crossings[1]));
        far = far.min(crossings[0].max(crossings[1]));
    }
    if near <= far { near } else { f64::INFINITY }
}

/// The exact depth of solids on an infinite floor, with full confidence.
pub(super) fn exact_depth(
    solids: &[Solid],
    camera: &CameraModel,
    t_odom_camera: &Pose3,
) -> DepthEstimate {
    let origin = t_odom_camera.translation.vector;
    let mut estimate = DepthEstimate::none(camera.width, camera.height);
    for v in 0..camera.height {
        for u in 0..camera.width {
            let direction = t_odom_camera.rotation * camera.ray(u as f64, v as f64);
            let floor = if direction.z < 0.0 { -origin.z / direction.z } else { f64::INFINITY };
            let depth =
                solids.iter().map(|solid| enter(solid, &origin, &direction)).fold(floor, f64::min);
            if depth.is_finite() {
                estimate.depth.values_mut()[v * camera.width + u] = depth as f32;
                estimate.confidence[v * camera.width + u] = 1.0;
            }
        }
    }
    estimate
}

fn map(config: &MapConfig, estimate: &DepthEstimate, t_odom_camera: &Pose3) -> SingleFrameMap {
    let mut frame = SingleFrameMap::default();
    FrameMapper::new(config).unwrap().map(estimate, &camera(), t_odom_camera, &mut frame).unwrap();
    frame
}

fn cells_of(frame: &SingleFrameMap, state: CellState) -> Vec<Cell> {
    frame.cells.iter().filter(|known| known.state() == state).map(|known| known.cell).collect()
}

#[test]
fn a_wall_at_a_known_depth_marks_exactly_its_cells() {
    // A wall whose face lies in the middle of column 50, across the whole view.
    let wall = [[1.515, -5.0, 0.0], [1.7, 5.0, 2.5]];
    let pose = mount(&Pose2::new(0.0, 0.015, 0.0), 0.0);
    let frame = map(&small(), &exact_depth(&[wall], &camera(), &pose), &pose);
    // In range where 1.515^2 + dy^2 <= 2^2: dy up to 1.305 m.
    let expected: Vec<Cell> = (-43..=43).map(|y| Cell::new(50, y)).collect();
    assert_eq!(cells_of(&frame, CellState::Occupied), expected);
    assert!(
        frame.cells.iter().all(|known| known.cell.x <= 50),
        "no cell behind the wall may be known"
    );
    let occupied = frame.cells.iter().find(|known| known.cell == Cell::new(50, 0)).unwrap();
    assert_eq!(occupied.evidence, 2.0);
    assert!(
        (occupied.height_m - 1.25).abs() < 0.02,
        "the highest point of it in the image: {}",
        occupied.height_m
    );
}

#[test]
fn the_floor_in_front_of_a_wall_is_free_up_to_the_clear_margin() {
    let wall = [[1.515, -5.0, 0.0], [1.7, 5.0, 2.5]];
    let pose = mount(&Pose2::new(0.0, 0.015, 0.0), 0.0);
    let frame = map(&small(), &exact_depth(&[wall], &camera(), &pose), &pose);
    let ahead: Vec<CellState> = (1..=50).map(|x| frame.state(Cell::new(x, 0))).collect();
    // The margin is 5 % of 1.515 m, and less than two cells for rounding.
    assert!(ahead[..45].iter().all(|state| *state == CellState::Free), "{ahead:?}");
    assert_eq!(frame.state(Cell::new(-1, 0)), CellState::Unknown, "behind the camera");
    assert_eq!(frame.state(Cell::new(10, 12)), CellState::Unknown, "outside the view");
    assert_eq!(frame.state(Cell::new(10, 8)), CellState::Free);
}

#[test]
fn a_wall_beyond_the_range_limits_clears_the_whole_clear_range_and_marks_nothing() {
    let wall = [[4.0, -9.0, 0.0], [4.2, 9.0, 2.5]];
    let pose = mount(&Pose2::IDENTITY, 0.0);
    let frame = map(&small(), &exact_depth(&[wall], &camera(), &pose), &pose);
    assert!(cells_of(&frame, CellState::Occupied).is_empty());
    for cell in [Cell::new(65, 0), Cell::new(46, 45), Cell::new(46, -46)] {
        assert_eq!(frame.state(cell), CellState::Free, "{cell:?}");
    }
    assert_eq!(frame.state(Cell::new(67, 0)), CellState::Unknown);
}

#[test]
fn nothing_is_known_behind_a_box() {
    let solids = [[[1.0, -0.2, 0.0], [1.2, 0.2, 1.2]], [[1.8, -5.0, 0.0], [2.0, 5.0, 2.5]]];
    let pose = mount(&Pose2::IDENTITY, 0.0);
    let frame = map(&small(), &exact_depth(&solids, &camera(), &pose), &pose);
    assert_eq!(frame.state(Cell::new(33, 0)), CellState::Occupied);
    for x in 41..59 {
        assert_eq!(frame.state(Cell::new(x, 0)), CellState::Unknown, "column {x} behind the box");
    }
    assert_eq!(frame.state(Cell::new(45, 20)), CellState::Free, "beside the box");
}

#[test]
fn a_few_wrong_pixels_neither_mark_cells_nor_hide_free_floor() {
    let wall = [[1.815, -5.0, 0.0], [2.0, 5.0, 2.5]];
    let pose = mount(&Pose2::IDENTITY, 0.0);
    let clean = exact_depth(&[wall], &camera(), &pose);
    let mut noisy = clean.clone();
    // Two used pixels in one cell are one fewer than `min_points`.
    for v in [81, 83] {
        noisy.depth.values_mut()[v * 640 + 322] = 0.615;
    }
    assert_eq!(map(&small(), &noisy, &pose), map(&small(), &clean, &pose));
    noisy.depth.values_mut()[85 * 640 + 322] = 0.615;
    assert_eq!(map(&small(), &noisy, &pose).state(Cell::new(20, -1)), CellState::Occupied);
}

#[test]
fn bearings_without_depth_or_confidence_are_unknown() {
    let wall = [[1.515, -5.0, 0.0], [1.7, 5.0, 2.5]];
    let pose = mount(&Pose2::IDENTITY, 0.0);
    let mut estimate = exact_depth(&[wall], &camera(), &pose);
    for v in 0..192 {
        for u in 0..320 {
            estimate.depth.values_mut()[v * 640 + u] = 0.0;
            estimate.confidence[v * 640 + u] = 0.0;
        }
        for u in 480..640 {
            estimate.confidence[v * 640 + u] = 0.4;
        }
    }
    let frame = map(&small(), &estimate, &pose);
    // Left is +y.
    assert!(frame.cells.iter().all(|known| known.cell.y <= 0));
    // Right of 45/2 degrees the confidence is below the threshold.
    assert!(
        frame
            .cells
            .iter()
            .all(|known| f64::from(-known.cell.y) <= f64::from(known.cell.x) * 0.51 + 1.0)
    );
    assert_eq!(frame.state(Cell::new(30, -5)), CellState::Free);
}

#[test]
fn pixels_with_nan_confidence_or_infinite_depth_are_ignored() {
    let pose = mount(&Pose2::IDENTITY, 0.0);
    let mut estimate = DepthEstimate::none(640, 192);
    estimate.depth.values_mut().fill(1.0);
    estimate.confidence.fill(f32::NAN);
    assert!(map(&small(), &estimate, &pose).cells.is_empty());
    estimate.depth.values_mut().fill(f32::INFINITY);
    estimate.confidence.fill(1.0);
    assert!(map(&small(), &estimate, &pose).cells.is_empty());
}

#[test]
fn objects_above_the_height_band_and_the_floor_are_no_obstacles() {
    let shelf = [[1.0, -1.0, 1.45], [1.4, 1.0, 2.0]];
    for pitch_down_rad in [-0.3, 0.0, 0.3, 0.6] {
        let pose = mount(&Pose2::new(0.3, -0.2, 0.4), pitch_down_rad);
        let frame = map(&small(), &exact_depth(&[shelf], &camera(), &pose), &pose);
        assert!(cells_of(&frame, CellState::Occupied).is_empty(), "pitch {pitch_down_rad}");
    }
}

#[test]
fn a_camera_that_is_tilted_down_observes_low_obstacles_and_free_floor() {
    let step = [[1.2, -2.0, 0.0], [3.0, 2.0, 0.1]];
    let pose = mount(&Pose2::IDENTITY, 0.5);
    let frame = map(&small(), &exact_depth(&[step], &camera(), &pose), &pose);
    assert_eq!(frame.state(Cell::new(40, 0)), CellState::Occupied);
    assert_eq!(frame.state(Cell::new(36, 0)), CellState::Free);
}

#[test]
fn wrong_sizes_invalid_poses_and_vertical_cameras_are_refused() {
    let mut mapper = FrameMapper::new(&small()).unwrap();
    let estimate = DepthEstimate::none(640, 192);
    let level = mount(&Pose2::IDENTITY, 0.0);
    let half = DepthEstimate::none(320, 192);
    assert!(matches!(
        refusal(&mut mapper, &half, &camera(), &level),
        MapError::SizeMismatch { depth: (320, 192), .. }
    ));
    let short = DepthEstimate { depth: DepthMap::none(640, 192), confidence: vec![1.0; 7] };
    assert!(matches!(
        refusal(&mut mapper, &short, &camera(), &level),
        MapError::SizeMismatch { confidence: 7, .. }
    ));
    let mut nan = level;
    nan.translation.vector.x = f64::NAN;
    assert!(matches!(
        refusal(&mut mapper, &estimate, &camera(), &nan),
        MapError::PoseNotFinite { pose: "t_odom_camera", .. }
    ));
    nan.translation.vector.x = 1e9;
    assert!(matches!(
        refusal(&mut mapper, &estimate, &camera(), &nan),
        MapError::PoseOutOfReach { .. }
    ));
    let down = mount(&Pose2::IDENTITY, core::f64::consts::FRAC_PI_2);
    assert_eq!(refusal(&mut mapper, &estimate, &camera(), &down), MapError::CameraVertical);
    assert_eq!(
        refusal(&mut mapper, &estimate, &CameraModel { fx: 0.0, ..camera() }, &level),
        MapError::CameraModel
    );
}

fn refusal(
    mapper: &mut FrameMapper,
    estimate: &DepthEstimate,
    camera: &CameraModel,
    pose: &Pose3,
) -> MapError {
    mapper.map(estimate, camera, pose, &mut SingleFrameMap::default()).unwrap_err()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn from_anywhere_in_a_room_walls_are_walls_and_the_inside_is_free(
        x_m in -0.8..0.8f64, y_m in -0.8..0.8f64, yaw_rad in -3.2..3.2f64, pitch_down_rad in -0.1..0.3f64,
    ) {
        let pose = mount(&Pose2::new(x_m, y_m, yaw_rad), pitch_down_rad);
        let frame = map(&small(), &exact_depth(&room([3.0, 2.4]), &camera(), &pose), &pose);
        // From some places only a corner of the room is within the mark range.
        prop_assert!(!cells_of(&frame, CellState::Occupied).is_empty());
        for known in &frame.cells {
            let [cx, cy] = known.cell.center_m(0.03);
            // Signed distance to the walls' faces: negative inside.
            let outside_m = (cx.abs() - 1.5).max(cy.abs() - 1.2);
            match known.state() {
                CellState::Occupied => prop_assert!(outside_m.abs() <= 0.031, "{:?} at {} m", known, outside_m),
                _ => prop_assert!(outside_m <= 0.016, "{:?} at {} m", known, outside_m),
            }
        }
    }
}

fn update(grid: &mut OccupancyGrid, solids: &[Solid], robot: &Pose2) {
    grid.begin_update(robot).unwrap();
    let pose = mount(robot, 0.0);
    grid.integrate_depth(
        &exact_depth(solids, &camera(), &pose),
        &camera(),
        &pose,
        &Surfaces::default(),
    )
    .unwrap();
    grid.finish_update();
}

#[test]
fn a_low_obstacle_that_leaves_the_view_below_stays_in_the_map() {
    // From 1.9 m away the lowest ray is 0.23 m high at the stool; from 0.7 m away it is 0.6 m high.
    let stool = [[1.9, -0.3, 0.0], [2.1, 0.3, 0.45]];
    let wall = [[6.0, -9.0, 0.0], [6.2, 9.0, 2.5]];
    let mut grid = OccupancyGrid::new(&small()).unwrap();
    for _ in 0..5 {
        update(&mut grid, &[stool, wall], &Pose2::IDENTITY);
    }
    assert_eq!(grid.state_at(1.91, 0.0), CellState::Occupied);
    for _ in 0..20 {
        update(&mut grid, &[stool, wall], &Pose2::new(1.2, 0.0, 0.0));
    }
    assert_eq!(
        grid.state_at(1.91, 0.0),
        CellState::Occupied,
        "it stays although rays pass above it"
    );
}

#[test]
fn a_tall_obstacle_that_was_moved_away_is_cleared() {
    let cupboard = [[1.5, -0.3, 0.0], [1.8, 0.3, 1.3]];
    let wall = [[6.0, -9.0, 0.0], [6.2, 9.0, 2.5]];
    let mut grid = OccupancyGrid::new(&small()).unwrap();
    for _ in 0..5 {
        update(&mut grid, &[cupboard, wall], &Pose2::IDENTITY);
    }
    assert_eq!(grid.state_at(1.51, 0.0), CellState::Occupied);
    for _ in 0..8 {
        update(&mut grid, &[wall], &Pose2::IDENTITY);
    }
    assert_eq!(grid.state_at(1.51, 0.0), CellState::Free);
}

#[test]
fn two_frames_of_a_moved_box_are_inconsistent_where_it_was_and_where_it_is() {
    let before = map_with_box_at(-0.5);
    let now = map_with_box_at(0.3);
    assert!(inconsistencies(&now, &now, 0.03).is_empty());
    let found = inconsistencies(&now, &before, 0.03);
    // The two largest groups are the front faces; side faces at a glancing angle add single cells.
    assert!(
        found[0].cells >= found[1].cells
            && found[1].cells >= 10
            && found[2..].iter().all(|rest| rest.cells <= 2)
    );
    let mut sides: Vec<f64> = found[..2].iter().map(|group| group.centroid_m[1]).collect();
    sides.sort_by(f64::total_cmp);
    assert!((sides[0] + 0.35).abs() < 0.05 && (sides[1] - 0.45).abs() < 0.05, "{sides:?}");
}

fn map_with_box_at(y: f64) -> SingleFrameMap {
    let pose = mount(&Pose2::IDENTITY, 0.0);
    let wall = [[4.0, -9.0, 0.0], [4.2, 9.0, 2.5]];
    let solids = [[[1.2, y, 0.0], [1.5, y + 0.3, 1.3]], wall];
    map(&small(), &exact_depth(&solids, &camera(), &pose), &pose)
}
