//! How often walls above the hits of the scanner are right, around each cell: judged by depth that was seen.
//!
//! Along each of four directions, the cells that were seen vote for or against their wall, the nearer ones with more weight. Where few
//! were seen, the share of the last images counts. In an empty room nearly every cell agrees, behind a table hardly any.

use super::belief::Belief;
use super::walls::Wall;
use crate::snapshot::remembers;

/// A vote counts this much less for each cell of distance.
const FADE: f32 = 0.9;
/// The share of the last images counts as much as one vote next to the cell.
const PRIOR: f32 = 1.0;
/// The share before anything was seen.
const FIRST_SHARE: f32 = 0.7;
/// The share of the last images follows an image with this rate.
const RATE: f32 = 0.05;
/// An image with a smaller share of cells that were seen does not count.
const ENOUGH: f32 = 0.1;
/// Depths within this ratio agree: right as in delta1.
const RATIO: f32 = 1.25;

/// Votes for the wall, and all votes.
#[derive(Debug, Clone, Copy, Default)]
struct Votes {
    agreeing: f32,
    all: f32,
}

impl Votes {
    fn of(wall: &Wall, belief: &Belief, confidence: f32) -> Self {
        if wall.inverse_depth == 0.0 || belief.inverse_depth == 0.0 {
            return Self::default();
        }
        let ratio = wall.inverse_depth / belief.inverse_depth;
        let agrees = ratio < RATIO && ratio > 1.0 / RATIO;
        // Depth that is as likely wrong as right says nothing.
        let weight = (2.0 * confidence - 1.0).max(0.0);
        Self { agreeing: if agrees { weight } else { 0.0 }, all: weight }
    }

    fn add(&mut self, other: Self) {
        self.agreeing += other.agreeing;
        self.all += other.all;
    }
}

/// Measures the agreement around each cell.
#[derive(Debug)]
pub struct WallAgreement {
    /// Share of the cells that agreed in the last images.
    lately: f32,
    votes: Vec<Votes>,
    around: Vec<Votes>,
    shares: Vec<f32>,
}

impl Default for WallAgreement {
    fn default() -> Self {
        Self { lately: FIRST_SHARE, votes: vec![], around: vec![], shares: vec![] }
    }
}

impl WallAgreement {
    /// The share of the cells around each cell whose wall agrees with `seen`, from 0 to 1. All slices are rows of `width` cells; a
    /// cell that was not seen has no inverse depth. The cell itself has no vote.
    pub fn update(
        &mut self,
        walls: &[Wall],
        seen: &[Belief],
        confidence: &[f32],
        width: usize,
    ) -> &[f32] {
        let cells = walls.iter().zip(seen).zip(confidence);
        self.votes.clear();
        self.votes.extend(cells.map(|((wall, belief), p)| Votes::of(wall, belief, *p)));
        self.follow_image();
        self.around.clear();
        self.around.resize(walls.len(), Votes::default());
        for row in 0..walls.len() / width {
            let line = row * width..(row + 1) * width;
            self.collect(line.clone());
            self.collect(line.rev());
        }
        for column in 0..width.min(walls.len()) {
            let line = (column..walls.len()).step_by(width);
            self.collect(line.clone());
            self.collect(line.rev());
        }
        self.shares.clear();
        self.shares.extend(
            self.around
                .iter()
                .map(|votes| (votes.agreeing + PRIOR * self.lately) / (votes.all + PRIOR)),
        );
        &self.shares
    }

    /// The result of the last [`update`](Self::update).
    pub fn last(&self) -> &[f32] {
        &self.shares
    }

    fn follow_image(&mut self) {
        let mut image = Votes::default();
        self.votes.iter().for_each(|votes| image.add(*votes));
        if image.all > ENOUGH * self.votes.len() as f32 {
            self.lately += RATE * (image.agreeing / image.all - self.lately);
        }
    }

    fn collect(&mut self, line: impl Iterator<Item = usize>) {
        let mut passed = Votes::default();
        for cell in line {
            self.around[cell].add(passed);
            passed.agreeing *= FADE;
            passed.all *= FADE;
            passed.add(self.votes[cell]);
        }
    }
}

remembers!(WallAgreement: lately);

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 30;
    const HEIGHT: usize = 12;

    fn walls() -> Vec<Wall> {
        vec![Wall { inverse_depth: 0.5, is_floor: false }; WIDTH * HEIGHT]
    }

    /// Cells with the inverse depth that `of` gives for their column.
    fn seen(of: impl Fn(usize) -> f32) -> Vec<Belief> {
        let cells = (0..WIDTH * HEIGHT)
            .map(|cell| Belief { inverse_depth: of(cell % WIDTH), ..Belief::default() });
        cells.collect()
    }

    #[test]
    fn walls_that_were_seen_to_stand_there_are_likely_and_walls_behind_furniture_are_not() {
        let mut agreement = WallAgreement::default();
        let confidence = [0.9; WIDTH * HEIGHT];
        let shares = agreement.update(
            &walls(),
            &seen(|column| if column < 15 { 0.52 } else { 1.1 }),
            &confidence,
            WIDTH,
        );
        assert!(shares[2] > 0.8 && shares[28] < 0.3, "{} {}", shares[2], shares[28]);
        assert!(shares[2] > shares[13], "near the furniture less than far from it");
    }

    #[test]
    fn where_nothing_was_seen_the_last_images_count() {
        let mut agreement = WallAgreement::default();
        let nothing = seen(|_| 0.0);
        let none = [0.0; WIDTH * HEIGHT];
        assert_eq!(agreement.update(&walls(), &nothing, &none, WIDTH)[40], FIRST_SHARE);
        for _ in 0..100 {
            agreement.update(&walls(), &seen(|_| 2.0), &[0.9; WIDTH * HEIGHT], WIDTH);
        }
        let share = agreement.update(&walls(), &nothing, &none, WIDTH)[40];
        assert!(share < 0.05, "{share}");
    }

    #[test]
    fn a_cell_has_no_vote_about_itself() {
        let mut agreement = WallAgreement::default();
        let lonely = seen(|_| 0.0)
            .into_iter()
            .enumerate()
            .map(|(cell, belief)| match cell {
                100 => Belief { inverse_depth: 2.0, ..Belief::default() },
                _ => belief,
            })
            .collect::<Vec<_>>();
        let shares = agreement.update(&walls(), &lonely, &[0.9; WIDTH * HEIGHT], WIDTH);
        assert_eq!(shares[100], FIRST_SHARE);
        assert!(shares[101] < FIRST_SHARE);
    }

    #[test]
    fn an_image_without_walls_has_no_shares() {
        let mut agreement = WallAgreement::default();
        assert!(agreement.update(&[], &seen(|_| 1.0), &[0.9; WIDTH * HEIGHT], WIDTH).is_empty());
    }
}
