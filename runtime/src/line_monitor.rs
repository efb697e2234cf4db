//! How right is the depth, as far as the robot can tell while it drives? The safety LiDAR knows the metric truth along one line
//! of every picture. For people and for the trial of a new model; no ground truth of a simulator, and nothing that decides where
//! the robot goes.

use serde::{Deserialize, Serialize};

use crate::model_gate::{LidarView, LinePoint};
use crate::perception::DepthEstimate;
use crate::tick::TickInput;

/// Where distances are told apart, metres.
pub const DISTANCES_M: [f32; 3] = [1.0, 2.0, 4.0];
/// Pictures after which one counts by a factor of e less: a minute at 10 Hz.
const MEMORY_PICTURES: f64 = 600.0;

/// What is known of the depth at one range of distances, or at all.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LineAccuracy {
    /// Distances from here on, metres ...
    pub from_m: f32,
    /// ... to here; absent: no end.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub to_m: Option<f32>,
    /// Pixels that were compared, older ones counting less.
    pub pixels: f64,
    /// Share of them that has a depth.
    pub share: f64,
    /// Share of those within 25 % of the LiDAR's distance, unscaled.
    pub delta1: f64,
    /// Geometric mean of depth over the LiDAR's distance: above 1 the depth is too far.
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
    fn add(&mut self, depth_m: Option<f32>, truth: &LinePoint) {
        self.pixels += 1.0;
        if let Some(depth_m) = depth_m {
            self.with_depth += 1.0;
            self.right += f64::from(u8::from(truth.agrees(depth_m)));
            self.log_ratio += f64::from(depth_m / truth.depth_m).ln();
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

    /// `None` while nothing with a depth was compared.
    fn accuracy(&self, from_m: f32, to_m: Option<f32>) -> Option<LineAccuracy> {
        (self.with_depth > 0.0).then(|| LineAccuracy {
            from_m,
            to_m,
            pixels: self.pixels,
            share: self.with_depth / self.pixels,
            delta1: self.right / self.with_depth,
            scale: (self.log_ratio / self.with_depth).exp(),
        })
    }
}

/// Compares picture after picture and remembers about the last minute.
#[derive(Debug, Clone)]
pub struct LineMonitor {
    view: LidarView,
    bins: [Bin; DISTANCES_M.len() + 1],
}

impl LineMonitor {
    /// For a LiDAR that the camera sees like this.
    #[must_use]
    pub fn new(view: LidarView) -> Self {
        Self { view, bins: Default::default() }
    }

    /// After a turn: compares the depth of its picture with its scan, where both are there and of the same moment.
    pub fn look(&mut self, input: &TickInput<'_>, depth: Option<&DepthEstimate>) {
        if let Some(depth) = depth {
            self.add(depth, &self.view.of_turn(input));
        }
    }

    /// Takes a picture's depth and what the LiDAR knows of it. A picture that the LiDAR sees nothing of changes nothing.
    pub fn add(&mut self, estimate: &DepthEstimate, line: &[LinePoint]) {
        if line.is_empty() {
            return;
        }
        let keep = 1.0 - 1.0 / MEMORY_PICTURES;
        self.bins.iter_mut().for_each(|bin| bin.fade(keep));
        for point in line.iter().filter(|point| point.depth_m > 0.0) {
            let bin = DISTANCES_M.iter().filter(|edge_m| point.depth_m >= **edge_m).count();
            let inside = point.u < estimate.depth.width() && point.v < estimate.depth.height();
            if let Some(bin) = self.bins.get_mut(bin).filter(|_| inside) {
                bin.add(estimate.depth.get(point.u, point.v), point);
            }
        }
    }

    /// At all distances together; `None` before there was anything to compare.
    #[must_use]
    pub fn overall(&self) -> Option<LineAccuracy> {
        self.bins.iter().fold(Bin::default(), |sum, bin| sum.plus(*bin)).accuracy(0.0, None)
    }

    /// Distance by distance, the nearest first; those of which nothing is known are left out.
    #[must_use]
    pub fn by_distance(&self) -> Vec<LineAccuracy> {
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

    fn monitor() -> LineMonitor {
        LineMonitor::new(LidarView {
            camera: CameraModel::pinhole(8, 1, 1.0),
            t_camera_laser: Pose3::identity(),
        })
    }

    fn estimate(depths_m: &[f32]) -> DepthEstimate {
        let depth = DepthMap::from_vec(depths_m.len(), 1, depths_m.to_vec()).unwrap();
        DepthEstimate { depth, confidence: vec![1.0; depths_m.len()] }
    }

    fn line(depths_m: &[f32]) -> Vec<LinePoint> {
        depths_m
            .iter()
            .enumerate()
            .map(|(u, depth_m)| LinePoint { u, v: 0, depth_m: *depth_m })
            .collect()
    }

    #[test]
    fn depth_that_is_a_tenth_too_far_is_right_and_its_scale_is_said() {
        let mut monitor = monitor();
        monitor.add(&estimate(&[1.1, 3.3, 5.5, 0.0]), &line(&[1.0, 3.0, 5.0, 3.0]));
        let all = monitor.overall().unwrap();
        assert!((all.scale - 1.1).abs() < 1e-6 && all.delta1 == 1.0, "{all:?}");
        assert!((all.share - 0.75).abs() < 1e-12, "no depth is not wrong, but is counted");
    }

    #[test]
    fn distances_are_told_apart_and_those_never_seen_are_left_out() {
        let mut monitor = monitor();
        monitor.add(&estimate(&[0.5, 1.5, 9.0]), &line(&[0.5, 1.0, 5.0]));
        let found: Vec<_> =
            monitor.by_distance().iter().map(|bin| (bin.from_m, bin.to_m, bin.delta1)).collect();
        assert_eq!(found, [(0.0, Some(1.0), 1.0), (1.0, Some(2.0), 0.0), (4.0, None, 0.0)]);
    }

    #[test]
    fn before_anything_was_compared_nothing_is_said() {
        let mut monitor = monitor();
        assert_eq!((monitor.overall(), monitor.by_distance().len()), (None, 0));
        monitor.add(&estimate(&[1.0]), &[]);
        monitor.add(&estimate(&[0.0]), &line(&[1.0]));
        monitor.add(&estimate(&[1.0]), &[LinePoint { u: 7, v: 0, depth_m: 1.0 }]);
        assert_eq!(monitor.overall(), None);
    }

    #[test]
    fn what_was_long_ago_counts_less() {
        let mut monitor = monitor();
        for (depth_m, pictures) in [(4.0, 3000), (2.0, 1800)] {
            (0..pictures).for_each(|_| monitor.add(&estimate(&[depth_m]), &line(&[2.0])));
        }
        // Three memories later, e^-3 = 5 % of what was before is left.
        let delta1 = monitor.overall().unwrap().delta1;
        assert!((delta1 - 0.95).abs() < 0.005, "{delta1}");
    }
}
