//! How good one model's depth of one picture is, by what the robot itself can see.

use hal::{CameraModel, Pose3};
use serde::{Deserialize, Serialize};

use super::{LinePoint, Photometric, Source};
use crate::perception::DepthEstimate;

/// Pictures are compared apart by the parallax between them and their farthest source, in pixels of something 2.5 m away: below
/// the first a depth hardly shows, above the second it shows in every pixel.
pub const PARALLAX_BINS_PX: [f64; 2] = [6.0, 16.0];
/// The distance that is assumed for that, metres: as the trainer's pairs.
const ASSUMED_DEPTH_M: f64 = 2.5;

/// What the LiDAR line says of a depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LineScore {
    /// Pixels that were compared.
    pub points: u32,
    /// Mean of |d - z| / z, metric; a pixel without depth counts 1.
    pub abs_rel: f64,
    /// Share with max(d / z, z / d) < 1.25, metric; a pixel without depth is wrong.
    pub delta1: f64,
    /// Brier score of the confidence: mean of (confidence - right)^2, where right is 0 or 1. Least when confidences are the
    /// probabilities that they are said to be (Brier 1950).
    pub brier: f64,
}

/// How good one model's depth of one picture is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameScore {
    /// Mean photometric error; absent without a source.
    pub photometric: Option<f64>,
    /// The same with sources that are not moved.
    pub unmoved: Option<f64>,
    /// Absent where the LiDAR sees nothing of the picture.
    pub line: Option<LineScore>,
}

/// Parallax of a picture's farthest source, pixels of something 2.5 m away.
#[must_use]
pub fn parallax_px(camera: &CameraModel, sources: &[Source<'_>]) -> f64 {
    let baseline = |pose: &Pose3| pose.translation.vector.norm();
    let farthest =
        sources.iter().map(|source| baseline(&source.t_source_target)).fold(0.0, f64::max);
    camera.fx * farthest / ASSUMED_DEPTH_M
}

/// Which of the bins of [`PARALLAX_BINS_PX`] a parallax is in: 0, 1 or 2.
#[must_use]
pub fn parallax_bin(parallax_px: f64) -> usize {
    PARALLAX_BINS_PX.iter().filter(|edge| parallax_px >= **edge).count()
}

/// Scores depths of one camera's pictures.
#[derive(Debug)]
pub struct Scorer {
    photometric: Photometric,
    camera: CameraModel,
}

impl Scorer {
    /// For pictures of `camera`.
    #[must_use]
    pub fn new(camera: &CameraModel) -> Self {
        Self { photometric: Photometric::new(camera), camera: *camera }
    }

    /// Scores the depth of the picture `rgb`.
    pub fn score(
        &mut self,
        rgb: &[u8],
        estimate: &DepthEstimate,
        sources: &[Source<'_>],
        line: &[LinePoint],
    ) -> FrameScore {
        let errors = self.photometric.error(rgb, estimate.depth.values(), sources);
        let (photometric, unmoved) = (errors.map(|errors| errors.0), errors.map(|errors| errors.1));
        FrameScore { photometric, unmoved, line: line_score(estimate, line) }
    }

    /// As the free [`parallax_px`].
    #[must_use]
    pub fn parallax_px(&self, sources: &[Source<'_>]) -> f64 {
        parallax_px(&self.camera, sources)
    }
}

/// Depth against the LiDAR; `None` where it sees nothing.
#[must_use]
pub fn line_score(estimate: &DepthEstimate, line: &[LinePoint]) -> Option<LineScore> {
    let width = estimate.depth.width();
    let (mut points, mut abs_rel, mut right, mut brier) = (0_u32, 0.0, 0.0, 0.0);
    for point in line {
        let at = point.v * width + point.u;
        let there = (estimate.depth.values().get(at), estimate.confidence.get(at));
        let (Some(&depth), Some(confidence), true) = (there.0, there.1, point.u < width) else {
            continue;
        };
        let is_right = f64::from(u8::from(point.agrees(depth)));
        points += 1;
        abs_rel += if depth > 0.0 {
            f64::from((depth - point.depth_m).abs() / point.depth_m)
        } else {
            1.0
        };
        right += is_right;
        brier += (f64::from(*confidence) - is_right).powi(2);
    }
    let count = f64::from(points);
    (points > 0).then(|| LineScore {
        points,
        abs_rel: abs_rel / count,
        delta1: right / count,
        brier: brier / count,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::DepthMap;

    fn estimate(depth_m: f32, confidence: f32) -> DepthEstimate {
        DepthEstimate {
            depth: DepthMap::from_vec(4, 2, vec![depth_m; 8]).unwrap(),
            confidence: vec![confidence; 8],
        }
    }

    fn line(depths_m: &[f32]) -> Vec<LinePoint> {
        depths_m
            .iter()
            .enumerate()
            .map(|(u, depth_m)| LinePoint { u, v: 1, depth_m: *depth_m })
            .collect()
    }

    #[test]
    fn the_line_is_scored_by_the_textbook() {
        let score = line_score(&estimate(2.0, 0.75), &line(&[2.0, 2.4, 3.0, 1.0])).unwrap();
        assert_eq!((score.points, score.delta1), (4, 0.5));
        assert!((score.abs_rel - (0.0 + 0.4 / 2.4 + 1.0 / 3.0 + 1.0) / 4.0).abs() < 1e-6);
        assert!((score.brier - (2.0 * 0.0625 + 2.0 * 0.5625) / 4.0).abs() < 1e-9);
    }

    #[test]
    fn no_depth_is_wrong_and_no_line_is_no_score() {
        let score = line_score(&estimate(0.0, 0.0), &line(&[2.0])).unwrap();
        assert_eq!((score.delta1, score.abs_rel, score.brier), (0.0, 1.0, 0.0));
        assert_eq!(line_score(&estimate(2.0, 1.0), &[]), None);
        assert_eq!(
            line_score(&estimate(2.0, 1.0), &[LinePoint { u: 9, v: 9, depth_m: 1.0 }]),
            None
        );
    }

    #[test]
    fn parallax_is_that_of_the_farthest_source() {
        let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
        let rgb = [0; 0];
        let source = |x| Source { rgb: &rgb, t_source_target: Pose3::translation(x, 0.0, 0.0) };
        assert!((parallax_px(&camera, &[source(0.05), source(-0.1)]) - 12.8).abs() < 1e-9);
        assert_eq!([0.0, 6.0, 15.9, 16.0].map(parallax_bin), [0, 1, 1, 2]);
    }
}
