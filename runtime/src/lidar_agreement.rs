//! The agreement of the depth with the safety LiDAR while the robot drives. The LiDAR measures
//! metric depth along one line of each frame. The result is for status output and for the trial of
//! a new model. It uses no ground truth of a simulator, and it does not influence where the robot
//! drives.

use serde::{Deserialize, Serialize};

use crate::model_gate::{LidarPixel, LidarView};
use crate::perception::DepthEstimate;
use crate::tick::TickInput;

/// Edges of the distance bins, metres.
pub const DISTANCES_M: [f32; 3] = [1.0, 2.0, 4.0];
/// Time constant of the exponential average: after this many frames (one minute at 10 Hz) a frame's
/// weight has fallen to 1/e.
const MEMORY_FRAMES: f64 = 600.0;

/// Agreement of the depth with the LiDAR in one range of distances, or in all.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AgreementStats {
    /// Lower end of the range of distances, metres.
    pub from_m: f32,
    /// Upper end of the range, metres; `None` if it has no end.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub to_m: Option<f32>,
    /// Weighted number of compared pixels; older pixels have a lower weight.
    pub pixels: f64,
    /// Share of the compared pixels that have a depth.
    pub share: f64,
    /// Share of the pixels with a depth whose depth is within a factor of 1.25 of the LiDAR's,
    /// without scaling.
    pub delta1: f64,
    /// Geometric mean of the depth divided by the LiDAR's depth: above 1 the depth is too large.
    pub scale: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    pixels: f64,
    with_depth: f64,
    right: f64,
    log_ratio: f64,
}

impl Bin {
    fn add(&mut self, depth_m: Option<f32>, lidar: &LidarPixel) {
        self.pixels += 1.0;
        if let Some(depth_m) = depth_m {
            self.with_depth += 1.0;
            self.right += f64::from(u8::from(lidar.agrees(depth_m)));
            self.log_ratio += f64::from(depth_m / lidar.depth_m).ln();
        }
    }

    fn fade(&mut self, keep: f64) {
        for sum in [&mut self.pixels, &mut self.with_depth, &mut self.right, &mut self.log_ratio] {
            *sum *= keep;
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            pixels: self.pixels + other.pixels,
            with_depth: self.with_depth + other.with_depth,
            right: self.right + other.right,
            log_ratio: self.log_ratio + other.log_ratio,
        }
    }

    /// `None` if no pixel with a depth was compared yet.
    fn accuracy(&self, from_m: f32, to_m: Option<f32>) -> Option<AgreementStats> {
        (self.with_depth > 0.0).then(|| AgreementStats {
            from_m,
            to_m,
            pixels: self.pixels,
            share: self.with_depth / self.pixels,
            delta1: self.right / self.with_depth,
            scale: (self.log_ratio / self.with_depth).exp(),
        })
    }
}

/// Compares the depth of each frame with the LiDAR and averages over about one minute.
#[derive(Debug, Clone)]
pub struct LidarAgreement {
    view: LidarView,
    bins: [Bin; DISTANCES_M.len() + 1],
}

impl LidarAgreement {
    /// An average without frames; `view` projects the LiDAR's scans into the camera.
    #[must_use]
    pub fn new(view: LidarView) -> Self {
        Self { view, bins: Default::default() }
    }

    /// Compares the depth of a tick's frame with the tick's scan, if both exist and their times
    /// agree. Call it after the robot has processed the tick.
    pub fn observe(&mut self, input: &TickInput<'_>, depth: Option<&DepthEstimate>) {
        if let Some(depth) = depth {
            self.add(depth, &self.view.of_tick(input));
        }
    }

    /// Adds the depth of one frame and the LiDAR's depth at some of its pixels. Without LiDAR
    /// pixels nothing changes.
    pub fn add(&mut self, estimate: &DepthEstimate, line: &[LidarPixel]) {
        if line.is_empty() {
            return;
        }
        let keep = 1.0 - 1.0 / MEMORY_FRAMES;
        self.bins.iter_mut().for_each(|bin| bin.fade(keep));
        for point in line.iter().filter(|point| point.depth_m > 0.0) {
            let bin = DISTANCES_M.iter().filter(|edge_m| point.depth_m >= **edge_m).count();
            let inside = point.u < estimate.depth.width() && point.v < estimate.depth.height();
            if let Some(bin) = self.bins.get_mut(bin).filter(|_| inside) {
                bin.add(estimate.depth.get(point.u, point.v), point);
            }
        }
    }

    /// The agreement over all distances; `None` if nothing was compared yet.
    #[must_use]
    pub fn overall(&self) -> Option<AgreementStats> {
        self.bins.iter().fold(Bin::default(), |sum, bin| sum.plus(*bin)).accuracy(0.0, None)
    }

    /// The agreement in each range of distances, the nearest first. Ranges without compared pixels
    /// are left out.
    #[must_use]
    pub fn by_distance(&self) -> Vec<AgreementStats> {
        let ends = DISTANCES_M.iter().copied().map(Some).chain([None]);
        let starts = [0.0].into_iter().chain(DISTANCES_M);
        self.bins
            .iter()
            .zip(starts.zip(ends))
            .filter_map(|(bin, (from_m, to_m))| bin.accuracy(from_m, to_m))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{CameraModel, DepthMap, Pose3};

    fn agreement() -> LidarAgreement {
        LidarAgreement::new(LidarView {
            camera: CameraModel::pinhole(8, 1, 1.0),
            t_base_camera: Pose3::identity(),
            t_base_laser: Pose3::identity(),
        })
    }

    fn estimate(depths_m: &[f32]) -> DepthEstimate {
        let depth = DepthMap::from_vec(depths_m.len(), 1, depths_m.to_vec()).unwrap();
        DepthEstimate { depth, confidence: vec![1.0; depths_m.len()] }
    }

    fn line(depths_m: &[f32]) -> Vec<LidarPixel> {
        depths_m
            .iter()
            .enumerate()
            .map(|(u, depth_m)| LidarPixel { u, v: 0, depth_m: *depth_m })
            .collect()
    }

    #[test]
    fn depth_that_is_10_percent_too_large_is_right_and_its_scale_is_reported() {
        let mut agreement = agreement();
        agreement.add(&estimate(&[1.1, 3.3, 5.5, 0.0]), &line(&[1.0, 3.0, 5.0, 3.0]));
        let all = agreement.overall().unwrap();
        assert!((all.scale - 1.1).abs() < 1e-6 && all.delta1 == 1.0, "{all:?}");
        assert!(
            (all.share - 0.75).abs() < 1e-12,
            "a pixel without depth is not wrong, but it is counted"
        );
    }

    #[test]
    fn each_range_of_distances_is_reported_and_ranges_without_pixels_are_left_out() {
        let mut agreement = agreement();
        agreement.add(&estimate(&[0.5, 1.5, 9.0]), &line(&[0.5, 1.0, 5.0]));
        let found: Vec<_> =
            agreement.by_distance().iter().map(|bin| (bin.from_m, bin.to_m, bin.delta1)).collect();
        assert_eq!(found, [(0.0, Some(1.0), 1.0), (1.0, Some(2.0), 0.0), (4.0, None, 0.0)]);
    }

    #[test]
    fn nothing_is_reported_before_the_first_comparison() {
        let mut agreement = agreement();
        assert_eq!((agreement.overall(), agreement.by_distance().len()), (None, 0));
        agreement.add(&estimate(&[1.0]), &[]);
        agreement.add(&estimate(&[0.0]), &line(&[1.0]));
        agreement.add(&estimate(&[1.0]), &[LidarPixel { u: 7, v: 0, depth_m: 1.0 }]);
        assert_eq!(agreement.overall(), None);
    }

    #[test]
    fn older_frames_have_a_lower_weight() {
        let mut agreement = agreement();
        for (depth_m, frames) in [(4.0, 3000), (2.0, 1800)] {
            (0..frames).for_each(|_| agreement.add(&estimate(&[depth_m]), &line(&[2.0])));
        }
        // After three time constants the old frames have e^-3 = 5 % of the weight.
        let delta1 = agreement.overall().unwrap().delta1;
        assert!((delta1 - 0.95).abs() < 0.005, "{delta1}");
    }
}
