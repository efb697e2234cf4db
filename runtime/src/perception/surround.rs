//! How far the neighbours of a belief support it.
//!
//! Where a surface has no texture, aggregation propagates one depth far, frame after frame: such votes agree with each other
//! because they all have the same origin. Their neighbourhood shows it: low confidence, and jumps where two such depths meet.

use multiversion::multiversion;

use super::belief::{AGREEMENT, Belief};

/// Cells to each side that are averaged.
const REACH: usize = 3;
/// Cells along one side of the square that is averaged.
const SIDE: usize = 2 * REACH + 1;
/// Number of agreeing neighbours, of eight, that is enough: a cell at a straight edge of its surface has five neighbours on
/// the same surface, one at a corner three, and edges of obstacles are what a map needs most.
const ENOUGH: f32 = 4.0;

/// The neighbourhood of a belief. Beyond the edge of the image, the last cells are repeated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surround {
    /// Mean over the 7x7 cells around it (and itself) of the mean confidence of their votes, 0 to 1; cells without a belief
    /// count as 0.
    pub confidence: f32,
    /// Number of its eight neighbours that agree with it, as a share of four, at most 1; cells without a belief do not agree.
    pub agreeing: f32,
}

/// Computes the neighbourhoods of all beliefs; keeps its buffers from frame to frame.
#[derive(Debug, Default)]
pub struct Surroundings {
    /// Rows of inverse depths, 0 where there is no belief, with [`REACH`] more cells on both sides.
    inverse_depth: Vec<f32>,
    /// Rows of mean confidence in the same layout.
    confidence: Vec<f32>,
    /// Sums of confidence along rows.
    along: Vec<f32>,
    all: Vec<Surround>,
}

impl Surroundings {
    /// Computes the neighbourhood of every one of `beliefs`, rows of `width` cells.
    pub fn update(&mut self, beliefs: &[Belief], width: usize) -> &[Surround] {
        let height = beliefs.len() / width;
        let wide = width + 2 * REACH;
        self.inverse_depth.resize(height * wide, 0.0);
        self.confidence.resize(height * wide, 0.0);
        self.along.resize(height * width, 0.0);
        self.all.resize(height * width, Surround::default());
        for (row, beliefs) in beliefs.chunks_exact(width).enumerate() {
            let row_of = row * wide..(row + 1) * wide;
            spread(
                beliefs,
                &mut self.inverse_depth[row_of.clone()],
                &mut self.confidence[row_of.clone()],
            );
            sum_along(&self.confidence[row_of], &mut self.along[row * width..(row + 1) * width]);
        }
        for (row, all) in self.all.chunks_exact_mut(width).enumerate() {
            let sums = std::array::from_fn(|i| {
                let row = (row + i).saturating_sub(REACH).min(height - 1);
                &self.along[row * width..][..width]
            });
            average(sums, all);
            let depths = std::array::from_fn(|i| {
                let row = (row + i).saturating_sub(1).min(height - 1);
                &self.inverse_depth[row * wide..][REACH - 1..=width + REACH]
            });
            agree(depths, all);
        }
        &self.all
    }

    /// The result of the last [`update`](Self::update).
    pub fn last(&self) -> &[Surround] {
        &self.all
    }
}

/// Writes one row with its ends repeated.
fn spread(beliefs: &[Belief], inverse_depth: &mut [f32], confidence: &mut [f32]) {
    for at in 0..inverse_depth.len() {
        let belief = &beliefs[at.saturating_sub(REACH).min(beliefs.len() - 1)];
        inverse_depth[at] = if belief.evidence > 0.0 { belief.inverse_depth } else { 0.0 };
        confidence[at] = belief.mean_confidence();
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn sum_along(confidence: &[f32], sums: &mut [f32]) {
    for (sum, confidence) in sums.iter_mut().zip(confidence.windows(SIDE)) {
        *sum = 0.0;
        for confidence in confidence {
            *sum += confidence;
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
        around.confidence = sum / (SIDE * SIDE) as f32;
    }
}

/// Counts agreeing neighbours. `rows` begin one cell before and end one cell after the row.
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
        // The cell itself was counted, too.
        around.agreeing = ((agreeing - 1.0) / ENOUGH).min(1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 9;

    fn believed(inverse_depth: f32, confidence: f32) -> Belief {
        Belief { inverse_depth, evidence: 2.0 * confidence, votes: 2.0, offset: [0.0; 2] }
    }

    fn at(row: usize, column: usize) -> usize {
        row * WIDTH + column
    }

    #[test]
    fn a_wall_agrees_with_itself_up_to_the_edges() {
        let beliefs = vec![believed(0.5, 0.75); WIDTH * 8];
        let mut surroundings = Surroundings::default();
        for around in surroundings.update(&beliefs, WIDTH) {
            assert!(
                (around.confidence - 0.75).abs() < 1e-6 && around.agreeing == 1.0,
                "{around:?}"
            );
        }
    }

    #[test]
    fn the_edge_of_a_step_agrees_fully_a_post_by_half_and_a_single_belief_not_at_all() {
        let mut beliefs: Vec<Belief> =
            (0..WIDTH * 8).map(|i| believed(if i % WIDTH < 4 { 0.5 } else { 1.0 }, 0.5)).collect();
        beliefs[at(4, 7)] = believed(0.2, 0.5);
        (0..8).for_each(|row| beliefs[at(row, 1)] = believed(2.0, 0.5));
        let mut surroundings = Surroundings::default();
        let around = surroundings.update(&beliefs, WIDTH);
        assert_eq!(around[at(4, 4)].agreeing, 1.0);
        assert_eq!(around[at(4, 1)].agreeing, 0.5);
        assert_eq!(around[at(4, 7)].agreeing, 0.0);
    }

    #[test]
    fn confidence_is_averaged_over_seven_by_seven_cells() {
        let mut beliefs = vec![Belief::default(); WIDTH * 9];
        beliefs[at(4, 4)] = believed(0.5, 0.98);
        let mut surroundings = Surroundings::default();
        for (index, around) in surroundings.update(&beliefs, WIDTH).iter().enumerate() {
            let near = (index / WIDTH).abs_diff(4) <= REACH && (index % WIDTH).abs_diff(4) <= REACH;
            let want = if near { 0.02 } else { 0.0 };
            assert!((around.confidence - want).abs() < 1e-6, "cell {index}: {around:?}");
        }
    }

    #[test]
    fn nothing_of_the_last_frame_is_left() {
        let mut surroundings = Surroundings::default();
        surroundings.update(&vec![believed(0.5, 0.9); WIDTH * 8], WIDTH);
        let empty = surroundings.update(&vec![Belief::default(); WIDTH * 8], WIDTH);
        assert!(empty.iter().all(|around| around.confidence == 0.0));
    }
}
