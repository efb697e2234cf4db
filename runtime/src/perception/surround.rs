//! What the neighbours of a belief say about it.
//!
//! Where a surface has no texture, aggregation carries one depth far, picture after picture: such votes agree with each other
//! because they all came from one place. What gives them away is around them: little trust, and jumps where two such depths
//! meet.

use multiversion::multiversion;

use super::belief::{AGREEMENT, Belief};

/// Cells to each side whose trust counts.
const REACH: usize = 3;
/// Cells along one side of the square whose trust counts.
const SIDE: usize = 2 * REACH + 1;
/// So many of the eight neighbours are enough: what ends at a straight edge has five of its own kind, at a corner three, and
/// edges of what stands in the way are what a map needs most.
const ENOUGH: f32 = 4.0;

/// What stands around a belief. At the edge of the picture the last cells stand for those beyond.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surround {
    /// Mean over the 7x7 cells around it, itself too, of the mean trust of their votes, 0 to 1; where nothing is believed, 0.
    pub trust: f32,
    /// How many of its eight neighbours agree with it, as a share of four, at most 1; those of whom nothing is believed do not.
    pub agreeing: f32,
}

/// Looks around beliefs; its memory is kept from picture to picture.
#[derive(Debug, Default)]
pub struct Surroundings {
    /// Rows of inverse depths, 0 where nothing is believed, with [`REACH`] more cells on both sides.
    inverse_depth: Vec<f32>,
    /// The same of mean trust.
    trust: Vec<f32>,
    /// Sums of trust along rows.
    along: Vec<f32>,
    all: Vec<Surround>,
}

impl Surroundings {
    /// What stands around every one of `beliefs`, rows of `width` cells.
    pub fn look(&mut self, beliefs: &[Belief], width: usize) -> &[Surround] {
        let (height, wide) = (beliefs.len() / width, width + 2 * REACH);
        self.inverse_depth.resize(height * wide, 0.0);
        self.trust.resize(height * wide, 0.0);
        self.along.resize(height * width, 0.0);
        self.all.resize(height * width, Surround::default());
        for (row, beliefs) in beliefs.chunks_exact(width).enumerate() {
            let row_of = row * wide..(row + 1) * wide;
            spread(
                beliefs,
                &mut self.inverse_depth[row_of.clone()],
                &mut self.trust[row_of.clone()],
            );
            sum_along(&self.trust[row_of], &mut self.along[row * width..(row + 1) * width]);
        }
        for (row, all) in self.all.chunks_exact_mut(width).enumerate() {
            let clamped =
                |offset: usize, reach: usize| (row + offset).saturating_sub(reach).min(height - 1);
            let sums = std::array::from_fn(|i| &self.along[clamped(i, REACH) * width..][..width]);
            average(sums, all);
            let depths = std::array::from_fn(|i| {
                &self.inverse_depth[clamped(i, 1) * wide..][REACH - 1..=width + REACH]
            });
            agree(depths, all);
        }
        &self.all
    }

    /// What the last [`look`](Self::look) found.
    pub fn last(&self) -> &[Surround] {
        &self.all
    }
}

/// Writes one row and repeats its ends.
fn spread(beliefs: &[Belief], inverse_depth: &mut [f32], trust: &mut [f32]) {
    for at in 0..inverse_depth.len() {
        let belief = &beliefs[at.saturating_sub(REACH).min(beliefs.len() - 1)];
        inverse_depth[at] = if belief.evidence > 0.0 { belief.inverse_depth } else { 0.0 };
        trust[at] = belief.mean_trust();
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn sum_along(trust: &[f32], sums: &mut [f32]) {
    for (sum, trust) in sums.iter_mut().zip(trust.windows(SIDE)) {
        *sum = 0.0;
        for trust in trust {
            *sum += trust;
        }
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn average(rows: [&[f32]; SIDE], all: &mut [Surround]) {
    for (at, around) in all.iter_mut().enumerate() {
        let mut sum = 0.0;
        for row in rows {
            sum += row[at];
        }
        around.trust = sum / (SIDE * SIDE) as f32;
    }
}

/// `rows` begin one cell before and end one after.
#[multiversion(targets("x86_64+avx2"))]
fn agree(rows: [&[f32]; 3], all: &mut [Surround]) {
    for (at, around) in all.iter_mut().enumerate() {
        let here = rows[1][at + 1];
        let mut agreeing = 0.0;
        for row in rows {
            for there in &row[at..at + 3] {
                let agrees = (there - here).abs() <= AGREEMENT * here.max(*there);
                agreeing += if agrees { 1.0 } else { 0.0 };
            }
        }
        // It agrees with itself.
        around.agreeing = ((agreeing - 1.0) / ENOUGH).min(1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 9;

    fn believed(inverse_depth: f32, trust: f32) -> Belief {
        Belief { inverse_depth, evidence: 2.0 * trust, votes: 2.0, offset: [0.0; 2] }
    }

    fn at(row: usize, column: usize) -> usize {
        row * WIDTH + column
    }

    #[test]
    fn a_wall_agrees_with_itself_up_to_the_edges() {
        let beliefs = vec![believed(0.5, 0.75); WIDTH * 8];
        let mut surroundings = Surroundings::default();
        for around in surroundings.look(&beliefs, WIDTH) {
            assert!((around.trust - 0.75).abs() < 1e-6 && around.agreeing == 1.0, "{around:?}");
        }
    }

    #[test]
    fn the_edge_of_a_step_is_as_good_as_its_middle_a_post_half_as_good_and_a_lonely_belief_has_nobody()
     {
        let mut beliefs: Vec<Belief> =
            (0..WIDTH * 8).map(|i| believed(if i % WIDTH < 4 { 0.5 } else { 1.0 }, 0.5)).collect();
        beliefs[at(4, 7)] = believed(0.2, 0.5);
        (0..8).for_each(|row| beliefs[at(row, 1)] = believed(2.0, 0.5));
        let mut surroundings = Surroundings::default();
        let around = surroundings.look(&beliefs, WIDTH);
        assert_eq!(around[at(4, 4)].agreeing, 1.0);
        assert_eq!(around[at(4, 1)].agreeing, 0.5);
        assert_eq!(around[at(4, 7)].agreeing, 0.0);
    }

    #[test]
    fn trust_is_that_of_seven_by_seven_cells() {
        let mut beliefs = vec![Belief::default(); WIDTH * 9];
        beliefs[at(4, 4)] = believed(0.5, 0.98);
        let mut surroundings = Surroundings::default();
        for (index, around) in surroundings.look(&beliefs, WIDTH).iter().enumerate() {
            let near = (index / WIDTH).abs_diff(4) <= REACH && (index % WIDTH).abs_diff(4) <= REACH;
            let want = if near { 0.02 } else { 0.0 };
            assert!((around.trust - want).abs() < 1e-6, "cell {index}: {around:?}");
        }
    }

    #[test]
    fn nothing_of_the_last_picture_is_left() {
        let mut surroundings = Surroundings::default();
        surroundings.look(&vec![believed(0.5, 0.9); WIDTH * 8], WIDTH);
        let empty = surroundings.look(&vec![Belief::default(); WIDTH * 8], WIDTH);
        assert!(empty.iter().all(|around| around.trust == 0.0));
    }
}
