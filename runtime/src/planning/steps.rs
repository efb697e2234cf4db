//! Steps between neighbouring cells, and which of them a search has to try.

use super::costmap::{BLOCKED, Costmap, FREE, UNIFORM};

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
pub(super) const STEPS: [(i32, i32); 8] = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

/// All 8 steps, as bits.
pub(super) const ALL: u8 = 0xff;
/// By the step that led into a cell on even ground: the steps worth taking next. Every other neighbour is reached as cheaply
/// from the cell before without this one: directly, or by the same two steps with the diagonal one first. This is the
/// pruning of jump point search (Harabor and Grastien 2011); [`onward`] does the same where weights differ.
pub(super) const NATURAL: [u8; 8] =
    [0b0000_0001, 0b0000_0111, 0b0000_0100, 0b0001_1100, 0b0001_0000, 0b0111_0000, 0b0100_0000, 0b1100_0001];

/// Whether a step leads to a cell that may be entered, and not across the corner of one that may not.
#[inline]
pub(super) fn is_allowed(costmap: &Costmap, index: usize, direction: usize) -> bool {
    let is_open = |direction: usize| {
        let (dx, dy) = STEPS[direction % 8];
        costmap.weights[index.wrapping_add_signed(dx as isize + dy as isize * costmap.stride as isize)] != BLOCKED
    };
    is_open(direction) && (direction.is_multiple_of(2) || (is_open(direction - 1) && is_open(direction + 1)))
}

/// [`NATURAL`] for any ground: by the step that led into a cell, the steps that may be worth taking next. A step is left out if
/// the cell before has a way to the same neighbour within these 3x3 cells that is cheaper; or as cheap with its diagonal step
/// first, so that of equally cheap ways one is left.
pub(super) fn onward(costmap: &Costmap, index: usize, direction: usize) -> u8 {
    let weight = |direction: usize| {
        let (dx, dy) = STEPS[direction % 8];
        let at = index.wrapping_add_signed(dx as isize + dy as isize * costmap.stride as isize);
        u32::from(costmap.weights[at] & !UNIFORM)
    };
    let here = u32::from(costmap.weights[index] & !UNIFORM);
    let mut steps = 1 << direction;
    let mut keep = |direction: usize, worth: bool| steps |= u8::from(worth) << (direction % 8);
    // The same on either side: `turn` counts steps of 45 degrees to the left, or as many to the right.
    for left in [true, false] {
        let turn = |eighths: usize| if left { direction + eighths } else { direction + 8 - eighths };
        let (side, behind) = (weight(turn(2)), weight(turn(3)));
        if direction.is_multiple_of(2) {
            // Against a diagonal step from the cell before to the side, and from there straight on.
            let rival = side != 0 && behind != 0;
            keep(turn(2), !(rival && 5 * side < 12 * here));
            keep(turn(1), side != 0 && !(rival && 17 * side <= 12 * here + 5 * weight(turn(1))));
        } else {
            // Against a straight step from the cell before, which is open if the diagonal one was, and the way on from there.
            let ahead = weight(turn(1));
            keep(turn(1), !(side != 0 && 12 * behind + 5 * ahead < 17 * here));
            keep(turn(2), ahead != 0 && 12 * behind >= 17 * here + 5 * side);
        }
    }
    steps
}
