//! Where known free floor meets the unknown.

use super::bits::{BitPlane, free_and_known, widen};
use super::components::Components;
use super::{Cell, OccupancyGrid};

/// A group of frontier cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frontier {
    /// Number of unknown cells in it.
    pub cells: usize,
    /// Their centroid in `odom`, metres. May lie in a wall or beyond one.
    pub centroid_m: [f64; 2],
    /// The free cell beside the group that is nearest to the centroid: where to look from.
    pub approach: Cell,
}

/// Finds frontiers; reuses its memory.
///
/// A frontier cell is unknown and has a free cell among its 8 neighbours; frontier cells group by 8-connection, and groups of
/// `min_cells` or less are noise (the paper's code: 20). Yamauchi 1997, "A frontier-based approach for autonomous exploration".
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
    /// Groups of more than this many cells are frontiers in the paper's code.
    pub const MIN_CELLS: usize = 20;

    /// Writes all groups of more than `min_cells` cells into `found`, in the order of their first cells, row by row.
    pub fn find(&mut self, grid: &OccupancyGrid, min_cells: usize, found: &mut Vec<Frontier>) {
        found.clear();
        let Some(cells) = grid.known_box().and_then(|known| known.grown(1).intersection(grid.window())) else { return };
        free_and_known(grid, cells, &mut self.free, &mut self.known);
        self.mark_frontier_cells();
        self.components.find(&self.frontier);
        approach_cells(&self.components, &self.free, min_cells, &mut self.nearest);
        for (group, nearest) in self.components.groups().iter().zip(&self.nearest) {
            if let Some((_, approach)) = *nearest {
                found.push(Frontier { cells: group.cells, centroid_m: group.centroid_m(grid.cell_m()), approach });
            }
        }
    }

    /// `frontier = widened free & not known`, a word at a time.
    fn mark_frontier_cells(&mut self) {
        let rows = self.free.rows();
        let words = self.free.words_per_row;
        let width = self.free.cells.width();
        let beyond = if width % 64 == 0 { 0 } else { u64::MAX << (width % 64) };
        self.frontier.reset(self.free.cells);
        for wide in &mut self.wide {
            wide.clear();
            wide.resize(words, 0);
        }
        // `wide` holds the widened rows above, here and below.
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

/// For every group of more than `min_cells` cells: the free cell beside it that is nearest to its centroid; of several, the
/// first row by row.
fn approach_cells(components: &Components, free: &BitPlane, min_cells: usize, nearest: &mut Vec<Option<(i64, Cell)>>) {
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
                let cell = Cell::new(x, y);
                if free.contains(cell) {
                    let candidate = (cell.distance2(centroid), cell);
                    nearest[place] = Some(nearest[place].map_or(candidate, |best| best.min(candidate)));
                }
            }
        }
    }
}
