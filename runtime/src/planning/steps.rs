//! Steps between neighbouring cells, and which of them a search has to try.

use super::costmap::{BLOCKED, Costmap, FREE, WEIGHT};

/// Cost of a step along a row or column, for weight 1/[`FREE`]. 17/12 is the square root of 2 within 0.2 %.
pub(super) const STRAIGHT: u32 = 12;
/// Cost of a diagonal step.
pub(super) const DIAGONAL: u32 = 17;
/// Cost of a straight step on free floor.
pub(super) const FREE_STEP: u32 = STRAIGHT * FREE as u32;
pub(super) const FREE_DIAGONAL: u32 = DIAGONAL * FREE as u32;
/// No step led here: the start.
pub(super) const NO_STEP: u8 = 8;
/// Steps by column and row: even ones are straight, odd ones lie between their neighbours in this list.
pub(super) const STEPS: [(i32, i32); 8] =
    [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

/// By the step that led into a cell on level ground: the steps worth taking next. Every other neighbour is reached as cheaply
/// from the cell before without this one: directly, or by the same two steps with the diagonal one first. This is the
/// pruning of jump point search (Harabor and Grastien 2011); [`onward`] does the same where weights differ.
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

/// The steps that lead to a cell that may be entered, and not across the corner of one that may not.
pub(super) fn all_allowed(costmap: &Costmap, index: usize) -> u8 {
    let around = around(costmap, index);
    let is_open = |direction: usize| weight(around, direction % 8) != 0;
    let is_allowed = |direction: usize| {
        is_open(direction)
            && (direction.is_multiple_of(2) || (is_open(direction + 7) && is_open(direction + 1)))
    };
    (0..8).fold(0, |steps, direction| steps | u8::from(is_allowed(direction)) << direction)
}

/// [`NATURAL`] for any ground: by the step that led into a cell, the steps that are allowed and may be worth taking next. A
/// step is left out if the cell before has a way to the same neighbour within these 3x3 cells that is cheaper; or as cheap with
/// its diagonal step first, so that of equally cheap ways one is left.
#[inline(never)]
pub(super) fn onward(costmap: &Costmap, index: usize, direction: usize) -> u8 {
    let here = u32::from(costmap.weights[index] & WEIGHT);
    // Turned so that ahead comes first: left of it are 1, 2, 3 eighths of a turn, right of it 7, 6, 5.
    let around = around(costmap, index).rotate_right(8 * direction as u32);
    let (left, right) =
        ([1, 2, 3].map(|turn| weight(around, turn)), [7, 6, 5].map(|turn| weight(around, turn)));
    let ahead = weight(around, 0) != 0;
    let steps = if direction.is_multiple_of(2) {
        bits(ahead, after_straight(here, ahead, left), after_straight(here, ahead, right))
    } else {
        let ahead = ahead & (left[0] != 0) & (right[0] != 0);
        bits(ahead, after_diagonal(here, left), after_diagonal(here, right))
    };
    steps.rotate_left(direction as u32)
}

/// The weights of the 8 neighbours in the order of [`STEPS`], a byte each.
#[inline]
fn around(costmap: &Costmap, index: usize) -> u64 {
    let row = |middle: usize| {
        let [a, b, c] = *costmap.weights[middle - 1..].first_chunk().unwrap_or(&[BLOCKED; 3]);
        (u64::from(a), u64::from(b), u64::from(c))
    };
    let ((a, b, c), (d, _, e), (f, g, h)) =
        (row(index - costmap.stride), row(index), row(index + costmap.stride));
    let all = e | h << 8 | g << 16 | f << 24 | d << 32 | a << 40 | b << 48 | c << 56;
    all & u64::from_le_bytes([WEIGHT; 8])
}

#[inline]
fn weight(around: u64, turn: usize) -> u32 {
    (around >> (8 * turn)) as u32 & 0xff
}

/// A set of steps ahead and by 1 and 2 eighths of a turn to either side.
#[inline]
fn bits(ahead: bool, left: [bool; 2], right: [bool; 2]) -> u8 {
    let ways = [(ahead, 0), (left[0], 1), (left[1], 2), (right[0], 7), (right[1], 6)];
    ways.into_iter().fold(0, |steps, (way, turn)| steps | u8::from(way) << turn)
}

/// Which turns by 1 and 2 eighths to one side are worth taking after a straight step: against a diagonal step from the cell
/// before to the side, and from there straight on. No branches here and below: what comes next is hard to predict.
#[inline]
fn after_straight(here: u32, ahead: bool, [beyond, side, behind]: [u32; 3]) -> [bool; 2] {
    let rival = behind != 0;
    let diagonal = ahead & (beyond != 0) & !(rival & (17 * side <= 12 * here + 5 * beyond));
    let sideways = !(rival & (5 * side < 12 * here));
    [(side != 0) & diagonal, (side != 0) & sideways]
}

/// The same after a diagonal step: against a straight step from the cell before, which is open if the diagonal one was, and
/// the way on from there.
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
    fn level_ground_is_where_a_robot_goes_straight_on() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(2, 2) };
        let mut seen = [0; 4];
        for _ in 0..20_000 {
            // Few values in rows or columns, so that level ground is frequent.
            let values: [Option<f64>; 9] = core::array::from_fn(|_| {
                [None, Some(1.0), Some(1.0), Some(2.0)][random.random_range(0..4)]
            });
            let (along, rows) = (random.random_bool(0.8), random.random_bool(0.5));
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
                let wanted = if direction % 2 == 0 { axis } else { LEVEL[0] | LEVEL[1] };
                if marks & wanted == wanted {
                    assert_eq!(
                        onward(&costmap, index, direction),
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
