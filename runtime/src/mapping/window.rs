//! A square of cells that rolls along with the robot: cells keep their place in memory, the ends wrap around.

use serde::{Deserialize, Serialize};

use super::Cell;
use crate::snapshot::{SnapshotError, State};

/// A rectangle of cells, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CellBox {
    /// Lowest column and row.
    pub min: Cell,
    /// Highest column and row.
    pub max: Cell,
}

impl CellBox {
    /// The box of one cell.
    #[must_use]
    pub fn of(cell: Cell) -> Self {
        Self { min: cell, max: cell }
    }

    /// The smallest box that holds this one and `cell`.
    #[must_use]
    pub fn including(self, cell: Cell) -> Self {
        Self {
            min: Cell::new(self.min.x.min(cell.x), self.min.y.min(cell.y)),
            max: Cell::new(self.max.x.max(cell.x), self.max.y.max(cell.y)),
        }
    }

    /// What both boxes hold, if anything.
    #[must_use]
    pub fn intersection(self, other: Self) -> Option<Self> {
        let min = Cell::new(self.min.x.max(other.min.x), self.min.y.max(other.min.y));
        let max = Cell::new(self.max.x.min(other.max.x), self.max.y.min(other.max.y));
        (min.x <= max.x && min.y <= max.y).then_some(Self { min, max })
    }

    /// The box with `cells` more on every side.
    #[must_use]
    pub fn grown(self, cells: i32) -> Self {
        Self { min: self.min.offset(-cells, -cells), max: self.max.offset(cells, cells) }
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        (self.max.x - self.min.x + 1) as usize
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        (self.max.y - self.min.y + 1) as usize
    }

    /// Whether the box holds `cell`.
    #[must_use]
    pub fn contains(&self, cell: Cell) -> bool {
        (self.min.x..=self.max.x).contains(&cell.x) && (self.min.y..=self.max.y).contains(&cell.y)
    }
}

/// Which cells are in memory, and where. A cell's place is its coordinates modulo the side, so moving the window moves no
/// data: only the rows and columns that come in have to be emptied.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Window {
    side: i32,
    min: Cell,
    /// Where column `min.x` and row `min.y` lie in memory.
    wrap_x: usize,
    wrap_y: usize,
}

impl Window {
    pub fn centered(side: usize, center: Cell) -> Self {
        let half = side as i32 / 2;
        let mut window = Self { side: side as i32, min: Cell::default(), wrap_x: 0, wrap_y: 0 };
        window.set_min(center.offset(-half, -half));
        window
    }

    fn set_min(&mut self, min: Cell) {
        self.min = min;
        self.wrap_x = min.x.rem_euclid(self.side) as usize;
        self.wrap_y = min.y.rem_euclid(self.side) as usize;
    }

    pub fn side(&self) -> usize {
        self.side as usize
    }

    pub fn cells(&self) -> CellBox {
        CellBox { min: self.min, max: self.min.offset(self.side - 1, self.side - 1) }
    }

    pub fn center(&self) -> Cell {
        self.min.offset(self.side / 2, self.side / 2)
    }

    /// Where a cell lies in memory; `None` outside the window.
    #[inline]
    pub fn index(&self, cell: Cell) -> Option<usize> {
        let x = cell.x.wrapping_sub(self.min.x) as u32 as usize;
        let y = cell.y.wrapping_sub(self.min.y) as u32 as usize;
        let side = self.side as usize;
        if x >= side || y >= side {
            return None;
        }
        let column = if x + self.wrap_x >= side { x + self.wrap_x - side } else { x + self.wrap_x };
        let row = if y + self.wrap_y >= side { y + self.wrap_y - side } else { y + self.wrap_y };
        Some(row * side + column)
    }

    /// Row `y` (in the window) of a plane of `data`, from column `min_x` on, as one or two contiguous parts.
    pub fn row<'a, T>(
        &self,
        data: &'a [T],
        y: i32,
        min_x: i32,
        width: usize,
    ) -> (&'a [T], &'a [T]) {
        let Some(start) = self.index(Cell::new(min_x, y)) else { return (&[], &[]) };
        let side = self.side as usize;
        let row_start = start - start % side;
        let first = width.min(row_start + side - start);
        (&data[start..start + first], &data[row_start..row_start + width - first])
    }

    /// Moves the window to a new middle; `forget` gets the ranges of memory that now stand for other cells.
    pub fn recenter(&mut self, center: Cell, mut forget: impl FnMut(core::ops::Range<usize>)) {
        let old = self.cells();
        let half = self.side / 2;
        self.set_min(center.offset(-half, -half));
        let side = self.side();
        let Some(kept) = old.intersection(self.cells()) else { return forget(0..side * side) };
        // Columns that stay, in memory: at most two runs of columns that go.
        let gone = side - kept.width();
        let gone_min_x = if kept.min.x == self.min.x { kept.max.x + 1 } else { self.min.x };
        let start_x = gone_min_x.rem_euclid(self.side) as usize;
        for row in 0..side {
            let y = self.min.y + (row as i32 - self.wrap_y as i32).rem_euclid(self.side);
            let base = row * side;
            if y < kept.min.y || y > kept.max.y {
                forget(base..base + side);
            } else if gone > 0 {
                let first = gone.min(side - start_x);
                forget(base + start_x..base + start_x + first);
                forget(base..base + gone - first);
            }
        }
    }
}

/// Only where it lies: its side is configuration.
impl State for Window {
    fn write(&self, to: &mut Vec<u8>) {
        self.min.write(to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let mut min = Cell::default();
        min.read(from)?;
        self.set_min(min);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_cell_of_the_window_has_its_own_place() {
        let window = Window::centered(16, Cell::new(-5, 1003));
        let cells = window.cells();
        let mut seen = vec![false; 256];
        for y in cells.min.y..=cells.max.y {
            for x in cells.min.x..=cells.max.x {
                let index = window.index(Cell::new(x, y)).unwrap();
                assert!(!std::mem::replace(&mut seen[index], true));
            }
        }
        assert_eq!(window.index(Cell::new(cells.max.x + 1, 1003)), None);
        assert_eq!(window.index(Cell::new(-5, cells.min.y - 1)), None);
    }

    proptest! {
        #[test]
        fn moving_keeps_what_stays_and_forgets_what_comes_in(
            ax in -40..40i32, ay in -40..40i32, dx in -30..30i32, dy in -30..30i32, side in 5..24usize,
        ) {
            let name = |cell: Cell| i64::from(cell.y) * 1_000_000 + i64::from(cell.x);
            let mut window = Window::centered(side, Cell::new(ax, ay));
            let mut data = vec![i64::MIN; side * side];
            let before = window.cells();
            for y in before.min.y..=before.max.y {
                for x in before.min.x..=before.max.x {
                    data[window.index(Cell::new(x, y)).unwrap()] = name(Cell::new(x, y));
                }
            }
            window.recenter(Cell::new(ax + dx, ay + dy), |range| data[range].fill(0));
            let after = window.cells();
            for y in after.min.y..=after.max.y {
                let (left, right) = window.row(&data, y, after.min.x, side);
                let row: Vec<i64> = left.iter().chain(right).copied().collect();
                for x in after.min.x..=after.max.x {
                    let cell = Cell::new(x, y);
                    let expected = if before.contains(cell) { name(cell) } else { 0 };
                    prop_assert_eq!(data[window.index(cell).unwrap()], expected);
                    prop_assert_eq!(row[(x - after.min.x) as usize], expected);
                }
            }
        }
    }
}
