//! Where two looks at the same place disagree.

use super::bits::BitPlane;
use super::components::Components;
use super::{CellBox, CellState, SingleFrameMap};

/// A group of cells that one look calls free and another occupied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inconsistency {
    /// Number of cells.
    pub cells: usize,
    /// Their centroid in `odom`, metres. May lie in an obstacle.
    pub centroid_m: [f64; 2],
}

/// Compares two pictures' maps: a cell is inconsistent if both know it and only one calls it occupied ("Embodied Depth
/// Prediction", section III-D). 8-connected groups, the largest first; of equal ones, the first row by row.
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
            let occupied = |state| state == CellState::Occupied;
            if occupied(newer.state()) != occupied(old.state()) {
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
    // Stable: groups of equal size stay in the order of their first cells.
    found.sort_by_key(|group| core::cmp::Reverse(group.cells));
    found
}
