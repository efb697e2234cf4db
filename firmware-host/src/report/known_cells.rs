//! The known part of an occupancy grid, as a rectangle of cell states.

use runtime::mapping::{Cell, CellState, OccupancyGrid};

use super::map_image::Cells;

/// The smallest rectangle with all known cells. Row 0 has the lowest y, column 0 the lowest x.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownCells {
    /// Number of columns.
    pub width: usize,
    /// States of the cells, in row-major order.
    pub cells: Vec<CellState>,
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Outer corner of the first cell in `map`, metres.
    pub origin_m: [f64; 2],
}

impl KnownCells {
    /// The known cells of a map; `None` if there are none.
    #[must_use]
    pub fn of(map: &OccupancyGrid) -> Option<Self> {
        let known = map.known_box()?;
        let rows = known.min.y..=known.max.y;
        let resolution_m = map.cell_m();
        // Rounded to micrometres: -167 * 0.03 is -5.01, without the last digits of a product of floats.
        let origin_m = [known.min.x, known.min.y]
            .map(|cell| (f64::from(cell) * resolution_m * 1e6).round() / 1e6);
        Some(Self {
            width: known.width(),
            cells: rows
                .flat_map(|y| (known.min.x..=known.max.x).map(move |x| map.state(Cell::new(x, y))))
                .collect(),
            resolution_m,
            origin_m,
        })
    }

    /// Number of rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.cells.len() / self.width
    }

    /// Area of the free cells, square metres.
    #[must_use]
    pub fn free_m2(&self) -> f64 {
        let free = self.cells.iter().filter(|cell| **cell == CellState::Free).count();
        free as f64 * self.resolution_m * self.resolution_m
    }

    /// The cells as plots take them.
    #[must_use]
    pub fn as_cells(&self) -> Cells<'_, CellState> {
        let Self { width, cells, resolution_m, origin_m } = self;
        Cells { width: *width, cells, resolution_m: *resolution_m, origin_m: *origin_m }
    }
}
