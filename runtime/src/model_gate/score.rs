//! Scores of one model's depth of one frame, from data that the robot itself records: earlier
//! frames and LiDAR scans.

use hal::CameraModel;
use serde::{Deserialize, Serialize};

use super::{LidarPixel, LostObstacles, LostShares, Photometric, Source};
use crate::perception::DepthEstimate;

/// Edges of the parallax bins, in pixels. Frames are compared separately by the parallax between a
/// frame and its farthest source, for a point 2.5 m away: below the first edge the depth hardly
/// changes the warped image, above the second edge it changes every pixel.
pub const PARALLAX_BINS_PX: [f64; 2] = [6.0, 16.0];
/// The depth that the parallax refers to, metres; the trainer selects its pairs with the same
/// value.
const ASSUMED_DEPTH_M: f64 = 2.5;

/// Agreement of a depth map with the LiDAR.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LidarScore {
    /// Number of compared pixels.
    pub points: u32,
    /// Mean of |d - z| / z with depth d and LiDAR depth z, without scaling; a pixel without depth
    /// counts as 1.
    pub abs_rel: f64,
    /// Share of pixels with max(d / z, z / d) < 1.25, without scaling; a pixel without depth is
    /// wrong.
    pub delta1: f64,
    /// Brier score of the confidence (Brier 1950): mean of (confidence - right)^2, where right is 0
    /// or 1. It is least if each confidence equals the probability that the depth is right.
    pub brier: f64,
}

/// Scores of one model's depth of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameScore {
    /// Mean photometric error; absent without a source.
    pub photometric: Option<f64>,
    /// Mean photometric error with sources that are not warped.
    pub unmoved: Option<f64>,
    /// Agreement with the LiDAR; absent if the LiDAR measures no pixel of the frame.
    pub line: Option<LidarScore>,
    /// Shares of the obstacles near the robot that are lost.
    #[serde(default)]
    pub lost: LostShares,
}

/// Parallax between a frame and its farthest source for a point 2.5 m away, pixels.
#[must_use]
pub fn parallax_px(camera: &CameraModel, sources: &[Source<'_>]) -> f64 {
    let longest_baseline_m = sources
        .iter()
        .map(|source| source.t_source_target.translation.vector.norm())
        .fold(0.0, f64::max);
    camera.fx * longest_baseline_m / ASSUMED_DEPTH_M
}

/// Index of the bin of [`PARALLAX_BINS_PX`] that contains a parallax: 0, 1 or 2.
#[must_use]
pub fn parallax_bin(parallax_px: f64) -> usize {
    PARALLAX_BINS_PX.iter().filter(|edge| parallax_px >= **edge).count()
}

/// Scores the depth of one camera's frames.
#[derive(Debug)]
pub struct Scorer {
    photometric: Photometric,
    lost: LostObstacles,
    camera: CameraModel,
}

impl Scorer {
    /// Allocates the buffers for frames of `camera`. `map_confidence`: the map uses depth from this probability on.
    #[must_use]
    pub fn new(camera: &CameraModel, map_confidence: f32) -> Self {
        Self {
            photometric: Photometric::new(camera),
            lost: LostObstacles::new(camera, map_confidence),
            camera: *camera,
        }
    }

    /// Scores the depth of the frame `rgb`, whose coarse depth is `coarse`.
    pub fn score(
        &mut self,
        rgb: &[u8],
        estimate: &DepthEstimate,
        coarse: Option<&DepthEstimate>,
        sources: &[Source<'_>],
        line: &[LidarPixel],
    ) -> FrameScore {
        let errors = self.photometric.error(rgb, estimate.depth.values(), sources);
        FrameScore {
            photometric: errors.map(|(warped, _)| warped),
            unmoved: errors.map(|(_, unmoved)| unmoved),
            line: lidar_score(estimate, line),
            lost: coarse.map(|coarse| self.lost.shares(estimate, coarse)).unwrap_or_default(),
        }
    }

    /// [`parallax_px`] for this scorer's camera.
    #[must_use]
    pub fn parallax_px(&self, sources: &[Source<'_>]) -> f64 {
        parallax_px(&self.camera, sources)
    }
}

/// Compares a depth map with the LiDAR; `None` if there is no pixel to compare.
#[must_use]
pub fn lidar_score(estimate: &DepthEstimate, line: &[LidarPixel]) -> Option<LidarScore> {
    let width = estimate.depth.width();
    let mut points = 0_u32;
    let mut abs_rel = 0.0;
    let mut right = 0.0;
    let mut brier = 0.0;
    for point in line.iter().filter(|point| point.u < width) {
        let index = point.v * width + point.u;
        let Some(&depth) = estimate.depth.values().get(index) else { continue };
        let Some(confidence) = estimate.confidence.get(index) else { continue };
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
    (points > 0).then(|| LidarScore {
        points,
        abs_rel: abs_rel / count,
        delta1: right / count,
        brier: brier / count,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{DepthMap, Pose3};

    fn estimate(depth_m: f32, confidence: f32) -> DepthEstimate {
        DepthEstimate {
            depth: DepthMap::from_vec(4, 2, vec![depth_m; 8]).unwrap(),
            confidence: vec![confidence; 8],
        }
    }

    fn line(depths_m: &[f32]) -> Vec<LidarPixel> {
        depths_m
            .iter()
            .enumerate()
            .map(|(u, depth_m)| LidarPixel { u, v: 1, depth_m: *depth_m })
            .collect()
    }

    #[test]
    fn the_scores_follow_their_textbook_definitions() {
        let score = lidar_score(&estimate(2.0, 0.75), &line(&[2.0, 2.4, 3.0, 1.0])).unwrap();
        assert_eq!((score.points, score.delta1), (4, 0.5));
        assert!((score.abs_rel - (0.0 + 0.4 / 2.4 + 1.0 / 3.0 + 1.0) / 4.0).abs() < 1e-6);
        assert!((score.brier - (2.0 * 0.0625 + 2.0 * 0.5625) / 4.0).abs() < 1e-9);
    }

    #[test]
    fn a_missing_depth_is_wrong_and_without_lidar_pixels_there_is_no_score() {
        let score = lidar_score(&estimate(0.0, 0.0), &line(&[2.0])).unwrap();
        assert_eq!((score.delta1, score.abs_rel, score.brier), (0.0, 1.0, 0.0));
        assert_eq!(lidar_score(&estimate(2.0, 1.0), &[]), None);
        assert_eq!(
            lidar_score(&estimate(2.0, 1.0), &[LidarPixel { u: 9, v: 9, depth_m: 1.0 }]),
            None
        );
    }

    #[test]
    fn parallax_is_that_of_the_farthest_source() {
        let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
        let rgb = [0; 0];
        let sources = [0.05, -0.1]
            .map(|x| Source { rgb: &rgb, t_source_target: Pose3::translation(x, 0.0, 0.0) });
        assert!((parallax_px(&camera, &sources) - 12.8).abs() < 1e-9);
        assert_eq!([0.0, 6.0, 15.9, 16.0].map(parallax_bin), [0, 1, 1, 2]);
    }
}
