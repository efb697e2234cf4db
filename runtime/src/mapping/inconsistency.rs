//! Inconsistencies: places where the single-frame maps of two frames disagree.

use super::bits::BitPlane;
use super::components::Components;
use super::{CellBox, CellState, SingleFrameMap};

/// A group of cells that are free in one single-frame map and occupied in the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inconsistency {
    /// Number of cells in the group.
    pub cells: usize,
    /// Centroid of the cells in `odom`, metres. It may lie inside an obstacle.
    pub centroid_m: [f64; 2],
}

/// Compares the maps of two frames. A cell is inconsistent if both maps know it and exactly one
/// calls it occupied ("Embodied Depth Prediction", section III-D). Returns the 8-connected groups
/// of such cells, the largest first; groups of equal size are in row order.
#[must_use]
pub fn inconsistencies(
    now: &SingleFrameMap,
    before: &SingleFrameMap,
    cell_m: f64,
) -> Vec<Inconsistency> {
    let mut cells = Vec::new();
    let mut older = before.cells.iter().peekable();
    for newer in &now.cells {
        while older.next_if(|old| old.cell < newer.cell).is_some() {}
        if let Some(old) = older.next_if(|old| old.cell == newer.cell) {
            let is_occupied = newer.state() == CellState::Occupied;
            let was_occupied = old.state() == CellState::Occupied;
            if is_occupied != was_occupied {
                cells.push(newer.cell);
            }
        }
    }
    let Some(bounds) =
        cells.iter().map(|cell| CellBox::of(*cell)).reduce(|all, one| all.including(one.min))
    else {
        return Vec::new();
    };
    let mut plane = BitPlane::default();
    plane.reset(bounds);
    for cell in cells {
        plane.insert(cell);
    }
    let mut components = Components::default();
    components.find(&plane);
    let groups = components.groups().iter();
    let mut found: Vec<_> = groups
        .map(|group| Inconsistency { cells: group.cells, centroid_m: group.centroid_m(cell_m) })
        .collect();
    // The sort is stable, so groups of equal size stay in the order of their first cells.
    found.sort_by_key(|group| core::cmp::Reverse(group.cells));
    found
}
