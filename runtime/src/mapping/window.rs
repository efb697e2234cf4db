//! The square map window that moves with the robot. Cells keep their place in memory when the
//! window moves, and the memory wraps around at its ends.

use serde::{Deserialize, Serialize};

use super::Cell;
use crate::snapshot::{SnapshotError, State};

/// A rectangle of cells, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CellBox {
    /// The cell with the lowest column and row.
    pub min: Cell,
    /// The cell with the highest column and row.
    pub max: Cell,
}

impl CellBox {
    /// A box that contains one cell.
    #[must_use]
    pub fn of(cell: Cell) -> Self {
        Self { min: cell, max: cell }
    }

    /// The smallest box that contains this box and `cell`.
    #[must_use]
    pub fn including(self, cell: Cell) -> Self {
        Self {
            min: Cell::new(self.min.x.min(cell.x), self.min.y.min(cell.y)),
            max: Cell::new(self.max.x.max(cell.x), self.max.y.max(cell.y)),
        }
    }

    /// The overlap of both boxes; `None` if there is none.
    #[must_use]
    pub fn intersection(self, other: Self) -> Option<Self> {
        let min = Cell::new(self.min.x.max(other.min.x), self.min.y.max(other.min.y));
        let max = Cell::new(self.max.x.min(other.max.x), self.max.y.min(other.max.y));
        (min.x <= max.x && min.y <= max.y).then_some(Self { min, max })
    }

    /// The box extended by `cells` on every side.
    #[must_use]
    pub fn grown(self, cells: i32) -> Self {
        Self { min: self.min.offset(-cells, -cells), max: self.max.offset(cells, cells) }
    }

    /// Number of columns of the box.
    #[must_use]
    pub fn width(&self) -> usize {
        (self.max.x - self.min.x + 1) as usize
    }

    /// Number of rows of the box.
    #[must_use]
    pub fn height(&self) -> usize {
        (self.max.y - self.min.y + 1) as usize
    }

    #[must_use]
    pub fn contains(&self, cell: Cell) -> bool {
        (self.min.x..=self.max.x).contains(&cell.x) && (self.min.y..=self.max.y).contains(&cell.y)
    }
}

/// Maps the cells of a square window to memory. A cell's place is its column and row modulo the
/// side, so moving the window moves no data: only the rows and columns that enter the window have
/// to be cleared.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Window {
    side: i32,
    min: Cell,
    /// Memory column of `min.x` and memory row of `min.y`.
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

    /// Index of a cell in memory; `None` outside the window.
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

    /// The values of row `y` from column `min_x` on, as one or two contiguous slices of `data`.
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

    /// Moves the window to a new centre. Calls `clear` with each range of memory that now belongs
    /// to other cells.
    pub fn recenter(&mut self, center: Cell, mut clear: impl FnMut(core::ops::Range<usize>)) {
        let old = self.cells();
        let half = self.side / 2;
        self.set_min(center.offset(-half, -half));
        let side = self.side();
        let Some(kept) = old.intersection(self.cells()) else { return clear(0..side * side) };
        // In memory, the columns that leave the window form at most two runs.
        let gone = side - kept.width();
        let gone_min_x = if kept.min.x == self.min.x { kept.max.x + 1 } else { self.min.x };
        let start_x = gone_min_x.rem_euclid(self.side) as usize;
        for row in 0..side {
            let y = self.min.y + (row as i32 - self.wrap_y as i32).rem_euclid(self.side);
            let base = row * side;
            if y < kept.min.y || y > kept.max.y {
                clear(base..base + side);
            } else if gone > 0 {
                let first = gone.min(side - start_x);
                clear(base + start_x..base + start_x + first);
                clear(base..base + gone - first);
            }
        }
    }
}

/// A snapshot holds only the position, because the side is configuration.
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
        fn moving_keeps_the_cells_that_stay_and_clears_the_cells_that_enter(
            ax in -40..40i32, ay in -40..40i32, dx in -30..30i32, dy in -30..30i32, side in 5..24usize,
        ) {
            fn name(cell: Cell) -> i64 {
                i64::from(cell.y) * 1_000_000 + i64::from(cell.x)
            }
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
