use std::sync::LazyLock;

use hal::{Pose2, Twist2};
use proptest::prelude::*;

use super::*;
use crate::scene::{Scene, Vertex};

type P = [f32; 3];

fn quad([a, b, c, d]: [P; 4]) -> [Triangle; 2] {
    [[a, b, c], [a, c, d]].map(|t| Triangle { vertices: t.map(vertex), material: 0 })
}

fn vertex(position_m: P) -> Vertex {
    Vertex { position_m, uv: [0.0; 2], ambient: 1.0 }
}

/// A level rectangle.
fn slab([x0, y0]: [f32; 2], [x1, y1]: [f32; 2], z: f32) -> [Triangle; 2] {
    quad([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
}

/// The side walls of a box.
fn walls([x0, y0]: [f32; 2], [x1, y1]: [f32; 2], z0: f32, z1: f32) -> Vec<Triangle> {
    let around = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]];
    around.array_windows().flat_map(|it| wall_side(it, z0, z1)).collect()
}

fn wall_side([a, b]: &[[f32; 2]; 2], z0: f32, z1: f32) -> [Triangle; 2] {
    quad([[a[0], a[1], z0], [b[0], b[1], z0], [b[0], b[1], z1], [a[0], a[1], z1]])
}

/// A closed box: furniture.
fn block(from: [f32; 2], to: [f32; 2], z0: f32, z1: f32) -> Vec<Triangle> {
    [walls(from, to, z0, z1), slab(from, to, z1).into(), slab(from, to, z0).into()].concat()
}

/// Floor and walls of an empty room, 2.5 m high, without a ceiling.
fn room(from: [f32; 2], to: [f32; 2], z: f32) -> Vec<Triangle> {
    [slab(from, to, z).to_vec(), walls(from, to, z, z + 2.5)].concat()
}

fn scene(parts: impl IntoIterator<Item = Vec<Triangle>>) -> Scene {
    Scene { triangles: parts.into_iter().flatten().collect(), ..Scene::default() }
}

fn floor_of(parts: impl IntoIterator<Item = Vec<Triangle>>) -> f64 {
    find_floor(&scene(parts), &Footprint::default()).unwrap()
}

fn plan(parts: impl IntoIterator<Item = Vec<Triangle>>) -> FloorPlan {
    FloorPlan::new(&scene(parts), &Footprint::default()).unwrap()
}

fn near(actual: f64, expected: f64) -> bool {
    (actual - expected).abs() < 1e-3
}

#[test]
fn the_floor_of_an_open_room_and_of_one_with_a_ceiling_is_its_floor() {
    let open = room([0.0; 2], [5.0, 4.0], 7.3);
    let ceiling = slab([0.0; 2], [5.0, 4.0], 9.8).to_vec();
    let furniture = block([0.0, 0.0], [2.0, 2.0], 7.3, 8.0);
    assert!(near(floor_of([open.clone()]), 7.3));
    // The roof has more free space than the furnished floor, but nothing encloses it.
    assert!(near(floor_of([open, ceiling, furniture]), 7.3));
}

#[test]
fn of_two_storeys_the_larger_is_taken_and_of_equal_ones_the_lower() {
    assert!(near(floor_of([ground_floor(), room([0.0; 2], [6.0, 5.0], 2.8)]), 0.0));
    let small_cellar = room([0.0; 2], [3.0, 3.0], -2.6);
    assert!(near(floor_of([small_cellar, ground_floor()]), 0.0));
    let large_cellar = room([0.0; 2], [8.0, 8.0], -2.6);
    assert!(near(floor_of([ground_floor(), large_cellar]), -2.6));
}

fn ground_floor() -> Vec<Triangle> {
    room([0.0; 2], [6.0, 5.0], 0.0)
}

#[test]
fn ground_around_and_below_a_house_is_not_its_floor() {
    let ground = slab([-500.0; 2], [500.0; 2], -0.2).to_vec();
    assert!(near(floor_of(house_with_wall().into_iter().chain([ground])), 0.0));
    // Floor and ground lie in the same plane: the rooms are the home, not the kilometre around
    // them.
    let level = slab([-500.0; 2], [500.0; 2], 0.0).to_vec();
    let plan = plan([level, walls([0.0; 2], [8.0, 6.0], 0.0, 2.5)]);
    assert!(
        plan.is_reachable(4.0, 3.0) && !plan.is_reachable(-3.0, 3.0) && plan.is_free(-3.0, 3.0)
    );
    assert!((plan.reachable_floor_m2() - 48.0).abs() < 1.5, "{}", plan.reachable_floor_m2());
}

fn house_with_wall() -> [Vec<Triangle>; 2] {
    [room([0.0; 2], [8.0, 6.0], 0.0), walls([3.0, 0.0], [3.0, 4.0], 0.0, 2.5)]
}

#[test]
fn a_stray_corner_a_kilometre_away_affects_only_the_cells_under_its_triangle() {
    for far in [[1000.0, -700.0, 40.0], [0.0, 1000.0, 0.0], [5.0, 5.0, -1000.0]] {
        let parts = [room([0.0; 2], [5.0, 4.0], 0.0), stray_triangle(far)];
        assert!(near(floor_of(parts.clone()), 0.0), "{far:?}");
        let plan = plan(parts);
        assert!(plan.grid().cells() < 300 * 300, "{far:?}: {:?}", plan.grid());
        assert!(plan.is_reachable(2.5, 1.0) && plan.reachable_floor_m2() > 17.0);
    }
}

fn stray_triangle(far: P) -> Vec<Triangle> {
    vec![Triangle { vertices: [[1.0, 3.9, 0.0], [1.1, 3.9, 0.0], far].map(vertex), material: 0 }]
}

#[test]
fn triangles_that_face_down_make_the_same_plan() {
    let reversed = room_with_block().map(|part| {
        part.into_iter()
            .map(|t| Triangle { vertices: [t.vertices[0], t.vertices[2], t.vertices[1]], ..t })
            .collect()
    });
    assert!(near(floor_of(reversed.clone()), 0.0));
    let a = plan(room_with_block());
    let b = plan(reversed);
    assert!(a.reachable().eq(b.reachable()) && a.reachable_floor().eq(b.reachable_floor()));
}

fn room_with_block() -> [Vec<Triangle>; 2] {
    [room([0.0; 2], [5.0, 4.0], 0.0), block([1.0, 1.0], [2.0, 2.0], 0.0, 0.7)]
}

#[test]
fn walls_without_a_floor_and_a_shelf_smaller_than_the_robot_are_refused() {
    let error = find_floor(&scene([walls([0.0; 2], [5.0, 4.0], 0.0, 2.5)]), &Footprint::default())
        .unwrap_err();
    assert!(error.contains("no level surface"), "{error}");
    let shelf = slab([0.0; 2], [0.3, 0.3], 0.0).to_vec();
    let error = find_floor(&scene([shelf]), &Footprint::default()).unwrap_err();
    assert!(error.contains("enough free space for a robot"), "{error}");
}

#[test]
fn a_robot_that_drives_over_the_edge_of_a_hole_falls_and_one_on_a_crack_does_not() {
    // A stairwell of 1 m at (2..3, 1..2), and a crack of 4 cm along x = 4.
    let plan = plan([
        strip(0.0, 2.0, 0.0, 3.0),
        strip(3.0, 4.0, 0.0, 3.0),
        strip(2.0, 3.0, 0.0, 1.0),
        strip(2.0, 3.0, 2.0, 3.0),
        strip(4.04, 6.0, 0.0, 3.0),
        walls([0.0; 2], [6.0, 3.0], 0.0, 2.5),
    ]);
    assert!(
        !plan.is_supported(2.5, 1.5) && !plan.is_free(1.92, 1.5) && plan.is_reachable(1.75, 1.5)
    );
    assert!(plan.is_reachable(4.02, 1.5) && plan.is_reachable(5.5, 1.5));
    let into = plan.drive(&Pose2::new(1.0, 1.5, 0.0), &ahead(), 5.0, &Body { sliding: false }, &[]);
    // The front castor is 0.128 m ahead, and the edge of the floor is known to half a cell.
    assert!(into.fell && !into.contact, "{into:?}");
    assert!((into.pose.x_m - 1.872).abs() < 0.06, "{:?}", into.pose);
    let across =
        plan.drive(&Pose2::new(3.5, 2.5, 0.0), &ahead(), 3.0, &Body { sliding: false }, &[]);
    assert!(!across.fell && across.pose.x_m > 4.9, "{across:?}");
    // Edges behind a wall are no drop.
    assert_eq!(plan.drop_distance_m(5.8, 1.5, 0.5), None);
    let beside_m = plan.drop_distance_m(1.7, 1.5, 0.5).unwrap();
    assert!((beside_m - 0.3).abs() < 0.06, "{beside_m}");
}

fn strip(x0: f32, x1: f32, y0: f32, y1: f32) -> Vec<Triangle> {
    slab([x0, y0], [x1, y1], 0.0).to_vec()
}

#[test]
fn an_empty_room_is_reachable_to_its_corners() {
    let plan = plan([room([0.0; 2], [4.0, 3.0], 0.0)]);
    // The whole floor except the four corners that a round base cannot fill, to one cell along the
    // walls.
    let corners = (4.0 - std::f64::consts::PI) * 0.16_f64.powi(2);
    assert!(
        (plan.reachable_floor_m2() - (12.0 - corners)).abs() < 0.05 * 14.0,
        "{}",
        plan.reachable_floor_m2()
    );
    assert!(plan.reachable_floor_m2() < 12.0);
    let free = plan.reachable().count() as f64 * 0.0025;
    assert!((free - 3.68 * 2.68).abs() < 0.05 * 14.0, "{free}");
}

#[test]
fn a_robot_fits_through_a_gap_that_is_wider_than_itself() {
    for (gap, fits) in [(0.30, false), (0.31, false), (0.40, true), (0.37, true)] {
        let low = 1.5 - gap / 2.0;
        let high = 1.5 + gap / 2.0;
        let parts = [
            room([0.0; 2], [5.0, 3.0], 0.0),
            block([2.0, 0.0], [2.5, low], 0.0, 1.0),
            block([2.0, high], [2.5, 3.0], 0.0, 1.0),
        ];
        let plan = plan(parts);
        let through =
            plan.drive(&Pose2::new(1.0, 1.5, 0.0), &ahead(), 2.5, &Body { sliding: false }, &[]);
        assert_eq!(
            (plan.is_reachable(1.0, 1.5) && plan.is_reachable(4.0, 1.5), !through.contact),
            (fits, fits),
            "{gap}"
        );
    }
}

#[test]
fn low_steps_and_high_shelves_do_not_block_the_robot() {
    let plan = plan([
        room([0.0; 2], [4.0, 3.0], 0.0),
        block([1.0, 1.0], [2.0, 2.0], 0.0, 0.05),
        block([2.0, 0.0], [3.0, 1.0], 1.2, 1.5),
        block([3.0, 2.0], [3.5, 2.5], 0.5, 0.6),
    ]);
    assert!(
        plan.is_reachable(1.5, 1.5) && plan.is_reachable(2.5, 0.5) && !plan.is_free(3.25, 2.25)
    );
}

#[test]
fn start_poses_are_open_seeded_and_look_along_the_room() {
    let plan = plan([room([0.0; 2], [9.0, 2.0], 0.0)]);
    for seed in 0..20 {
        let pose = plan.start_pose(seed);
        assert!(plan.clearance_m(pose.x_m, pose.y_m) > 0.85, "{pose:?}");
        assert!(
            pose.yaw_rad.sin().abs() < 0.3 && pose.yaw_rad.cos() * (4.5 - pose.x_m) > -0.2,
            "{pose:?}"
        );
        assert_eq!(pose, plan.start_pose(seed));
        let random = plan.random_pose(seed);
        assert!(
            plan.is_reachable(random.x_m, random.y_m) && plan.fits(random.x_m, random.y_m, &[])
        );
    }
    assert!(plan.start_pose(0) != plan.start_pose(1) && plan.random_pose(0) != plan.random_pose(1));
}

#[test]
fn the_nearest_free_place_is_outside_of_the_obstacle() {
    let plan = plan([room([0.0; 2], [5.0, 4.0], 0.0), block([2.0, 1.0], [3.0, 3.0], 0.0, 0.8)]);
    let [x, y] = plan.nearest_free(2.1, 2.0);
    assert!((x - 1.84).abs() < 0.06 && (y - 2.0).abs() < 0.06, "({x}, {y})");
}

#[test]
fn the_nearest_surface_is_found_up_to_the_limit_also_above_the_robot() {
    // A shelf 1.2 m above the floor blocks no robot, but depth sees it.
    let shelf = block([2.0, 1.5], [3.0, 2.5], 1.2, 1.3);
    let plan = plan([room([0.0; 2], [5.0, 4.0], 0.0), shelf]);
    let (point, distance_m) = plan.nearest_surface(1.6, 2.0, 1.0).unwrap();
    assert!(near_point(point, [2.0, 2.0]) && near(distance_m, 0.4));
    let (point, distance_m) = plan.nearest_surface(0.05, 2.0, 1.0).unwrap();
    assert!(near_point(point, [0.0, 2.0]) && near(distance_m, 0.05));
    assert!(plan.nearest_surface(1.6, 2.0, 0.39).is_none());
    assert!(plan.nearest_surface(1.0, 3.0, 0.9).is_none());
}

fn near_point(actual: [f64; 2], expected: [f64; 2]) -> bool {
    near(actual[0], expected[0]) && near(actual[1], expected[1])
}

#[test]
fn rooms_without_a_door_are_planned_one_at_a_time() {
    let plan = plan([room([0.0; 2], [5.0, 4.0], 0.0), room([5.0, 0.0], [8.0, 4.0], 0.0)]);
    assert!(plan.is_reachable(2.0, 2.0) && !plan.is_reachable(6.5, 2.0) && plan.is_free(6.5, 2.0));
    let other = plan.around(6.5, 2.0).unwrap();
    assert!(
        !other.is_reachable(2.0, 2.0)
            && other.is_reachable(6.5, 2.0)
            && other.is_reachable_floor(7.9, 2.0)
    );
    assert!(plan.around(5.0, 2.0).is_none());
}

#[test]
fn a_robot_stops_at_a_wall_to_a_tenth_of_a_millimetre() {
    let plan = plan([room([0.0; 2], [5.0, 4.0], 0.0)]);
    for yaw in [0.0_f64, 0.3, -0.5] {
        let moved =
            plan.drive(&Pose2::new(2.0, 2.0, yaw), &ahead(), 5.0, &Body { sliding: false }, &[]);
        assert!(moved.contact && (moved.pose.x_m - 4.84).abs() < 1e-4, "{moved:?}");
        let back = Twist2 { linear_mps: -1.0, angular_radps: 0.0 };
        let freed = plan.drive(&moved.pose, &back, 0.5, &Body { sliding: false }, &[]);
        assert!(!freed.contact && (freed.pose.distance_m(&moved.pose) - 0.5).abs() < 1e-9);
        let turning = Twist2 { linear_mps: 0.0, angular_radps: 1.0 };
        assert!(!plan.drive(&moved.pose, &turning, 3.0, &Body { sliding: false }, &[]).contact);
    }
}

#[test]
fn sliding_follows_a_wall_and_ends_in_a_corner() {
    let plan = plan([room([0.0; 2], [5.0, 4.0], 0.0)]);
    let moved =
        plan.drive(&Pose2::new(3.0, 1.0, 0.8), &ahead(), 10.0, &Body { sliding: true }, &[]);
    assert!(moved.contact);
    assert!(
        (moved.pose.x_m - 4.84).abs() < 1e-3 && (moved.pose.y_m - 3.84).abs() < 1e-2,
        "{moved:?}"
    );
}

#[test]
fn people_block_the_robot_and_an_overlapping_robot_may_drive_away() {
    let plan = plan([room([0.0; 2], [5.0, 4.0], 0.0)]);
    let person = Disc { center_m: [3.0, 2.0], radius_m: 0.2 };
    let body = Body { sliding: false };
    let moved = plan.drive(&Pose2::new(1.0, 2.0, 0.0), &ahead(), 3.0, &body, &[person]);
    assert!(moved.contact && (moved.pose.x_m - 2.64).abs() < 1e-4, "{moved:?}");
    // The robot overlaps the person: driving further in is refused, driving out is not.
    let inside = Pose2::new(2.8, 2.0, 0.0);
    assert!(plan.drive(&inside, &ahead(), 0.1, &body, &[person]).contact);
    let back = Twist2 { linear_mps: -1.0, angular_radps: 0.0 };
    assert!(!plan.drive(&inside, &back, 0.5, &body, &[person]).contact);
}

fn ahead() -> Twist2 {
    Twist2 { linear_mps: 1.0, angular_radps: 0.0 }
}

/// A room with boxes, a hole in a corner of the floor and a slanted board.
static CLUTTERED: LazyLock<FloorPlan> = LazyLock::new(|| {
    let board = quad([[0.5, 3.5, 0.0], [1.5, 3.9, 0.0], [1.5, 3.9, 1.0], [0.5, 3.5, 1.0]]).to_vec();
    plan([
        slab([0.0; 2], [5.0, 3.0], 0.0).to_vec(),
        slab([0.0, 3.0], [4.0, 4.0], 0.0).to_vec(),
        walls([0.0; 2], [5.0, 4.0], 0.0, 2.5),
        block([1.0, 1.0], [1.6, 1.3], 0.0, 0.8),
        block([2.6, 1.9], [3.0, 2.8], 0.0, 0.4),
        block([3.6, 0.2], [3.65, 0.25], 0.0, 0.9),
        board,
    ])
});

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_robot_never_ends_where_it_cannot_be(
        seed: u64,
        sliding: bool,
        drives in prop::collection::vec((-1.0..1.0, -2.0..2.0, 0.0..1.5), 1..12),
    ) {
        let plan = &*CLUTTERED;
        let mut pose = plan.random_pose(seed);
        for (linear_mps, angular_radps, seconds) in drives {
            let moved = plan.drive(&pose, &Twist2 { linear_mps, angular_radps }, seconds, &Body { sliding }, &[]);
            pose = moved.pose;
            let x = pose.x_m;
            let y = pose.y_m;
            if moved.fell {
                // The only hole is the corner without floor.
                prop_assert!(x > 3.8 && y > 2.8, "{pose:?}");
                break;
            }
            // It may reach over an edge as long as its wheels stand on the floor.
            prop_assert!(plan.stands(&pose), "{pose:?}");
            prop_assert!(!plan.is_blocked(x, y) && plan.is_supported(x, y), "{pose:?}");
            // Analytic check: clear of the walls and of the two large boxes.
            prop_assert!((0.16 - 2e-5..4.84 + 2e-5).contains(&x) && (0.16 - 2e-5..3.84 + 2e-5).contains(&y), "{pose:?}");
            for ([x0, y0], [x1, y1]) in [([1.0, 1.0], [1.6, 1.3]), ([2.6, 1.9], [3.0, 2.8])] {
                let apart = (x.clamp(x0, x1) - x).hypot(y.clamp(y0, y1) - y);
                prop_assert!(apart > 0.16 - 2e-5, "{pose:?}");
            }
        }
    }

    #[test]
    fn sliding_gets_at_least_as_far_along_a_straight_path(seed: u64, seconds in 0.0..3.0) {
        let plan = &*CLUTTERED;
        let from = plan.random_pose(seed);
        // What slides past an obstacle may fall where the other one is held. In a wedge, the step that ends the motion may end
        // a millimetre earlier.
        let fell = plan.drive(&from, &ahead(), seconds, &Body { sliding: true }, &[]).fell;
        let slid_m = distance_ahead(true, plan, &from, seconds);
        prop_assert!(fell || slid_m >= distance_ahead(false, plan, &from, seconds) - 1e-3);
    }

    #[test]
    fn a_motion_without_contact_is_the_commanded_arc(seed: u64, v in -1.0..1.0, w in -2.0..2.0, seconds in 0.0..2.0) {
        let plan = &*CLUTTERED;
        let from = plan.random_pose(seed);
        let twist = Twist2 { linear_mps: v, angular_radps: w };
        let moved = plan.drive(&from, &twist, seconds, &Body { sliding: false }, &[]);
        if !moved.contact && !moved.fell {
            prop_assert!(moved.pose.distance_m(&from.compose(&twist.integrate(seconds))) < 1e-9);
        }
    }
}

fn distance_ahead(sliding: bool, plan: &FloorPlan, from: &Pose2, seconds: f64) -> f64 {
    let to = plan.drive(from, &ahead(), seconds, &Body { sliding }, &[]).pose;
    (to.x_m - from.x_m) * from.yaw_rad.cos() + (to.y_m - from.y_m) * from.yaw_rad.sin()
}

#[test]
fn the_robot_fits_in_every_reachable_cell_and_clearance_is_a_lower_bound() {
    let plan = &*CLUTTERED;
    let boxes: [[f64; 4]; 2] = [[1.0, 1.0, 1.6, 1.3], [2.6, 1.9, 3.0, 2.8]];
    for [x, y] in plan.reachable() {
        assert!(plan.fits(x, y, &[]), "({x}, {y})");
        let to_walls = x.min(5.0 - x).min(y).min(4.0 - y);
        let to_boxes =
            boxes.map(|[x0, y0, x1, y1]| (x.clamp(x0, x1) - x).hypot(y.clamp(y0, y1) - y));
        let truth = to_boxes.into_iter().fold(to_walls, f64::min);
        assert!(
            plan.clearance_m(x, y) <= truth + 1e-5,
            "({x}, {y}): {} > {truth}",
            plan.clearance_m(x, y)
        );
    }
}
