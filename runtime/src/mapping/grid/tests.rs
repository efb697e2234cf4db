use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

fn small() -> MapConfig {
    MapConfig { side_cells: 150, recenter_cells: 5, ..MapConfig::default() }
}

fn grid() -> OccupancyGrid {
    OccupancyGrid::new(&small()).unwrap()
}

fn observe(grid: &mut OccupancyGrid, cell: Cell, evidence: f32) {
    if let Some(index) = grid.index(cell) {
        grid.add_evidence(cell, index, evidence);
    }
}

fn update(grid: &mut OccupancyGrid, observations: &[(Cell, f32)]) {
    grid.begin_update(&Pose2::IDENTITY).unwrap();
    for (cell, evidence) in observations {
        observe(grid, *cell, *evidence);
    }
    grid.finish_update();
}

/// The documented formula, applied to one cell at a time.
fn naive(map: &mut BTreeMap<Cell, f32>, config: &MapConfig, observations: &[(Cell, f32)]) {
    map.values_mut().for_each(|value| *value *= config.decay);
    let mut evidence: BTreeMap<Cell, (bool, bool)> = BTreeMap::new();
    for (cell, seen) in observations {
        let (occupied, free) = evidence.entry(*cell).or_default();
        *occupied |= *seen > 0.0;
        *free |= *seen < 0.0;
    }
    for (cell, (occupied, free)) in evidence {
        let value = map.entry(cell).or_insert(0.0);
        let change = if occupied { 2.0 } else { -1.5 * f32::from(u8::from(free)) };
        *value = (*value + change).clamp(-config.limit, config.limit);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn decay_equals_multiplying_every_cell(
        steps in proptest::collection::vec(proptest::collection::vec((0..6i32, 0..6i32, any::<bool>()), 0..12), 1..40),
        decay in 0.6..1.0f32, limit in 1.0..10.0f32, repeats in 1..40usize,
    ) {
        let config = MapConfig { decay, limit, ..small() };
        let mut grid = OccupancyGrid::new(&config).unwrap();
        let mut expected = BTreeMap::new();
        for step in (0..repeats).flat_map(|_| &steps) {
            let seen: Vec<(Cell, f32)> =
                step.iter().map(|(x, y, hit)| (Cell::new(*x, *y), if *hit { 2.0 } else { -1.5 })).collect();
            update(&mut grid, &seen);
            naive(&mut expected, &config, &seen);
        }
        for (cell, value) in &expected {
            let got = grid.log_odds(*cell);
            prop_assert!((got - value).abs() <= 1e-4 * value.abs() + 1e-5, "{:?}: {} instead of {}", cell, got, value);
        }
        prop_assert_eq!(grid.known_cells().count(), expected.len());
    }

    #[test]
    fn the_order_of_observations_does_not_matter(
        seen in proptest::collection::vec((0..3i32, -3..4i32), 0..20).prop_shuffle(),
    ) {
        let seen: Vec<(Cell, f32)> = seen.into_iter().map(|(x, value)| (Cell::new(x, 0), value as f32)).collect();
        let mut sorted = seen.clone();
        sorted.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut a = grid();
        let mut b = grid();
        update(&mut a, &seen);
        update(&mut b, &sorted);
        for x in 0..3 {
            prop_assert_eq!(a.log_odds(Cell::new(x, 0)), b.log_odds(Cell::new(x, 0)));
        }
    }
}

#[test]
fn in_one_update_occupied_wins_over_free() {
    let mut grid = grid();
    let cell = Cell::new(3, 4);
    update(&mut grid, &[(cell, -1.5), (cell, 2.0), (cell, -1.5)]);
    assert_eq!(grid.log_odds(cell), 2.0);
}

#[test]
fn decay_never_makes_a_known_cell_unknown() {
    let mut grid = grid();
    update(&mut grid, &[(Cell::new(0, 0), 2.0), (Cell::new(1, 0), -1.5)]);
    for _ in 0..20_000 {
        grid.begin_update(&Pose2::IDENTITY).unwrap();
        grid.finish_update();
    }
    assert_eq!(grid.state(Cell::new(0, 0)), CellState::Occupied);
    assert_eq!(grid.state(Cell::new(1, 0)), CellState::Free);
}

#[test]
fn evidence_that_cancels_does_not_make_a_cell_unknown() {
    let config = MapConfig { decay: 1.0, ..small() };
    let mut grid = OccupancyGrid::new(&config).unwrap();
    update(&mut grid, &[(Cell::new(0, 0), 2.0)]);
    update(&mut grid, &[(Cell::new(0, 0), -2.0)]);
    assert_eq!(grid.state(Cell::new(0, 0)), CellState::Free);
}

#[test]
fn the_window_follows_the_robot_and_keeps_the_cells_that_it_still_covers() {
    let mut grid = grid();
    let near = Cell::new(70, 3);
    let far = Cell::new(-70, 3);
    update(&mut grid, &[(near, 2.0), (far, 2.0)]);
    grid.begin_update(&Pose2::new(1.5, 0.0, 0.0)).unwrap();
    grid.finish_update();
    assert_eq!(grid.state(near), CellState::Occupied);
    assert_eq!(grid.state(far), CellState::Unknown);
    assert_eq!(grid.known_cells().map(|(cell, _)| cell).collect::<Vec<_>>(), [near]);
    grid.begin_update(&Pose2::IDENTITY).unwrap();
    grid.finish_update();
    assert_eq!(grid.state(far), CellState::Unknown, "a cell that left the window is unknown");
    assert_eq!(grid.state(near), CellState::Occupied);
}

#[test]
fn the_window_moves_as_little_as_necessary() {
    // The robot may be 5 cells away from the centre of 150 cells, so 80 cells behind it stay in the
    // window.
    let mut grid = grid();
    let kept = Cell::new(-30, 0);
    let forgotten = Cell::new(-31, 0);
    update(&mut grid, &[(kept, 2.0), (forgotten, 2.0)]);
    for x in (0..=50).chain((0..50).rev()) {
        let [x_m, y_m] = grid.center_m(Cell::new(x, 0));
        grid.begin_update(&Pose2::new(x_m, y_m, 0.0)).unwrap();
        grid.finish_update();
    }
    assert_eq!(grid.state(kept), CellState::Occupied);
    assert_eq!(grid.state(forgotten), CellState::Unknown);
}

#[test]
fn newly_known_cells_are_reported_once() {
    let mut grid = grid();
    let cell = Cell::new(-2, 9);
    update(&mut grid, &[(cell, -1.5)]);
    assert_eq!(grid.newly_known(), [cell]);
    update(&mut grid, &[(cell, 2.0)]);
    assert!(grid.newly_known().is_empty());
}

#[test]
fn a_collision_neither_decays_nor_is_cleared_until_it_expires() {
    let config = MapConfig { collision_updates: 100, ..small() };
    let mut grid = OccupancyGrid::new(&config).unwrap();
    let robot = Pose2::new(0.0, 0.015, core::f64::consts::FRAC_PI_2);
    grid.begin_update(&robot).unwrap();
    grid.mark_collision(&robot, 0.1).unwrap();
    grid.finish_update();
    // 0.2 m across the heading, 0.1 m ahead.
    let marked: Vec<Cell> = grid.known_cells().map(|(cell, _)| cell).collect();
    assert_eq!(marked, (-4..=3).map(|x| Cell::new(x, 3)).collect::<Vec<_>>());
    for _ in 0..99 {
        update(&mut grid, &[(Cell::new(0, 3), -1.5)]);
        assert!((grid.log_odds(Cell::new(0, 3)) - 1000.0).abs() < 0.01);
    }
    update(&mut grid, &[]);
    assert_eq!(grid.state(Cell::new(0, 3)), CellState::Unknown);
}

#[test]
fn an_unseen_place_is_tried_again_sooner_than_the_place_of_a_collision() {
    assert_eq!(updates_until_it_is_unknown(false), Some(9));
    assert_eq!(updates_until_it_is_unknown(true), Some(99));
}

fn updates_until_it_is_unknown(collides: bool) -> Option<u32> {
    let config = MapConfig { collision_updates: 100, unseen_updates: 10, ..small() };
    let robot = Pose2::new(0.0, 0.015, core::f64::consts::FRAC_PI_2);
    let ahead = Cell::new(0, 3);
    let mut grid = OccupancyGrid::new(&config).unwrap();
    grid.begin_update(&robot).unwrap();
    if collides {
        grid.mark_collision(&robot, 0.1).unwrap();
    }
    grid.mark_unseen(&robot, 0.1).unwrap();
    grid.finish_update();
    assert_eq!(grid.state(ahead), CellState::Occupied);
    (0..).find(|_| {
        update(&mut grid, &[]);
        grid.state(ahead) == CellState::Unknown
    })
}

#[test]
fn the_floor_under_the_robot_is_free_except_for_collisions() {
    let mut grid = grid();
    update(&mut grid, &[(Cell::new(1, 1), 50.0)]);
    grid.begin_update(&Pose2::IDENTITY).unwrap();
    grid.mark_collision(&Pose2::IDENTITY, 0.1).unwrap();
    grid.mark_standing(&Pose2::IDENTITY, 0.15).unwrap();
    observe(&mut grid, Cell::new(0, 0), 2.0);
    grid.finish_update();
    assert_eq!(grid.state(Cell::new(1, 1)), CellState::Free);
    assert_eq!(grid.state(Cell::new(0, 0)), CellState::Free);
    assert_eq!(grid.state(Cell::new(-5, 0)), CellState::Free);
    assert_eq!(grid.state(Cell::new(3, 0)), CellState::Occupied);
    assert_eq!(grid.state(Cell::new(-4, -4)), CellState::Unknown, "beyond the radius");
}

#[test]
fn the_digest_depends_on_the_written_cells_and_values() {
    let mut a = grid();
    let mut b = grid();
    let mut c = grid();
    update(&mut a, &[(Cell::new(1, 2), 2.0)]);
    update(&mut b, &[(Cell::new(1, 2), 2.0)]);
    update(&mut c, &[(Cell::new(1, 2), -1.5)]);
    assert_eq!(a.changes_digest(), b.changes_digest());
    assert_ne!(a.changes_digest(), c.changes_digest());
    update(&mut b, &[]);
    assert_ne!(a.changes_digest(), b.changes_digest());
}

#[test]
fn poses_that_are_not_finite_are_refused_and_change_nothing() {
    let mut grid = grid();
    update(&mut grid, &[(Cell::new(1, 2), 2.0)]);
    let nan = Pose2 { yaw_rad: f64::NAN, ..Pose2::IDENTITY };
    assert!(matches!(
        grid.begin_update(&nan),
        Err(MapError::PoseNotFinite { pose: "t_odom_base", .. })
    ));
    assert!(matches!(
        grid.begin_update(&Pose2::new(1e6, 0.0, 0.0)),
        Err(MapError::PoseOutOfReach { .. })
    ));
    assert!(grid.mark_collision(&nan, 0.1).is_err());
    assert!(grid.mark_collision(&Pose2::IDENTITY, f64::INFINITY).is_err());
    assert!(grid.mark_standing(&Pose2::IDENTITY, f64::NAN).is_err());
    assert_eq!((grid.updates(), grid.log_odds(Cell::new(1, 2))), (1, 2.0));
}
