//! Frontiers: places where known free floor meets unknown cells.

use super::bits::{BitPlane, free_and_known, widen};
use super::components::Components;
use super::{Cell, OccupancyGrid};

/// A group of frontier cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frontier {
    /// Number of cells in the group; all of them are unknown.
    pub cells: usize,
    /// Centroid of the cells in `odom`, metres. It may lie inside a wall or behind one.
    pub centroid_m: [f64; 2],
    /// The free cell next to the group that is nearest to the centroid: the robot observes the
    /// frontier from there.
    pub approach: Cell,
}

/// Finds frontiers (Yamauchi 1997, "A frontier-based approach for autonomous exploration") and
/// reuses its buffers.
///
/// A frontier cell is unknown and has a free cell among its 8 neighbours. Frontier cells form
/// 8-connected groups, and groups of at most `min_cells` cells are noise (20 in the paper's code).
#[derive(Debug, Clone, Default)]
pub struct FrontierFinder {
    free: BitPlane,
    known: BitPlane,
    frontier: BitPlane,
    wide: [Vec<u64>; 3],
    components: Components,
    nearest: Vec<Option<(i64, Cell)>>,
}

impl FrontierFinder {
    /// Value of `min_cells` in the paper's code.
    pub const MIN_CELLS: usize = 20;

    /// Writes all groups of more than `min_cells` cells into `found`, in the order of their first
    /// cells, row by row.
    pub fn find(&mut self, grid: &OccupancyGrid, min_cells: usize, found: &mut Vec<Frontier>) {
        found.clear();
        let Some(cells) =
            grid.known_box().and_then(|known| known.grown(1).intersection(grid.window()))
        else {
            return;
        };
        free_and_known(grid, cells, &mut self.free, &mut self.known);
        self.mark_frontier_cells();
        self.components.find(&self.frontier);
        approach_cells(&self.components, &self.free, min_cells, &mut self.nearest);
        for (group, nearest) in self.components.groups().iter().zip(&self.nearest) {
            if let Some((_, approach)) = *nearest {
                found.push(Frontier {
                    cells: group.cells,
                    centroid_m: group.centroid_m(grid.cell_m()),
                    approach,
                });
            }
        }
    }

    /// Computes `frontier = dilated free & !known`, 64 cells at a time.
    fn mark_frontier_cells(&mut self) {
        let rows = self.free.rows();
        let words = self.free.words_per_row;
        let width = self.free.cells.width();
        let beyond = if width.is_multiple_of(64) { 0 } else { u64::MAX << (width % 64) };
        self.frontier.reset(self.free.cells);
        for wide in &mut self.wide {
            wide.clear();
            wide.resize(words, 0);
        }
        // `wide` holds the dilated rows above, at and below the current row.
        widen(self.free.row(0), &mut self.wide[1]);
        for row in 0..rows {
            match row + 1 < rows {
                true => widen(self.free.row(row + 1), &mut self.wide[2]),
                false => self.wide[2].fill(0),
            }
            let known = self.known.row(row);
            for (at, out) in self.frontier.row_mut(row).iter_mut().enumerate() {
                *out = (self.wide[0][at] | self.wide[1][at] | self.wide[2][at]) & !known[at];
            }
            if let Some(last) = self.frontier.row_mut(row).last_mut() {
                *last &= !beyond;
            }
            self.wide.rotate_left(1);
        }
    }
}

/// For every group of more than `min_cells` cells, the free cell next to it that is nearest to its
/// centroid; of several equally near ones, the first in row order.
fn approach_cells(
    components: &Components,
    free: &BitPlane,
    min_cells: usize,
    nearest: &mut Vec<Option<(i64, Cell)>>,
) {
    let groups = components.groups();
    nearest.clear();
    nearest.resize(groups.len(), None);
    for (run, place) in components.runs() {
        let group = &groups[place];
        if group.cells <= min_cells {
            continue;
        }
        let centroid = group.centroid();
        for y in run.y - 1..=run.y + 1 {
            for x in run.first_x - 1..=run.last_x + 1 {
                let candidate = (Cell::new(x, y).distance2(centroid), Cell::new(x, y));
                if nearest[place].is_none_or(|best| candidate < best) && free.contains(candidate.1)
                {
                    nearest[place] = Some(candidate);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{CellState, MapConfig};
    use hal::Pose2;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn grid_of(cells: impl Iterator<Item = (Cell, f32)>) -> OccupancyGrid {
        let config = MapConfig { side_cells: 150, recenter_cells: 5, ..MapConfig::default() };
        let mut grid = OccupancyGrid::new(&config).unwrap();
        grid.begin_update(&Pose2::new(2.0, -1.0, 0.0)).unwrap();
        for (cell, evidence) in cells {
            if let Some(index) = grid.index(cell) {
                grid.add_evidence(cell, index, evidence);
            }
        }
        grid.finish_update();
        grid
    }

    fn neighbours(cell: Cell) -> impl Iterator<Item = Cell> {
        (-1..=1)
            .flat_map(move |dy| (-1..=1).map(move |dx| cell.offset(dx, dy)))
            .filter(move |near| *near != cell)
    }

    fn rounded_mean(values: impl ExactSizeIterator<Item = i32>) -> i32 {
        let count = values.len() as f64;
        (values.map(f64::from).sum::<f64>() / count).round() as i32
    }

    /// Computes the frontiers one cell at a time, directly from the definition.
    fn naive(grid: &OccupancyGrid, min_cells: usize) -> Vec<(usize, Cell)> {
        let window = grid.window();
        let all = (window.min.y..=window.max.y)
            .flat_map(|y| (window.min.x..=window.max.x).map(move |x| Cell::new(x, y)));
        let frontier_cells = all.filter(|cell| {
            grid.state(*cell) == CellState::Unknown
                && neighbours(*cell).any(|near| grid.state(near) == CellState::Free)
        });
        let mut left: BTreeSet<Cell> = frontier_cells.collect();
        let mut found = Vec::new();
        while let Some(first) = left.pop_first() {
            let mut group = vec![first];
            let mut next = 0;
            while let Some(cell) = group.get(next).copied() {
                group.extend(neighbours(cell).filter(|near| left.remove(near)));
                next += 1;
            }
            if group.len() > min_cells {
                let centroid = Cell::new(
                    rounded_mean(group.iter().map(|cell| cell.x)),
                    rounded_mean(group.iter().map(|cell| cell.y)),
                );
                let beside = group.iter().flat_map(|cell| neighbours(*cell));
                let free = beside.filter(|near| grid.state(*near) == CellState::Free);
                let approach = free.min_by_key(|near| (near.distance2(centroid), *near)).unwrap();
                found.push((group.len(), approach));
            }
        }
        found
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn frontiers_are_those_of_the_definition(
            patches in proptest::collection::vec((-12..150i32, -110..40i32, 1..40i32, 1..40i32, any::<bool>()), 0..25),
            min_cells in 0..30usize,
        ) {
            let cells = patches.iter().flat_map(|&(x, y, w, h, free)| {
                let evidence = if free { -1.5 } else { 2.0 };
                (y..y + h).flat_map(move |y| (x..x + w).map(move |x| (Cell::new(x, y), evidence)))
            });
            let grid = grid_of(cells);
            let mut found = Vec::new();
            FrontierFinder::default().find(&grid, min_cells, &mut found);
            let got: Vec<(usize, Cell)> = found.iter().map(|frontier| (frontier.cells, frontier.approach)).collect();
            prop_assert_eq!(got, naive(&grid, min_cells));
        }
    }

    #[test]
    fn a_room_with_a_door_has_one_frontier_in_the_door() {
        let room = (0..40).flat_map(|y| (0..40).map(move |x| (x, y)));
        let cells = room.map(|(x, y)| {
            let wall = x == 0 || y == 0 || x == 39 || y == 39;
            let door = x == 39 && (5..30).contains(&y);
            (Cell::new(x, y), if wall && !door { 2.0 } else { -1.5 })
        });
        let grid = grid_of(cells);
        let mut found = Vec::new();
        FrontierFinder::default().find(&grid, FrontierFinder::MIN_CELLS, &mut found);
        let [door] = found[..] else { panic!("{found:?}") };
        assert_eq!(
            (door.cells, door.approach.x),
            (27, 39),
            "the door's 25 cells and one beyond either end"
        );
        assert!(
            (door.centroid_m[0] - 40.5 * 0.03).abs() < 1e-9
                && (door.centroid_m[1] - 17.5 * 0.03).abs() < 1e-9
        );
    }

    #[test]
    fn an_empty_map_and_a_closed_room_have_no_frontier() {
        let mut found = vec![];
        let mut finder = FrontierFinder::default();
        finder.find(&grid_of([].into_iter()), 0, &mut found);
        assert!(found.is_empty());
        let closed = (0..30).flat_map(|y| (0..30).map(move |x| (x, y))).map(|(x, y)| {
            let wall = x == 0 || y == 0 || x == 29 || y == 29;
            (Cell::new(x, y), if wall { 2.0 } else { -1.5 })
        });
        finder.find(&grid_of(closed), 0, &mut found);
        assert!(found.is_empty());
    }
}
