//! The cells of the occupancy grid.

use serde::{Deserialize, Serialize};

/// A square of the `odom` plane: column `x` covers `[x, x + 1) * cell_m`, row `y` likewise. Indices
/// are absolute, so a cell keeps its index when the map window moves with the robot.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize,
)]
pub struct Cell {
    /// Row. It is the first field so that cells sort row by row.
    pub y: i32,
    /// Column of the cell.
    pub x: i32,
}

impl Cell {
    /// The cell in column `x`, row `y`.
    #[must_use]
    pub const fn new(x: i32, y: i32) -> Self {
        Self { y, x }
    }

    /// The cell that contains a point, metres. The caller must refuse points that are not finite or
    /// out of reach; here they saturate.
    #[must_use]
    pub fn containing(x_m: f64, y_m: f64, cell_m: f64) -> Self {
        Self::new((x_m / cell_m).floor() as i32, (y_m / cell_m).floor() as i32)
    }

    /// The centre of the cell, metres.
    #[must_use]
    pub fn center_m(self, cell_m: f64) -> [f64; 2] {
        [(f64::from(self.x) + 0.5) * cell_m, (f64::from(self.y) + 0.5) * cell_m]
    }

    /// The cell at an offset of `dx` columns and `dy` rows.
    #[must_use]
    pub const fn offset(self, dx: i32, dy: i32) -> Self {
        Self { y: self.y.saturating_add(dy), x: self.x.saturating_add(dx) }
    }

    /// Squared distance between the centres of two cells, in cells.
    #[must_use]
    pub fn distance2(self, other: Self) -> i64 {
        let dx = i64::from(self.x) - i64::from(other.x);
        let dy = i64::from(self.y) - i64::from(other.y);
        dx * dx + dy * dy
    }
}

/// Occupancy of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CellState {
    /// The cell was never observed, or is outside the map window: its log-odds are exactly 0.
    Unknown,
    /// The cell is free: its log-odds are below 0.
    Free,
    /// The cell is occupied: its log-odds are above 0.
    Occupied,
}

impl CellState {
    /// The state that corresponds to a log-odds value.
    #[must_use]
    pub fn of(log_odds: f32) -> Self {
        if log_odds > 0.0 {
            Self::Occupied
        } else if log_odds < 0.0 {
            Self::Free
        } else {
            Self::Unknown
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_left_of_zero_are_in_negative_cells() {
        assert_eq!(Cell::containing(-0.001, 0.031, 0.03), Cell::new(-1, 1));
        assert_eq!(Cell::containing(0.0, 0.0, 0.03), Cell::new(0, 0));
    }

    #[test]
    fn the_centre_of_a_cell_is_in_the_cell() {
        for cell in [Cell::new(-7, 12), Cell::new(0, -1), Cell::new(499, 500)] {
            let [x_m, y_m] = cell.center_m(0.03);
            assert_eq!(Cell::containing(x_m, y_m, 0.03), cell);
        }
    }

    #[test]
    fn only_exactly_zero_is_unknown() {
        assert_eq!(CellState::of(0.0), CellState::Unknown);
        assert_eq!(CellState::of(1e-30), CellState::Occupied);
        assert_eq!(CellState::of(-1e-30), CellState::Free);
    }
}
