//! Agreement of a depth map with coarse depth, by range. The LiDAR's returns enter the image of a
//! level camera only from some distance on (2.07 m with the default mounts), but the map marks and
//! clears only near the robot. What the robot can measure there is coarse depth: it is triangulated
//! from known motion without a network, so no network can change it.
//!
//! Only coarse depth with a confidence of 0.8 or more counts, as in the map. At such a pixel a model
//! is *wrong* if its depth is not within a factor of 1.25, or missing. It has *lost* the obstacle if
//! its depth is more than 1.5 times as far with a confidence that the map accepts: the map would
//! clear what stands there. A missing or doubtful depth loses nothing, because it clears nothing.

use hal::CameraModel;
use serde::{Deserialize, Serialize};

use crate::perception::DepthEstimate;

/// Ends of the ranges, metres: 0.3 to 1, 1 to 2, 2 to 4, and beyond 4.
const EDGES_M: [f32; 3] = [1.0, 2.0, 4.0];
/// Nearest depth that counts, metres.
const NEAREST_M: f32 = 0.3;
/// Number of ranges.
pub const BANDS: usize = EDGES_M.len() + 1;
/// Names of the ranges.
pub const BAND_NAMES: [&str; BANDS] = ["0.3 to 1 m", "1 to 2 m", "2 to 4 m", "beyond 4 m"];
/// The confidence from which on the map uses a depth (`map.min_confidence`).
const SURE: f32 = 0.8;
/// Depths within this factor are right (Eigen et al. 2014).
const DELTA1: f32 = 1.25;
/// Sure depths that are further by more than this factor lose the obstacle.
const LOST: f32 = 1.5;
/// The map uses depth up to this range, metres (`map.mark_range_m`).
const NEAR_M: f32 = 2.0;
/// Half width of the corridor ahead that the robot sweeps, metres: its radius and a margin.
const CORRIDOR_M: f32 = 0.35;
/// Every second column and row is compared.
const STRIDE: usize = 2;
/// Smallest share of the compared pixels that makes a score.
const LEAST_SHARE: f64 = 0.002;

/// Agreement in one range of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BandScore {
    /// Number of compared pixels.
    pub pixels: u32,
    /// Share of them that are wrong.
    pub wrong: f64,
    /// Share of them at which the obstacle is lost.
    pub lost: f64,
}

/// Agreement of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BandScores {
    /// By range of the coarse depth; `None` with too few pixels for a score.
    pub bands: [Option<BandScore>; BANDS],
    /// All pixels nearer than 2 m that lie in the corridor straight ahead.
    pub corridor: Option<BandScore>,
    /// All pixels nearer than 2 m.
    pub near: Option<BandScore>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Count {
    pixels: u32,
    wrong: u32,
    lost: u32,
}

impl Count {
    fn add(&mut self, is_wrong: bool, is_lost: bool) {
        self.pixels += 1;
        self.wrong += u32::from(is_wrong);
        self.lost += u32::from(is_lost);
    }

    fn score(self, least: f64) -> Option<BandScore> {
        let pixels = f64::from(self.pixels);
        (pixels >= least.max(1.0)).then(|| BandScore {
            pixels: self.pixels,
            wrong: f64::from(self.wrong) / pixels,
            lost: f64::from(self.lost) / pixels,
        })
    }
}

/// The range that contains a depth in metres; `None` below 0.3 m and for NaN.
#[must_use]
pub fn band_of(depth_m: f32) -> Option<usize> {
    (depth_m >= NEAREST_M).then(|| EDGES_M.iter().filter(|edge| depth_m >= **edge).count())
}

/// Whether a model that says `depth_m` with this confidence has lost an obstacle at `truth_m`,
/// metres.
#[must_use]
pub fn is_lost(depth_m: f32, confidence: f32, truth_m: f32) -> bool {
    confidence >= SURE && depth_m > LOST * truth_m
}

/// Compares a depth map with coarse depth of the same frame of `camera`.
#[must_use]
pub fn band_scores(
    estimate: &DepthEstimate,
    coarse: &DepthEstimate,
    camera: &CameraModel,
) -> BandScores {
    let width = camera.width;
    let mut bands = [Count::default(); BANDS];
    let mut corridor = Count::default();
    let mut near = Count::default();
    for v in (0..camera.height).step_by(STRIDE) {
        for u in (0..width).step_by(STRIDE) {
            let at = v * width + u;
            let (Some(&truth_m), Some(&sure)) =
                (coarse.depth.values().get(at), coarse.confidence.get(at))
            else {
                continue;
            };
            let Some(band) = band_of(truth_m).filter(|_| sure >= SURE) else { continue };
            let depth_m = estimate.depth.values().get(at).copied().unwrap_or(0.0);
            let confidence = estimate.confidence.get(at).copied().unwrap_or(0.0);
            // A depth of 0 and NaN fail this comparison.
            let is_right = (depth_m / truth_m).max(truth_m / depth_m) < DELTA1;
            let is_lost = is_lost(depth_m, confidence, truth_m);
            if let Some(band) = bands.get_mut(band) {
                band.add(!is_right, is_lost);
            }
            if truth_m < NEAR_M {
                near.add(!is_right, is_lost);
                let aside_m = (u as f64 - camera.cx) / camera.fx * f64::from(truth_m);
                if aside_m.abs() <= f64::from(CORRIDOR_M) {
                    corridor.add(!is_right, is_lost);
                }
            }
        }
    }
    let least = LEAST_SHARE * (width * camera.height / (STRIDE * STRIDE)) as f64;
    BandScores {
        bands: bands.map(|band| band.score(least)),
        corridor: corridor.score(least),
        near: near.score(least),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::DepthMap;
    use std::f64::consts::FRAC_PI_2;

    const SIZE: (usize, usize) = (160, 64);

    fn camera() -> CameraModel {
        CameraModel::pinhole(SIZE.0, SIZE.1, FRAC_PI_2)
    }

    /// An estimate with this depth and confidence in each column.
    fn columns(of: impl Fn(usize) -> (f32, f32)) -> DepthEstimate {
        let pixels = || (0..SIZE.0 * SIZE.1).map(|at| of(at % SIZE.0));
        let depth = DepthMap::from_vec(SIZE.0, SIZE.1, pixels().map(|pixel| pixel.0).collect());
        DepthEstimate { depth: depth.unwrap(), confidence: pixels().map(|pixel| pixel.1).collect() }
    }

    fn scores(model: (f32, f32), coarse: (f32, f32)) -> BandScores {
        band_scores(&columns(|_| model), &columns(|_| coarse), &camera())
    }

    #[test]
    fn each_pixel_counts_in_the_range_of_its_coarse_depth() {
        assert_eq!(
            [0.29, 0.3, 0.99, 1.0, 2.0, 4.0, 19.0].map(band_of),
            [None, Some(0), Some(0), Some(1), Some(2), Some(3), Some(3)]
        );
        assert_eq!(band_of(f32::NAN), None);
        let scored = scores((1.5, 1.0), (1.4, 0.9));
        let found: Vec<bool> = scored.bands.iter().map(Option::is_some).collect();
        assert_eq!(found, [false, true, false, false]);
        assert_eq!(scored.bands[1].unwrap().wrong, 0.0);
        assert_eq!(scored.near, scored.bands[1]);
    }

    #[test]
    fn coarse_depth_that_is_not_sure_proves_nothing() {
        assert_eq!(scores((5.0, 1.0), (0.8, 0.79)), BandScores::default());
        assert_eq!(scores((5.0, 1.0), (0.0, 0.0)), BandScores::default());
    }

    #[test]
    fn only_a_sure_depth_that_is_far_behind_loses_an_obstacle() {
        let lost = |model| scores(model, (0.8, 0.9)).bands[0].unwrap().lost;
        assert_eq!([(5.0, 1.0), (1.21, 0.8)].map(lost), [1.0, 1.0]);
        assert_eq!([(1.19, 1.0), (5.0, 0.79), (0.0, 0.0), (0.3, 1.0)].map(lost), [0.0; 4]);
        let wrong = |model| scores(model, (0.8, 0.9)).bands[0].unwrap().wrong;
        assert_eq!([(0.9, 0.5), (1.01, 1.0), (0.0, 0.0)].map(wrong), [0.0, 1.0, 1.0]);
    }

    #[test]
    fn a_model_that_is_blind_in_the_middle_loses_the_corridor_ahead() {
        let third = SIZE.0 / 3..2 * SIZE.0 / 3;
        let blind = columns(|u| if third.contains(&u) { (5.0, 1.0) } else { (1.0, 1.0) });
        let scored = band_scores(&blind, &columns(|_| (1.0, 1.0)), &camera());
        let lost = scored.bands[1].unwrap().lost;
        assert!((lost - 1.0 / 3.0).abs() < 0.02, "{lost}");
        // 0.35 m aside at 1 m: columns 51 to 107, of which 53 to 105 are blind.
        assert!(scored.corridor.unwrap().lost > 0.9, "{scored:?}");
    }
}
