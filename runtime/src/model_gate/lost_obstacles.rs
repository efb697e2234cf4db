//! Obstacles near the robot that a depth map loses. The LiDAR's returns enter the image of a level
//! camera only from some distance on (about 1 m with the default mounts), but the map marks and clears
//! only near the robot. What the robot can measure there is coarse depth: it is triangulated from
//! known motion without a network, so no network can change it.
//!
//! Only coarse depth with a probability of 80 % or more is evidence. At such a pixel the obstacle is
//! *lost* if the model says that it is more than 1.5 times as far, with a probability that the map
//! accepts: the map would clear what stands there. A missing or doubtful depth loses nothing, because
//! it clears nothing.

use std::fmt;

use hal::CameraModel;
use serde::{Deserialize, Serialize};

use crate::perception::DepthEstimate;

/// Nearest depth that counts, metres.
const NEAREST_M: f32 = 0.3;
/// End of the first range, metres.
const FIRST_M: f32 = 1.0;
/// End of the second range, metres: the map uses depth up to here (`map.mark_range_m`).
const NEAR_M: f32 = 2.0;
/// Half width of the corridor ahead that the robot sweeps, metres: its radius and a margin.
const CORRIDOR_M: f64 = 0.35;
/// Probability from which on coarse depth is evidence.
const EVIDENCE: f32 = 0.8;
/// Depths that are farther by more than this factor lose the obstacle.
const LOST: f32 = 1.5;
/// Every second column and row is compared.
const STRIDE: usize = 2;
/// Smallest share of the compared pixels that says anything.
const LEAST_SHARE: f64 = 0.002;

/// Where an obstacle is near.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NearRange {
    /// Between 0.3 and 1 m.
    First,
    /// Between 1 and 2 m.
    Second,
    /// Nearer than 2 m in the corridor that the robot sweeps.
    Corridor,
}

impl NearRange {
    pub const ALL: [Self; 3] = [Self::First, Self::Second, Self::Corridor];
}

impl fmt::Display for NearRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::First => "at 0.3 to 1 m",
            Self::Second => "at 1 to 2 m",
            Self::Corridor => "in the corridor ahead up to 2 m",
        })
    }
}

/// Shares of the obstacles of one frame that are lost; `None` where coarse depth shows too few.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct LostShares {
    /// Between 0.3 and 1 m.
    pub first: Option<f64>,
    /// Between 1 and 2 m.
    pub second: Option<f64>,
    /// Nearer than 2 m in the corridor straight ahead.
    pub corridor: Option<f64>,
    /// Nearer than 2 m anywhere.
    pub near: Option<f64>,
}

impl LostShares {
    /// The share in one range.
    #[must_use]
    pub fn at(&self, range: NearRange) -> Option<f64> {
        match range {
            NearRange::First => self.first,
            NearRange::Second => self.second,
            NearRange::Corridor => self.corridor,
        }
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Count {
    pixels: u32,
    lost: u32,
}

impl Count {
    fn add(&mut self, is_lost: bool) {
        self.pixels += 1;
        self.lost += u32::from(is_lost);
    }

    fn share(self, least: f64) -> Option<f64> {
        let pixels = f64::from(self.pixels);
        (pixels >= least.max(1.0)).then(|| f64::from(self.lost) / pixels)
    }
}

/// Counts the obstacles that depth maps of one camera lose.
#[derive(Debug, Clone, Copy)]
pub struct LostObstacles {
    camera: CameraModel,
    /// The probability from which on the map uses a depth (`map.min_confidence`).
    map_confidence: f32,
}

impl LostObstacles {
    /// For frames of `camera`, and a map that uses depth from this probability on.
    #[must_use]
    pub fn new(camera: &CameraModel, map_confidence: f32) -> Self {
        Self { camera: *camera, map_confidence }
    }

    /// Compares a depth map with coarse depth of the same frame.
    #[must_use]
    pub fn shares(&self, estimate: &DepthEstimate, coarse: &DepthEstimate) -> LostShares {
        let CameraModel { width, height, cx, fx, .. } = self.camera;
        let mut first = Count::default();
        let mut second = Count::default();
        let mut corridor = Count::default();
        let mut near = Count::default();
        for v in (0..height).step_by(STRIDE) {
            for u in (0..width).step_by(STRIDE) {
                let at = v * width + u;
                let Some(truth_m) = evidence_at(coarse, at) else { continue };
                let is_lost = self.is_lost(estimate, at, truth_m);
                near.add(is_lost);
                if truth_m < FIRST_M { &mut first } else { &mut second }.add(is_lost);
                let aside_m = (u as f64 - cx) / fx * f64::from(truth_m);
                if aside_m.abs() <= CORRIDOR_M {
                    corridor.add(is_lost);
                }
            }
        }
        let least = LEAST_SHARE * (width * height / (STRIDE * STRIDE)) as f64;
        LostShares {
            first: first.share(least),
            second: second.share(least),
            corridor: corridor.share(least),
            near: near.share(least),
        }
    }

    fn is_lost(&self, estimate: &DepthEstimate, at: usize, truth_m: f32) -> bool {
        let depth_m = estimate.depth.values().get(at).copied().unwrap_or(0.0);
        let confidence = estimate.confidence.get(at).copied().unwrap_or(0.0);
        confidence >= self.map_confidence && depth_m > LOST * truth_m
    }
}

/// Depth of an obstacle near the robot that coarse depth is sure of, metres.
fn evidence_at(coarse: &DepthEstimate, at: usize) -> Option<f32> {
    let depth_m = *coarse.depth.values().get(at)?;
    let confidence = *coarse.confidence.get(at)?;
    let is_near = (NEAREST_M..NEAR_M).contains(&depth_m);
    (is_near && confidence >= EVIDENCE).then_some(depth_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::DepthMap;
    use std::f64::consts::FRAC_PI_2;

    const SIZE: (usize, usize) = (160, 64);

    fn counter() -> LostObstacles {
        LostObstacles::new(&CameraModel::pinhole(SIZE.0, SIZE.1, FRAC_PI_2), 0.8)
    }

    /// An estimate with this depth and confidence in each column.
    fn columns(of: impl Fn(usize) -> (f32, f32)) -> DepthEstimate {
        let pixels = (0..SIZE.0 * SIZE.1).map(|at| of(at % SIZE.0));
        let (depth, confidence) = pixels.unzip();
        DepthEstimate { depth: DepthMap::from_vec(SIZE.0, SIZE.1, depth).unwrap(), confidence }
    }

    fn shares(model: (f32, f32), coarse: (f32, f32)) -> LostShares {
        counter().shares(&columns(|_| model), &columns(|_| coarse))
    }

    #[test]
    fn each_pixel_counts_in_the_range_of_its_coarse_depth() {
        assert_eq!(found(0.29), [false; 4]);
        assert_eq!(found(0.3), [true, false, true, true]);
        assert_eq!(found(0.99), [true, false, true, true]);
        assert_eq!(found(1.0), [false, true, true, true]);
        assert_eq!(found(2.0), [false; 4]);
        assert_eq!(found(0.0), [false; 4]);
    }

    fn found(depth_m: f32) -> [bool; 4] {
        let shares = shares((depth_m, 1.0), (depth_m, 0.9));
        [shares.first, shares.second, shares.corridor, shares.near].map(|share| share.is_some())
    }

    #[test]
    fn coarse_depth_that_is_not_sure_proves_nothing() {
        assert_eq!(shares((5.0, 1.0), (0.8, 0.79)), LostShares::default());
        assert_eq!(shares((5.0, 1.0), (0.0, 0.0)), LostShares::default());
    }

    #[test]
    fn only_a_depth_that_the_map_accepts_and_that_is_far_behind_loses_an_obstacle() {
        assert_eq!([(5.0, 1.0), (1.21, 0.8)].map(lost_share), [1.0, 1.0]);
        assert_eq!([(1.19, 1.0), (5.0, 0.79), (0.0, 0.0), (0.3, 1.0)].map(lost_share), [0.0; 4]);
        // A map that accepts less sure depth is cleared by it.
        let bold = LostObstacles { map_confidence: 0.5, ..counter() };
        let lost = bold.shares(&columns(|_| (5.0, 0.6)), &columns(|_| (0.8, 0.9)));
        assert_eq!(lost.first, Some(1.0));
    }

    fn lost_share(model: (f32, f32)) -> f64 {
        shares(model, (0.8, 0.9)).first.unwrap()
    }

    #[test]
    fn a_model_that_is_blind_in_the_middle_loses_the_corridor_ahead() {
        let third = SIZE.0 / 3..2 * SIZE.0 / 3;
        let blind = columns(|u| if third.contains(&u) { (5.0, 1.0) } else { (1.0, 1.0) });
        let shares = counter().shares(&blind, &columns(|_| (1.0, 1.0)));
        assert!((shares.second.unwrap() - 1.0 / 3.0).abs() < 0.02, "{shares:?}");
        // 0.35 m aside at 1 m: columns 51 to 107, of which 53 to 105 are blind.
        assert!(shares.corridor.unwrap() > 0.9, "{shares:?}");
    }
}
