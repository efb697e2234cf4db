//! From cells to pixels: smooth where the cells around a pixel agree, along the edges of the picture where they do not.

use rayon::prelude::*;

use super::DepthEstimate;
use super::fusion::Belief;
use super::sweep::CELL;

/// Cells agree when their inverse depths differ by less than this share: one surface, not two.
const ONE_SURFACE: f32 = 0.15;
/// A cell that is one cell farther from the pixel must resemble it by so much more, 256 to a grey level.
const FARTHER: f32 = 2048.0;

/// What is known of the cells.
#[derive(Debug, Clone, Copy)]
pub struct Cells<'a> {
    /// Columns.
    pub width: usize,
    /// Row-major.
    pub beliefs: &'a [Belief],
    /// Probability that each belief is right.
    pub confidence: &'a [f32],
    /// Grey value of each cell, 256 to a grey level.
    pub grey: &'a [u16],
    /// Beliefs below this probability are none.
    pub min_confidence: f32,
}

/// One of the four cells around a pixel.
#[derive(Debug, Clone, Copy)]
struct Corner {
    inverse_depth: f32,
    confidence: f32,
    grey: f32,
}

impl Cells<'_> {
    fn corner(&self, row: usize, column: usize) -> Corner {
        let at = row * self.width + column;
        let confidence = self.confidence[at];
        let known = confidence >= self.min_confidence && self.beliefs[at].inverse_depth > 0.0;
        let inverse_depth = if known { self.beliefs[at].inverse_depth } else { 0.0 };
        Corner { inverse_depth, confidence: if known { confidence } else { 0.0 }, grey: f32::from(self.grey[at]) }
    }

    /// Fills `estimate` (full size); `grey` is the full-size picture, 256 to a grey level.
    pub fn enlarge(&self, grey: &[u16], estimate: &mut DepthEstimate) {
        let width = estimate.depth.width();
        let height = self.beliefs.len() / self.width;
        let DepthEstimate { depth, confidence } = estimate;
        let lines = depth.values_mut().par_chunks_exact_mut(width).zip(confidence.par_chunks_exact_mut(width));
        lines.zip(grey.par_chunks_exact(width)).enumerate().for_each(|(row, ((depth, confidence), grey))| {
            let (top, bottom, below) = between(row, height);
            // Pixels left of the first cell's middle, then those between each cell's middle and the next one's.
            for block in 0..=self.width {
                let (left, right) = (block.saturating_sub(1), block.min(self.width - 1));
                let corners = [(top, left), (top, right), (bottom, left), (bottom, right)]
                    .map(|(row, column)| self.corner(row, column));
                let first = (block * CELL).saturating_sub(CELL / 2);
                let end = if block == self.width { width } else { block * CELL + CELL / 2 };
                let surface = Surface::of(&corners);
                for column in first..end.min(width) {
                    let across = between(column, self.width).2;
                    let weights = [
                        (1.0 - below) * (1.0 - across),
                        (1.0 - below) * across,
                        below * (1.0 - across),
                        below * across,
                    ];
                    (depth[column], confidence[column]) = match surface {
                        Surface::None => (0.0, 0.0),
                        Surface::One => blend(&corners, &weights),
                        Surface::Several => alike(&corners, &weights, f32::from(grey[column])),
                    };
                }
            }
        });
    }
}

/// The cells whose middles are before and behind a pixel, and how near it is to the second, 0 to 1.
fn between(pixel: usize, cells: usize) -> (usize, usize, f32) {
    let place = (pixel as f32 + 0.5) / CELL as f32 - 0.5;
    let before = place.floor();
    let last = cells as f32 - 1.0;
    (before.clamp(0.0, last) as usize, (before + 1.0).clamp(0.0, last) as usize, place - before)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Surface {
    None,
    One,
    Several,
}

impl Surface {
    fn of(corners: &[Corner; 4]) -> Self {
        let least = corners.iter().map(|corner| corner.inverse_depth).fold(f32::INFINITY, f32::min);
        let most = corners.iter().map(|corner| corner.inverse_depth).fold(0.0, f32::max);
        if most == 0.0 {
            Self::None
        } else if most - least <= ONE_SURFACE * most {
            Self::One
        } else {
            Self::Several
        }
    }
}

fn blend(corners: &[Corner; 4], weights: &[f32; 4]) -> (f32, f32) {
    let (mut inverse_depth, mut confidence) = (0.0, 0.0);
    for (corner, weight) in corners.iter().zip(weights) {
        inverse_depth += corner.inverse_depth * weight;
        confidence += corner.confidence * weight;
    }
    (1.0 / inverse_depth, confidence)
}

/// The corner that looks most like the pixel; near ones are preferred.
fn alike(corners: &[Corner; 4], weights: &[f32; 4], grey: f32) -> (f32, f32) {
    let mut best = (f32::INFINITY, 0.0, 0.0);
    for (corner, weight) in corners.iter().zip(weights) {
        let cost = (corner.grey - grey).abs() + FARTHER * (1.0 - weight);
        if cost < best.0 {
            best = (cost, corner.inverse_depth, corner.confidence);
        }
    }
    if best.1 > 0.0 { (1.0 / best.1, best.2) } else { (0.0, 0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn belief(inverse_depth: f32) -> Belief {
        Belief { inverse_depth, evidence: 1.0, votes: 1.0, offset: [0.0; 2] }
    }

    fn enlarged(beliefs: &[Belief], confidence: &[f32], grey: &[u16], picture: &[u16]) -> DepthEstimate {
        let cells = Cells { width: 4, beliefs, confidence, grey, min_confidence: 0.3 };
        let mut estimate = DepthEstimate::none(17, 13);
        cells.enlarge(picture, &mut estimate);
        estimate
    }

    #[test]
    fn a_slope_becomes_a_smooth_slope() {
        let beliefs: Vec<Belief> = (0..12).map(|at| belief(0.5 + 0.02 * (at % 4) as f32)).collect();
        let estimate = enlarged(&beliefs, &[0.8; 12], &[0; 12], &[0; 17 * 13]);
        for row in 0..13 {
            for column in 2..14 {
                let place = (column as f32 + 0.5) / 4.0 - 0.5;
                let depth = estimate.depth.values()[row * 17 + column];
                assert!((1.0 / depth - (0.5 + 0.02 * place)).abs() < 1e-6, "{row} {column}");
            }
        }
        assert!(estimate.confidence.iter().all(|confidence| (*confidence - 0.8).abs() < 1e-6));
    }

    #[test]
    fn a_step_follows_the_edge_of_the_picture() {
        // Near on the left, far on the right; the picture's edge is two pixels to the right of the cells' border.
        let beliefs: Vec<Belief> = (0..12).map(|at| belief(if at % 4 < 2 { 1.0 } else { 0.25 })).collect();
        let grey: Vec<u16> = (0..12).map(|at| if at % 4 < 2 { 10_000 } else { 40_000 }).collect();
        let picture: Vec<u16> = (0..17 * 13).map(|at| if at % 17 < 9 { 10_000 } else { 40_000 }).collect();
        let estimate = enlarged(&beliefs, &[0.8; 12], &grey, &picture);
        for row in 0..13 {
            assert_eq!(estimate.depth.values()[row * 17 + 8], 1.0);
            assert_eq!(estimate.depth.values()[row * 17 + 9], 4.0);
        }
    }

    #[test]
    fn unlikely_beliefs_are_no_depth_and_spread_to_none() {
        let mut confidence = [0.8; 12];
        (confidence[0], confidence[4], confidence[8]) = (0.2, 0.2, 0.2);
        let estimate = enlarged(&[belief(0.5); 12], &confidence, &[0; 12], &[0; 17 * 13]);
        assert_eq!((estimate.depth.values()[0], estimate.confidence[0]), (0.0, 0.0));
        assert_eq!(estimate.depth.values()[10], 2.0);
        assert!(estimate.depth.values().iter().all(|depth| depth.is_finite()));
    }
}
