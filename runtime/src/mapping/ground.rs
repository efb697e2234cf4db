//! What a depth frame sees where the floor should be: the floor, or a drop such as stairs down.
//!
//! A ray that goes down meets the plane of the floor at a known range. A point clearly behind that
//! place lies below the floor, so there is no floor where the ray crosses its plane.

use super::rays::{Ray, View};
use super::{Cell, MapConfig};

/// The error that confidence speaks of: it is the probability of a depth within 25 %.
const CONFIDENT_FACTOR: f32 = 1.25;
/// Slope by which floor and camera may be tilted against each other. A finished floor may rise
/// 4 mm on 1 m (DIN 18202, table 3, line 3); the pitch of a robot on its wheels gets as much.
const SLOPE: f32 = 0.008;
/// Side of the patches in which points have to agree, metres. At 4 m, used rows of the default
/// camera are 12 cm apart on the floor and its used columns 5 cm.
const PATCH_M: f32 = 0.2;
/// A patch holds a drop when this share of its points says so. The patch at the edge of stairs
/// holds floor as well.
const DROP_SHARE: f32 = 0.25;

/// The observation of the ground in one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GroundCell {
    pub cell: Cell,
    /// Log-odds to add: positive for a drop, negative for floor.
    pub evidence: f32,
}

/// Collects the points of one frame that say something about the floor.
#[derive(Debug, Clone)]
pub(super) struct Ground {
    config: MapConfig,
    drop_log_error: f32,
    obstacle_log_error: f32,
    /// Patches along one side of the square around the camera.
    side: usize,
    patches: Vec<Patch>,
    points: Vec<GroundPoint>,
    seen: Vec<GroundCell>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Patch {
    points: u16,
    drops: u16,
}

/// A point, at the place where its ray meets the plane of the floor.
#[derive(Debug, Clone, Copy)]
struct GroundPoint {
    cell: Cell,
    patch: u32,
    confidence: f32,
    is_drop: bool,
}

impl Ground {
    pub fn new(config: &MapConfig) -> Self {
        let side = 2 * ((config.drop_range_m / PATCH_M).ceil() as usize + 1);
        Self {
            config: config.clone(),
            drop_log_error: log_error(config.drop_certainty),
            obstacle_log_error: log_error(config.obstacle_certainty),
            side,
            patches: vec![Patch::default(); side * side],
            points: Vec::new(),
            seen: Vec::new(),
        }
    }

    /// Forgets the frame before.
    pub fn reset(&mut self) {
        for point in self.points.drain(..) {
            self.patches[point.patch as usize] = Patch::default();
        }
        self.seen.clear();
    }

    /// Adds the point of a ray at a depth, if it is floor or below it. Whether it is a drop.
    pub fn add(&mut self, ray: &Ray, view: &View, depth_m: f32, confidence: f32) -> bool {
        let crossing_m = ray.leaves_band_m;
        if ray.slope >= 0.0 || crossing_m > self.config.drop_range_m {
            return false;
        }
        let range_m = depth_m * ray.range;
        let height_m = view.height_m + depth_m * ray.rise;
        let tolerance_m = self.config.drop_min_m + SLOPE * range_m;
        let is_floor = height_m.abs() <= tolerance_m;
        let is_drop = height_m < -tolerance_m
            && is_larger(range_m / crossing_m, confidence, self.drop_log_error);
        if is_floor || is_drop {
            self.push(ray, view, confidence, is_drop);
        }
        is_drop
    }

    /// Whether a point above the floor, at a range in the plane, is certainly nearer than the floor behind it.
    pub fn is_obstacle(&self, ray: &Ray, range_m: f32, confidence: f32) -> bool {
        ray.slope >= 0.0
            || is_larger(ray.leaves_band_m / range_m, confidence, self.obstacle_log_error)
    }

    fn push(&mut self, ray: &Ray, view: &View, confidence: f32, is_drop: bool) {
        let depth_m = ray.leaves_band_m / ray.range;
        let forward_m = depth_m * ray.forward;
        let right_m = depth_m * ray.right;
        let dx_m = forward_m * view.heading[0] + right_m * view.heading[1];
        let dy_m = forward_m * view.heading[1] - right_m * view.heading[0];
        let per_cell = 1.0 / self.config.cell_m as f32;
        let column = ((view.x_m + dx_m) * per_cell).floor() as i32;
        let row = ((view.y_m + dy_m) * per_cell).floor() as i32;
        let half_m = (self.side / 2) as f32 * PATCH_M;
        let across = ((dx_m + half_m) / PATCH_M) as usize;
        let along = ((dy_m + half_m) / PATCH_M) as usize;
        let index = along * self.side + across;
        let Some(patch) = self.patches.get_mut(index) else { return };
        patch.points = patch.points.saturating_add(1);
        patch.drops = patch.drops.saturating_add(u16::from(is_drop));
        let cell = view.corner.offset(column, row);
        self.points.push(GroundPoint { cell, patch: index as u32, confidence, is_drop });
    }

    /// Decides which patches hold drops. Call it when all points are added.
    ///
    /// Depth that is wrong as a whole, as while the robot rotates on the spot, shows no floor where
    /// the floor is. So drops count only in a frame that shows at least as much floor.
    pub fn finish(&mut self) {
        let drops = self.points.iter().filter(|point| point.is_drop).count();
        if 2 * drops > self.points.len() {
            return;
        }
        for point in &self.points {
            let patch = self.patches[point.patch as usize];
            let enough =
                f32::from(self.config.min_points).max(DROP_SHARE * f32::from(patch.points));
            let holds_drop = f32::from(patch.drops) >= enough;
            let confidence = point.confidence.max(f32::MIN_POSITIVE);
            let evidence = match (holds_drop, point.is_drop) {
                (true, true) => self.config.occupied_increment * confidence,
                (false, false) => -self.config.free_decrement * confidence,
                _ => continue,
            };
            self.seen.push(GroundCell { cell: point.cell, evidence });
        }
    }

    /// The cells in which this frame saw a drop or floor; a cell may come several times.
    pub fn seen(&self) -> &[GroundCell] {
        &self.seen
    }
}

/// Error of the logarithm of a depth, with this probability, if the inverse hyperbolic tangent of its confidence is 1.
///
/// The logarithm of a depth is taken to have a logistic error, whose probability of being below `a` is tanh(a / 2s). Confidence
/// gives its scale s.
pub(super) fn log_error(certainty: f32) -> f32 {
    CONFIDENT_FACTOR.ln() * certainty.atanh()
}

/// Whether the factor between two depths is certainly more than the error of a depth with this confidence.
pub(super) fn is_larger(factor: f32, confidence: f32, log_error: f32) -> bool {
    factor.ln() > log_error / confidence.atanh()
}
