use super::*;
use crate::mapping::CellBox;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

/// A random costmap of square patches: `None` with probability `blocked`, otherwise mostly 1, or up
/// to 15.
fn random_map(size: (i32, i32), patch: i32, blocked: f64, rough: f64, seed: u64) -> Costmap {
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let patches: Vec<Option<f64>> = (0..50 * 50)
        .map(|_| {
            let expensive = f64::from(random.random_range(4..60)) / 4.0;
            let weight = if random.random_bool(rough) { expensive } else { 1.0 };
            (!random.random_bool(blocked)).then_some(weight)
        })
        .collect();
    let cells = CellBox { min: Cell::new(-3, 5), max: Cell::new(size.0 - 4, size.1 + 4) };
    Costmap::from_weights(cells, 0.03, |cell| {
        patches[((cell.y - 5) / patch * 50 + (cell.x + 3) / patch) as usize]
    })
}

/// The neighbours of a cell and the integer costs of the steps, computed directly from the
/// documented rules.
fn successors(costmap: &Costmap, cell: Cell) -> Vec<(Cell, u32)> {
    let mut found = Vec::new();
    for (dx, dy) in STEPS {
        let next = cell.offset(dx, dy);
        if let Some(weight) = costmap.weight(next)
            && costmap.is_passable(cell.offset(dx, 0))
            && costmap.is_passable(cell.offset(0, dy))
        {
            let length = if dx != 0 && dy != 0 { DIAGONAL } else { STRAIGHT };
            found.push((next, length * (weight * 4.0) as u32));
        }
    }
    found
}

fn cost_of(costmap: &Costmap, path: &[Cell]) -> u32 {
    path.windows(2)
        .map(|pair| {
            let step = successors(costmap, pair[0]).into_iter().find(|(cell, _)| *cell == pair[1]);
            step.expect("the path takes a step that is not allowed").1
        })
        .sum()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn paths_cost_the_same_as_those_of_the_pathfinding_crate(
        width in 2..40i32, height in 2..40i32, blocked in 0.0..0.5f64, rough in prop_oneof![Just(0.0), Just(0.02), 0.0..1.0f64], patch in 1..9i32, seed: u64,
        ends in (0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64),
    ) {
        let costmap = random_map((width, height), patch, blocked, rough, seed);
        let [start, goal] = [[ends.0, ends.1], [ends.2, ends.3]].map(|[x, y]| {
            Cell::new(-3 + (x * f64::from(width)) as i32, 5 + (y * f64::from(height)) as i32)
        });
        let mut planner = Planner::new(usize::MAX);
        prop_assume!(costmap.is_passable(start));
        let expected = pathfinding::prelude::astar(&start, |cell| successors(&costmap, *cell), |_| 0, |cell| *cell == goal);
        // Planned twice: data of the first search must not disturb the second.
        let _ = planner.plan(&costmap, goal, start);
        match (planner.plan(&costmap, start, goal), expected) {
            (Ok(path), Some((_, cost))) => {
                prop_assert_eq!((path[0], path[path.len() - 1]), (start, goal));
                prop_assert_eq!(cost_of(&costmap, path), cost);
                let reach_m = planner.flood(&costmap, start).unwrap().distance_m(goal).unwrap();
                prop_assert!((reach_m - f64::from(cost) / 48.0 * 0.03).abs() < 1e-9);
            }
            (Err(NoPath::GoalBlocked), None) => prop_assert!(!costmap.is_passable(goal)),
            (Err(NoPath::Unreachable), None) => {
                prop_assert!(costmap.is_passable(goal));
                let mut reach = planner.flood(&costmap, start).unwrap();
                prop_assert_eq!(reach.distance_m(goal), None);
                prop_assert_eq!(reach.path_to(goal), Err(NoPath::Unreachable));
            }
            (got, expected) => prop_assert!(false, "{:?} instead of {:?}", got, expected.map(|(_, cost)| cost)),
        }
    }

    #[test]
    fn a_flood_knows_the_distance_to_every_cell(
        width in 2..25i32, height in 2..25i32, blocked in 0.0..0.4f64, rough in prop_oneof![Just(0.0), Just(0.03), 0.0..1.0f64], patch in 1..9i32, seed: u64,
    ) {
        let costmap = random_map((width, height), patch, blocked, rough, seed);
        let start = Cell::new(-3, 5);
        prop_assume!(costmap.is_passable(start));
        let expected = pathfinding::prelude::dijkstra_all(&start, |cell| successors(&costmap, *cell));
        let mut planner = Planner::new(usize::MAX);
        let mut reach = planner.flood(&costmap, start).unwrap();
        let cells = costmap.cells();
        for cell in (cells.min.y..=cells.max.y).flat_map(|y| (cells.min.x..=cells.max.x).map(move |x| Cell::new(x, y))) {
            let cost = if cell == start { Some(0) } else { expected.get(&cell).map(|(_, cost)| *cost) };
            let got = reach.distance_m(cell).map(|distance_m| (distance_m / 0.03 * 48.0).round() as u32);
            prop_assert_eq!(got, cost);
            if let Some(cost) = cost {
                let path = reach.path_to(cell).unwrap().to_vec();
                prop_assert_eq!((path[0], cost_of(&costmap, &path)), (start, cost));
            }
        }
    }
}

#[test]
fn a_corner_is_not_cut() {
    let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(1, 1) };
    let costmap =
        Costmap::from_weights(cells, 0.03, |cell| (cell != Cell::new(1, 0)).then_some(1.0));
    let mut planner = Planner::new(100);
    let path = planner.plan(&costmap, Cell::new(0, 0), Cell::new(1, 1)).unwrap();
    assert_eq!(path, [Cell::new(0, 0), Cell::new(0, 1), Cell::new(1, 1)]);
}

#[test]
fn each_cause_of_a_missing_path_has_its_own_reason() {
    let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(20, 20) };
    // A wall in column 10.
    let costmap = Costmap::from_weights(cells, 0.03, |cell| (cell.x != 10).then_some(1.0));
    let here = Cell::new(2, 2);
    let there = Cell::new(18, 2);
    let mut planner = Planner::new(1000);
    assert_eq!(planner.plan(&costmap, here, there), Err(NoPath::Unreachable));
    assert_eq!(planner.plan(&costmap, here, Cell::new(10, 2)), Err(NoPath::GoalBlocked));
    assert_eq!(planner.plan(&costmap, here, Cell::new(99, 2)), Err(NoPath::GoalBlocked));
    assert_eq!(planner.plan(&costmap, Cell::new(-1, 2), here), Err(NoPath::StartBlocked));
    assert_eq!(Planner::new(5).plan(&costmap, here, Cell::new(9, 20)), Err(NoPath::Budget));
    assert_eq!(planner.plan(&costmap, here, here), Ok(&[here][..]));
}

#[test]
fn data_of_hundreds_of_earlier_searches_does_not_disturb_a_search() {
    let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(20, 20) };
    let open = Costmap::from_weights(cells, 0.03, |_| Some(1.0));
    let walled = Costmap::from_weights(cells, 0.03, |cell| (cell.x != 10).then_some(1.0));
    let here = Cell::new(2, 2);
    let there = Cell::new(18, 2);
    let mut planner = Planner::new(10_000);
    for _ in 0..600 {
        assert_eq!(planner.plan(&open, here, there).map(<[Cell]>::len), Ok(17));
        assert_eq!(planner.plan(&walled, here, there), Err(NoPath::Unreachable));
        let reach = planner.flood(&walled, here).unwrap();
        assert_eq!(reach.distance_m(there), None);
        assert!((reach.distance_m(Cell::new(9, 2)).unwrap() - 0.21).abs() < 1e-9);
    }
}
