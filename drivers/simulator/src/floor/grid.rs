//! A grid of square cells on the floor.

/// Position and size of a raster. Cell (column, row) covers `origin + resolution * [column, column
/// + 1)` along x, and correspondingly along y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Corner of cell (0, 0) with the smallest x and y, metres.
    pub origin_m: [f64; 2],
    /// Side of a cell, metres.
    pub resolution_m: f64,
    pub width: usize,
    pub height: usize,
}

impl Grid {
    /// The grid that covers a rectangle.
    pub(super) fn covering(min_m: [f64; 2], max_m: [f64; 2], resolution_m: f64) -> Self {
        Self {
            origin_m: min_m,
            resolution_m,
            width: cells_along(0, min_m, max_m, resolution_m),
            height: cells_along(1, min_m, max_m, resolution_m),
        }
    }

    #[must_use]
    pub fn cells(&self) -> usize {
        self.width * self.height
    }

    /// Row-major index of the cell that holds a point, or `None` outside.
    #[must_use]
    pub fn index(&self, x_m: f64, y_m: f64) -> Option<usize> {
        let column = ((x_m - self.origin_m[0]) / self.resolution_m).floor();
        let row = ((y_m - self.origin_m[1]) / self.resolution_m).floor();
        let inside =
            column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        inside.then(|| row as usize * self.width + column as usize)
    }

    /// Centre of a cell, metres.
    #[must_use]
    pub fn center(&self, index: usize) -> [f64; 2] {
        let column = index % self.width;
        let row = index / self.width;
        [(column, 0), (row, 1)]
            .map(|(i, axis)| self.origin_m[axis] + (i as f64 + 0.5) * self.resolution_m)
    }

    /// Distance from a cell's centre to its corners, metres.
    #[must_use]
    pub fn half_diagonal_m(&self) -> f64 {
        self.resolution_m * std::f64::consts::FRAC_1_SQRT_2
    }

    /// The eight neighbours of a cell that lie inside the grid.
    pub(super) fn neighbours(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let column = index % self.width;
        let row = index / self.width;
        let width = self.width;
        let height = self.height;
        let rows = row.saturating_sub(1)..=(row + 1).min(height - 1);
        rows.flat_map(move |r| {
            (column.saturating_sub(1)..=(column + 1).min(width - 1)).map(move |c| r * width + c)
        })
        .filter(move |&i| i != index)
    }

    /// The neighbours of a cell above, below, left and right that lie inside the grid.
    pub(super) fn sides(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let column = index % self.width;
        let row = index / self.width;
        let width = self.width;
        let height = self.height;
        [
            (column > 0).then(|| index - 1),
            (column + 1 < width).then(|| index + 1),
            (row > 0).then(|| index - width),
            (row + 1 < height).then(|| index + width),
        ]
        .into_iter()
        .flatten()
    }

    /// Columns and rows of the cells that a rectangle touches, clipped to the grid.
    pub(super) fn range(&self, min_m: [f64; 2], max_m: [f64; 2]) -> [std::ops::Range<usize>; 2] {
        [(0, self.width), (1, self.height)].map(|(axis, cells)| {
            let first = clamped_cell(min_m[axis], self.origin_m[axis], self.resolution_m, cells);
            let last = clamped_cell(max_m[axis], self.origin_m[axis], self.resolution_m, cells);
            if last < 0.0 { 0..0 } else { first.max(0.0) as usize..(last as usize + 1).min(cells) }
        })
    }

    /// Lower and upper y of a row, metres.
    pub(super) fn row_band(&self, row: usize) -> [f64; 2] {
        [row, row + 1].map(|r| self.origin_m[1] + r as f64 * self.resolution_m)
    }
}

/// Cell coordinate of a position along one axis, from -1 (before the grid) to `cells` (behind it).
fn clamped_cell(at: f64, origin_m: f64, resolution_m: f64, cells: usize) -> f64 {
    ((at - origin_m) / resolution_m).floor().clamp(-1.0, cells as f64)
}

fn cells_along(axis: usize, min_m: [f64; 2], max_m: [f64; 2], resolution_m: f64) -> usize {
    ((max_m[axis] - min_m[axis]) / resolution_m).ceil().max(1.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_of_a_cell_has_the_index_of_the_cell_and_points_outside_have_none() {
        let grid = Grid::covering([-1.0, 2.0], [1.0, 3.0], 0.05);
        assert_eq!((grid.width, grid.height), (40, 20));
        for index in [0, 39, 40, 799] {
            let [x, y] = grid.center(index);
            assert_eq!(grid.index(x, y), Some(index));
        }
        assert_eq!(
            (grid.index(-1.01, 2.5), grid.index(0.0, 3.01), grid.index(f64::NAN, 2.5)),
            (None, None, None)
        );
    }

    #[test]
    fn a_corner_cell_has_three_neighbours_and_two_sides() {
        let grid = Grid::covering([0.0; 2], [0.3, 0.3], 0.1);
        assert_eq!(grid.neighbours(0).collect::<Vec<_>>(), [1, 3, 4]);
        assert_eq!(grid.sides(8).collect::<Vec<_>>(), [7, 5]);
        assert_eq!(grid.neighbours(4).count(), 8);
    }
}
