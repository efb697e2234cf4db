//! Upsamples depth from cells to pixels: bilinear where the cells around a pixel agree, along the image's edges where they do
//! not.

use multiversion::multiversion;
use rayon::prelude::*;

use super::DepthEstimate;
use super::belief::Belief;
use super::sweep::CELL;

/// Cells agree when their inverse depths differ by less than this share: one surface, not two.
const ONE_SURFACE: f32 = 0.15;
/// Cost of one cell of distance between a corner and the pixel, in the unit of brightness differences: 256 to a grey
/// level.
const FARTHER: f32 = 2048.0;

/// Beliefs and brightness of all cells.
#[derive(Debug, Clone, Copy)]
pub struct Cells<'a> {
    pub width: usize,
    /// Beliefs of all cells, row-major.
    pub beliefs: &'a [Belief],
    /// Probability that each belief is right.
    pub confidence: &'a [f32],
    /// Grey value of each cell, 256 to a grey level.
    pub grey: &'a [u16],
    /// Beliefs with a lower confidence give no depth.
    pub min_confidence: f32,
}

/// One of the four cells around a pixel; inverse depth 0 where unknown.
#[derive(Debug, Clone, Copy)]
struct Corner {
    inverse_depth: f32,
    confidence: f32,
    grey: f32,
}

/// Positions of the pixels between the middles of two cells, as a share of the distance.
const PLACES: [f32; CELL] = [0.125, 0.375, 0.625, 0.875];

impl Cells<'_> {
    /// Fills `estimate` (full size); `grey` is the full-size image, 256 to a grey level.
    pub fn upsample(&self, grey: &[u16], estimate: &mut DepthEstimate) {
        let width = estimate.depth.width();
        let DepthEstimate { depth, confidence } = estimate;
        let lines = depth
            .values_mut()
            .par_chunks_exact_mut(width)
            .zip(confidence.par_chunks_exact_mut(width));
        let lines = lines.zip(grey.par_chunks_exact(width)).enumerate();
        lines.for_each(|(row, ((depth, confidence), grey))| {
            upsample_row(self, row, grey, depth, confidence);
        });
    }

    #[inline(always)]
    fn corner(&self, at: usize) -> Corner {
        let confidence = self.confidence[at];
        let known = confidence >= self.min_confidence;
        let inverse_depth = if known { self.beliefs[at].inverse_depth } else { 0.0 };
        Corner {
            inverse_depth,
            confidence: if known { confidence } else { 0.0 },
            grey: f32::from(self.grey[at]),
        }
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn upsample_row<'a>(
    cells: &Cells<'a>,
    row: usize,
    grey: &[u16],
    depth: &mut [f32],
    confidence: &mut [f32],
) {
    let height = cells.beliefs.len() / cells.width;
    let block = (row + CELL / 2) / CELL;
    let top = block.saturating_sub(1).min(height - 1) * cells.width;
    let bottom = block.min(height - 1) * cells.width;
    let below = PLACES[(row + CELL / 2) % CELL];
    let mut left = [cells.corner(top), cells.corner(bottom)];
    // Pixels left of the first cell's middle, then those between each cell's middle and the next one's.
    for block in 0..=cells.width {
        let right = match block < cells.width {
            true => [cells.corner(top + block), cells.corner(bottom + block)],
            false => left,
        };
        let four = blend(&left, &right, below, grey, block * CELL);
        // Columns outside the image are not written; columns right of the last block repeat it.
        let first = (block * CELL).saturating_sub(CELL / 2);
        let end = if block == cells.width {
            depth.len()
        } else {
            (block * CELL + CELL / 2).min(depth.len())
        };
        for column in first..end {
            (depth[column], confidence[column]) =
                four[(column + CELL / 2 - block * CELL).min(CELL - 1)];
        }
        left = right;
    }
}

/// Depth and confidence of the four pixels of a row between four cells; the first one is at column `place` - 2.
#[inline(always)]
fn blend(
    left: &[Corner; 2],
    right: &[Corner; 2],
    below: f32,
    grey: &[u16],
    place: usize,
) -> [(f32, f32); CELL] {
    let corners = [left[0], right[0], left[1], right[1]];
    let least = corners.iter().map(|corner| corner.inverse_depth).fold(f32::INFINITY, f32::min);
    let most = corners.iter().map(|corner| corner.inverse_depth).fold(0.0, f32::max);
    if most == 0.0 {
        return [(0.0, 0.0); CELL];
    }
    if most - least > ONE_SURFACE * most {
        return std::array::from_fn(|index| {
            let column = (place + index).saturating_sub(CELL / 2).min(grey.len() - 1);
            let across = PLACES[index];
            let weights = [
                (1.0 - below) * (1.0 - across),
                (1.0 - below) * across,
                below * (1.0 - across),
                below * across,
            ];
            most_similar(&corners, &weights, f32::from(grey[column]))
        });
    }
    let [near, far] = [left, right].map(|pair| {
        let inverse_depth = mix(pair[0].inverse_depth, pair[1].inverse_depth, below);
        (inverse_depth, mix(pair[0].confidence, pair[1].confidence, below))
    });
    PLACES.map(|across| (1.0 / mix(near.0, far.0, across), mix(near.1, far.1, across)))
}

#[inline(always)]
fn mix(from: f32, to: f32, share: f32) -> f32 {
    from + (to - from) * share
}

/// Depth and confidence of the corner whose brightness is most similar to the pixel's; near corners are preferred.
#[inline(always)]
fn most_similar(corners: &[Corner; 4], weights: &[f32; 4], grey: f32) -> (f32, f32) {
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

    fn upsampled(
        beliefs: &[Belief],
        confidence: &[f32],
        grey: &[u16],
        image: &[u16],
    ) -> DepthEstimate {
        let cells = Cells { width: 4, beliefs, confidence, grey, min_confidence: 0.3 };
        let mut estimate = DepthEstimate::none(17, 13);
        cells.upsample(image, &mut estimate);
        estimate
    }

    #[test]
    fn a_slope_becomes_a_smooth_slope() {
        let beliefs: Vec<Belief> = (0..12).map(|at| belief(0.5 + 0.02 * (at % 4) as f32)).collect();
        let estimate = upsampled(&beliefs, &[0.8; 12], &[0; 12], &[0; 17 * 13]);
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
    fn a_step_follows_the_edge_of_the_image() {
        // Near on the left, far on the right; the image's edge is two pixels to the right of the border between the cells.
        let beliefs: Vec<Belief> =
            (0..12).map(|at| belief(if at % 4 < 2 { 1.0 } else { 0.25 })).collect();
        let grey: Vec<u16> = (0..12).map(|at| if at % 4 < 2 { 10_000 } else { 40_000 }).collect();
        let image: Vec<u16> =
            (0..17 * 13).map(|at| if at % 17 < 9 { 10_000 } else { 40_000 }).collect();
        let estimate = upsampled(&beliefs, &[0.8; 12], &grey, &image);
        for row in 0..13 {
            assert_eq!(estimate.depth.values()[row * 17 + 8], 1.0);
            assert_eq!(estimate.depth.values()[row * 17 + 9], 4.0);
        }
    }

    #[test]
    fn unlikely_beliefs_give_no_depth_and_do_not_affect_their_neighbours() {
        let mut confidence = [0.8; 12];
        confidence[0] = 0.2;
        confidence[4] = 0.2;
        confidence[8] = 0.2;
        let estimate = upsampled(&[belief(0.5); 12], &confidence, &[0; 12], &[0; 17 * 13]);
        assert_eq!((estimate.depth.values()[0], estimate.confidence[0]), (0.0, 0.0));
        assert_eq!(estimate.depth.values()[10], 2.0);
        assert!(estimate.depth.values().iter().all(|depth| depth.is_finite()));
    }
}
