//! Share of the reachable floor that was mapped.

/// A grid of the reachable floor of a simulated home (ground truth), with the cells that were
/// mapped.
#[derive(Debug, Clone)]
pub struct Coverage {
    width: usize,
    height: usize,
    origin_m: [f64; 2],
    resolution_m: f64,
    reachable: Vec<bool>,
    mapped: Vec<bool>,
    reachable_cells: usize,
    mapped_cells: usize,
}

impl Coverage {
    /// A home of which nothing is mapped yet. `reachable` is row-major with `width` cells per row,
    /// and `origin_m` is the outer corner of its first cell in the world. `None` if the sizes do
    /// not match, the resolution is not positive, or no cell is reachable.
    #[must_use]
    pub fn new(
        reachable: Vec<bool>,
        width: usize,
        origin_m: [f64; 2],
        resolution_m: f64,
    ) -> Option<Self> {
        let height = reachable.len().checked_div(width)?;
        let reachable_cells = reachable.iter().filter(|cell| **cell).count();
        let sound = width * height == reachable.len()
            && resolution_m.is_finite()
            && resolution_m > 0.0
            && origin_m.iter().all(|value| value.is_finite())
            && reachable_cells > 0;
        let mapped = vec![false; reachable.len()];
        sound.then_some(Self {
            width,
            height,
            origin_m,
            resolution_m,
            reachable,
            mapped,
            reachable_cells,
            mapped_cells: 0,
        })
    }

    /// Records that a map cell of side `cell_m`, centred at (`x_m`, `y_m`) in the world, became
    /// known. Marks every ground-truth cell whose centre it covers and the cell under its own
    /// centre, so that either grid may be the finer one.
    pub fn mark(&mut self, x_m: f64, y_m: f64, cell_m: f64) {
        if !(x_m.is_finite() && y_m.is_finite() && cell_m.is_finite()) {
            return;
        }
        let column = (x_m - self.origin_m[0]) / self.resolution_m;
        let row = (y_m - self.origin_m[1]) / self.resolution_m;
        let half = cell_m / 2.0 / self.resolution_m;
        self.set(column.floor(), row.floor());
        for v in centres(row, half) {
            for u in centres(column, half) {
                self.set(u as f64, v as f64);
            }
        }
    }

    /// Share of the reachable floor that was mapped, 0 to 1.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.mapped_cells as f64 / self.reachable_cells as f64
    }

    /// Whether a cell of the grid is reachable floor that was mapped.
    #[must_use]
    pub fn is_mapped(&self, index: usize) -> bool {
        self.mapped.get(index).copied().unwrap_or(false)
    }

    /// Number of cells of reachable floor.
    #[must_use]
    pub fn reachable_cells(&self) -> usize {
        self.reachable_cells
    }

    /// Area of the reachable floor, square metres.
    #[must_use]
    pub fn reachable_m2(&self) -> f64 {
        self.reachable_cells as f64 * self.resolution_m * self.resolution_m
    }

    fn set(&mut self, column: f64, row: f64) {
        let inside =
            (0.0..self.width as f64).contains(&column) && (0.0..self.height as f64).contains(&row);
        if !inside {
            return;
        }
        let index = row as usize * self.width + column as usize;
        if self.reachable[index] && !self.mapped[index] {
            self.mapped[index] = true;
            self.mapped_cells += 1;
        }
    }
}

/// Cells whose centres lie within `half` cells of `at`, excluding the upper end.
fn centres(at: f64, half: f64) -> std::ops::Range<i64> {
    (at - half - 0.5).ceil() as i64..(at + half - 0.5).ceil() as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn only_reachable_floor_counts_and_only_once() {
        let mut coverage =
            Coverage::new(vec![true, true, false, true], 2, [-1.0, -1.0], 1.0).unwrap();
        assert!((coverage.reachable_m2() - 3.0).abs() < 1e-12);
        coverage.mark(-0.5, 0.5, 1.0);
        assert_eq!(coverage.share(), 0.0);
        coverage.mark(0.5, 0.5, 1.0);
        coverage.mark(0.5, 0.5, 1.0);
        assert!((coverage.share() - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn outside_the_home_and_nan_change_nothing() {
        let mut coverage = Coverage::new(vec![true; 4], 2, [0.0, 0.0], 1.0).unwrap();
        for (x, y) in [(-0.5, 0.5), (0.5, 2.5), (f64::NAN, 0.5), (f64::INFINITY, 0.5), (1e300, 0.5)]
        {
            coverage.mark(x, y, 1.0);
        }
        assert_eq!(coverage.share(), 0.0);
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        assert!(Coverage::new(vec![true; 5], 2, [0.0, 0.0], 1.0).is_none());
        assert!(Coverage::new(vec![true; 4], 0, [0.0, 0.0], 1.0).is_none());
        assert!(Coverage::new(vec![false; 4], 2, [0.0, 0.0], 1.0).is_none());
        assert!(Coverage::new(vec![true; 4], 2, [0.0, 0.0], 0.0).is_none());
        assert!(Coverage::new(vec![true; 4], 2, [f64::NAN, 0.0], 1.0).is_none());
    }

    proptest! {
        /// Map cells that tile the home cover all of it, for any resolution and offset of the two
        /// grids.
        #[test]
        fn tiles_without_gaps_cover_everything(cell_m in 0.02..0.3f64, offset in 0.0..1.0f64) {
            let mut coverage = Coverage::new(vec![true; 400], 20, [0.0, 0.0], 0.05).unwrap();
            let tiles = (1.0 / cell_m) as i64 + 2;
            for row in -1..tiles {
                for column in -1..tiles {
                    coverage.mark((column as f64 + offset) * cell_m, (row as f64 + offset) * cell_m, cell_m);
                }
            }
            prop_assert!((coverage.share() - 1.0).abs() < 1e-12);
        }

        #[test]
        fn a_cell_of_the_same_size_marks_exactly_one(x in 0.05..0.9f64, y in 0.05..0.9f64) {
            let mut coverage = Coverage::new(vec![true; 400], 20, [0.0, 0.0], 0.05).unwrap();
            coverage.mark(x, y, 0.05);
            prop_assert!((coverage.share() - 1.0 / 400.0).abs() < 1e-12);
        }
    }
}
