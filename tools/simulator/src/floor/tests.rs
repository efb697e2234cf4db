use super::*;
use crate::scene::{Triangle, Vertex};

/// Two triangles.
fn quad(corners: [[f32; 3]; 4]) -> [Triangle; 2] {
    let triangle = |which: [usize; 3]| Triangle {
        vertices: which.map(|c| Vertex { position_m: corners[c], ..Vertex::default() }),
        material: 0,
    };
    [triangle([0, 1, 2]), triangle([0, 2, 3])]
}

fn level(x: [f32; 2], y: [f32; 2], z: f32) -> [Triangle; 2] {
    quad([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]])
}

fn wall(from: [f32; 2], to: [f32; 2], z: [f32; 2]) -> [Triangle; 2] {
    quad([[from[0], from[1], z[0]], [to[0], to[1], z[0]], [to[0], to[1], z[1]], [from[0], from[1], z[1]]])
}

/// A room without ceiling, its floor at `z`.
fn room(x: [f32; 2], y: [f32; 2], z: f32) -> Vec<Triangle> {
    let heights = [z, z + 2.5];
    let mut triangles = level(x, y, z).to_vec();
    triangles.extend(wall([x[0], y[0]], [x[1], y[0]], heights));
    triangles.extend(wall([x[1], y[0]], [x[1], y[1]], heights));
    triangles.extend(wall([x[1], y[1]], [x[0], y[1]], heights));
    triangles.extend(wall([x[0], y[1]], [x[0], y[0]], heights));
    triangles
}

fn scene(triangles: Vec<Triangle>) -> Scene {
    Scene { triangles, ..Scene::default() }
}

const RADIUS_M: f64 = 0.16;

#[test]
fn the_floor_of_a_room_is_found_at_its_height() {
    let height = find_level(&scene(room([0.0, 5.0], [0.0, 4.0], -1.25)), RADIUS_M).unwrap();
    assert!((height + 1.25).abs() < 1e-3, "{height}");
}

#[test]
fn a_table_top_a_roof_and_the_ground_around_the_house_are_not_the_floor() {
    let mut triangles = room([0.0, 5.0], [0.0, 4.0], 0.0);
    triangles.extend(level([1.0, 3.0], [1.0, 2.0], 0.75));
    triangles.extend(level([0.0, 5.0], [0.0, 4.0], 2.5));
    triangles.extend(level([-20.0, 25.0], [-20.0, 24.0], -0.4));
    let height = find_level(&scene(triangles), RADIUS_M).unwrap();
    assert!(height.abs() < 1e-3, "{height}");
}

#[test]
fn of_two_storeys_of_one_size_the_lower_is_taken_and_a_much_larger_one_wins() {
    let mut equal = room([0.0, 5.0], [0.0, 4.0], 0.0);
    equal.extend(room([0.0, 5.0], [0.0, 4.0], 3.0));
    assert!(find_level(&scene(equal), RADIUS_M).unwrap().abs() < 1e-3);
    let mut cellar = room([0.0, 1.5], [0.0, 1.5], -3.0);
    cellar.extend(room([0.0, 5.0], [0.0, 4.0], 0.0));
    assert!(find_level(&scene(cellar), RADIUS_M).unwrap().abs() < 1e-3);
}

#[test]
fn a_stray_vertex_a_kilometre_away_changes_nothing() {
    let mut triangles = room([0.0, 5.0], [0.0, 4.0], 0.0);
    for _ in 0..50 {
        triangles.extend(room([0.0, 5.0], [0.0, 4.0], 0.0));
    }
    let far = [[1000.0, 0.0, 0.0], [1000.1, 0.0, 0.0], [1000.0, 0.1, 40.0]];
    triangles.push(Triangle { vertices: far.map(|p| Vertex { position_m: p, ..Vertex::default() }), material: 0 });
    let plan = FloorPlan::new(&scene(triangles), RADIUS_M).unwrap();
    assert!(plan.width() < 200, "{} columns", plan.width());
}

#[test]
fn walls_without_a_floor_have_none() {
    let walls = wall([0.0, 0.0], [5.0, 0.0], [0.0, 2.5]).to_vec();
    assert_eq!(find_level(&scene(walls), RADIUS_M), None);
}

#[test]
fn clearance_is_the_distance_to_the_nearest_wall_within_a_cell() {
    let plan = FloorPlan::new(&scene(room([0.0, 5.0], [0.0, 4.0], 0.0)), RADIUS_M).unwrap();
    for (x, y, expected) in [(2.5, 2.0, 2.0), (1.0, 2.0, 1.0), (0.5, 3.0, 0.5), (4.7, 2.0, 0.3)] {
        let clearance = plan.clearance_m(x, y);
        assert!(clearance <= expected + 1e-6 && clearance > expected - 0.09, "{x} {y}: {clearance}");
    }
    assert_eq!(plan.clearance_m(-3.0, 1.0), 0.0);
    assert_eq!(plan.clearance_m(f64::NAN, 1.0), 0.0);
}

#[test]
fn a_hole_in_the_floor_is_not_driven_into_and_a_seam_is_driven_over() {
    let mut triangles = room([0.0, 5.0], [0.0, 4.0], 0.0);
    triangles.drain(0..2);
    triangles.extend(level([0.0, 2.49], [0.0, 4.0], 0.0));
    triangles.extend(level([2.51, 5.0], [0.0, 1.5], 0.0));
    triangles.extend(level([2.51, 5.0], [2.5, 4.0], 0.0));
    let plan = FloorPlan::new(&scene(triangles), RADIUS_M).unwrap();
    assert!(!plan.is_free(3.5, 2.0), "the hole");
    assert!(plan.is_free(2.5, 0.75), "the seam");
}

#[test]
fn the_space_under_a_table_is_closed_and_that_under_a_lamp_is_open() {
    let mut triangles = room([0.0, 5.0], [0.0, 4.0], 0.0);
    triangles.extend(level([1.0, 2.0], [1.0, 2.0], 0.75));
    triangles.extend(level([3.0, 4.0], [2.0, 3.0], 2.0));
    let plan = FloorPlan::new(&scene(triangles), RADIUS_M).unwrap();
    assert!(!plan.is_free(1.5, 1.5));
    assert!(plan.is_free(3.5, 2.5));
}

#[test]
fn starts_are_free_differ_by_seed_and_look_along_the_room() {
    let plan = FloorPlan::new(&scene(room([0.0, 8.0], [0.0, 2.0], 0.0)), RADIUS_M).unwrap();
    let starts: Vec<Pose2> = (0..10).map(|seed| plan.start_pose(seed).unwrap()).collect();
    for start in &starts {
        assert!(plan.is_free(start.x_m, start.y_m));
        assert!(start.yaw_rad.sin().abs() < 0.6, "{start:?}");
    }
    assert_eq!(plan.start_pose(3), plan.start_pose(3));
    assert!(starts.iter().any(|start| start.distance_m(&starts[0]) > 0.5));
}

#[test]
fn a_room_behind_a_closed_door_is_not_reachable() {
    let mut triangles = room([0.0, 6.0], [0.0, 4.0], 0.0);
    triangles.extend(wall([4.0, 0.0], [4.0, 4.0], [0.0, 2.5]));
    let plan = FloorPlan::new(&scene(triangles), RADIUS_M).unwrap();
    let area = |x: f64, y: f64| {
        let cells = plan.reachable_floor(&Pose2::new(x, y, 0.0)).into_iter().filter(|cell| *cell).count();
        cells as f64 * plan.resolution_m().powi(2)
    };
    assert!((area(1.0, 1.0) - 16.0).abs() < 1.5, "{}", area(1.0, 1.0));
    assert!((area(5.0, 1.0) - 8.0).abs() < 1.2, "{}", area(5.0, 1.0));
    assert_eq!(plan.nearest_free(5.5, 2.0)[0].floor(), 3.0, "the nearest place in the larger room");
}
