//! Steps between neighbouring cells, and the pruning rules that decide which of them a search has
//! to try.

use super::costmap::{BLOCKED, Costmap, FREE, WEIGHT};

/// Cost of a step along a row or column, for weight 1/[`FREE`]. 17/12 is the square root of 2
/// within 0.2 %.
pub(super) const STRAIGHT: u32 = 12;
/// Cost of a diagonal step.
pub(super) const DIAGONAL: u32 = 17;
/// Cost of a straight step on free floor.
pub(super) const FREE_STEP: u32 = STRAIGHT * FREE as u32;
pub(super) const FREE_DIAGONAL: u32 = DIAGONAL * FREE as u32;
/// The value for the start cell, which was not entered by a step.
pub(super) const NO_STEP: u8 = 8;
/// Steps as (column, row), counter-clockwise from +x in eighths of a rotation: even ones are
/// straight, odd ones diagonal.
pub(super) const STEPS: [(i32, i32); 8] =
    [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

/// For each step that leads into a cell on level ground, the set of natural successor steps. Every
/// other neighbour can be reached at the same cost from the previous cell without this cell:
/// directly, or by the same two steps with the diagonal one first. This is the pruning rule of jump
/// point search (Harabor and Grastien 2011). [`successors`] applies it where weights differ.
pub(super) const NATURAL: [u8; 8] = [
    0b0000_0001,
    0b0000_0111,
    0b0000_0100,
    0b0001_1100,
    0b0001_0000,
    0b0111_0000,
    0b0100_0000,
    0b1100_0001,
];

/// The set of steps that lead to a passable cell and do not cross the corner of a blocked one.
pub(super) fn passable_steps(costmap: &Costmap, index: usize) -> u8 {
    let neighbours = neighbours(costmap, index);
    (0..8).fold(0, |steps, direction| {
        steps | u8::from(is_passable_step(neighbours, direction)) << direction
    })
}

fn is_passable_step(neighbours: u64, direction: usize) -> bool {
    let is_straight = direction.is_multiple_of(2);
    is_open(neighbours, direction)
        && (is_straight
            || (is_open(neighbours, direction + 7) && is_open(neighbours, direction + 1)))
}

fn is_open(neighbours: u64, direction: usize) -> bool {
    weight(neighbours, direction % 8) != 0
}

/// [`NATURAL`] for arbitrary weights: for the step that leads into a cell, the set of allowed steps
/// that may be part of a cheapest path. A step is left out if, within these 3x3 cells, the previous
/// cell has a cheaper path to the same neighbour, or an equally cheap one that takes its diagonal
/// step first. So one of several equally cheap paths always remains.
#[inline(never)]
pub(super) fn successors(costmap: &Costmap, index: usize, direction: usize) -> u8 {
    let here = u32::from(costmap.weights[index] & WEIGHT);
    // Rotated so that the step ahead comes first. To its left are the steps 1, 2 and 3, to its
    // right 7, 6 and 5.
    let neighbours = neighbours(costmap, index).rotate_right(8 * direction as u32);
    let left = [1, 2, 3].map(|eighths| weight(neighbours, eighths));
    let right = [7, 6, 5].map(|eighths| weight(neighbours, eighths));
    let ahead = weight(neighbours, 0) != 0;
    let steps = if direction.is_multiple_of(2) {
        bits(ahead, after_straight(here, ahead, left), after_straight(here, ahead, right))
    } else {
        let ahead = ahead & (left[0] != 0) & (right[0] != 0);
        bits(ahead, after_diagonal(here, left), after_diagonal(here, right))
    };
    steps.rotate_left(direction as u32)
}

/// The weights of the 8 neighbours in the order of [`STEPS`], one byte each.
#[inline]
fn neighbours(costmap: &Costmap, index: usize) -> u64 {
    let [a, b, c] = three_weights(costmap, index - costmap.stride);
    let [d, _, e] = three_weights(costmap, index);
    let [f, g, h] = three_weights(costmap, index + costmap.stride);
    let all = e | h << 8 | g << 16 | f << 24 | d << 32 | a << 40 | b << 48 | c << 56;
    all & u64::from_le_bytes([WEIGHT; 8])
}

/// The weights of a cell and its left and right neighbour, from left to right.
#[inline]
fn three_weights(costmap: &Costmap, middle: usize) -> [u64; 3] {
    let weights = *costmap.weights[middle - 1..].first_chunk().unwrap_or(&[BLOCKED; 3]);
    weights.map(u64::from)
}

/// The weight of the neighbour that lies this many eighths of a rotation to the left of the first
/// one.
#[inline]
fn weight(neighbours: u64, eighths: usize) -> u32 {
    (neighbours >> (8 * eighths)) as u32 & 0xff
}

/// The set of steps made of the step ahead and the steps at 1 and 2 eighths of a rotation to either
/// side.
#[inline]
fn bits(ahead: bool, left: [bool; 2], right: [bool; 2]) -> u8 {
    let steps = [(ahead, 0), (left[0], 1), (left[1], 2), (right[0], 7), (right[1], 6)];
    steps.into_iter().fold(0, |set, (is_in_set, eighths)| set | u8::from(is_in_set) << eighths)
}

/// Which of the steps at 1 and 2 eighths to one side are successors of a straight step. The
/// alternative is a diagonal step from the previous cell to the side, and from there straight on.
/// This function and the next have no branches, because the outcome is hard to predict.
#[inline]
fn after_straight(here: u32, ahead: bool, [beyond, side, behind]: [u32; 3]) -> [bool; 2] {
    let alternative = behind != 0;
    let diagonal = ahead & (beyond != 0) & !(alternative & (17 * side <= 12 * here + 5 * beyond));
    let sideways = !(alternative & (5 * side < 12 * here));
    [(side != 0) & diagonal, (side != 0) & sideways]
}

/// The same for the successors of a diagonal step. The alternative is a straight step from the
/// previous cell, which is passable if the diagonal step was, and a second step from there.
#[inline]
fn after_diagonal(here: u32, [next, side, behind]: [u32; 3]) -> [bool; 2] {
    let straight = !((side != 0) & (12 * behind + 5 * next < 17 * here));
    let back = (side != 0) & (12 * behind >= 17 * here + 5 * side);
    [(next != 0) & straight, (next != 0) & back]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{Cell, CellBox};
    use crate::planning::costmap::LEVEL;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn on_level_ground_the_successors_are_the_natural_ones() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(2, 2) };
        let mut seen = [0; 4];
        for _ in 0..20_000 {
            // Few different values, repeated along rows or columns, make level ground frequent.
            let values: [Option<f64>; 9] = core::array::from_fn(|_| {
                [None, Some(1.0), Some(1.0), Some(2.0)][random.random_range(0..4)]
            });
            let along = random.random_bool(0.8);
            let rows = random.random_bool(0.5);
            let costmap = Costmap::from_weights(cells, 1.0, |cell| {
                let at = if rows { (cell.y, cell.x) } else { (cell.x, cell.y) };
                values[(at.0 * 3 + if along { 0 } else { at.1 }) as usize]
            });
            let Some(index) = costmap.index(Cell::new(1, 1)) else { unreachable!() };
            let marks = costmap.weights[index];
            for (direction, natural) in
                NATURAL.into_iter().enumerate().filter(|_| marks & WEIGHT != 0)
            {
                let axis = LEVEL[direction / 2 % 2];
                let required = if direction % 2 == 0 { axis } else { LEVEL[0] | LEVEL[1] };
                if marks & required == required {
                    assert_eq!(
                        successors(&costmap, index, direction),
                        natural,
                        "{values:?} {direction}"
                    );
                }
            }
            seen[usize::from(marks >> 6)] += 1;
        }
        assert!(seen.iter().all(|count| *count > 300), "{seen:?}");
    }
}
