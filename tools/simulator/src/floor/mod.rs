//! The floor: where the robot can be.

mod distance;
mod level;
mod raster;

use hal::Pose2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::scene::Scene;
use raster::Frame;

/// What is at most this far above or below the floor is floor: rugs, thresholds, uneven scans. Metres.
const STEP_M: f64 = 0.06;
/// What stands at these heights above the floor is in the robot's way, metres.
const BAND_M: [f64; 2] = [0.07, 0.9];
/// Cells of the plan, metres.
const CELL_M: f64 = 0.04;
/// A start has more clearance than this share of all free places.
const START_QUANTILE: f64 = 0.6;

/// Height of the floor that a round robot has most room on, in the scene's own coordinates (z up). `None`: there is none.
#[must_use]
pub fn find_level(scene: &Scene, radius_m: f64) -> Option<f64> {
    level::find(scene, radius_m)
}

/// The floor at z = 0 as a grid. Distances between cells are exact; the cells themselves make walls up to 4 cm thicker.
#[derive(Debug, Clone)]
pub struct FloorPlan {
    frame: Frame,
    radius_m: f64,
    /// Floor without anything in the way.
    open: Vec<bool>,
    /// Distance to what is not open, metres.
    clearance_m: Vec<f32>,
    /// The largest connected part of where the robot's middle can be.
    largest: Vec<usize>,
}

impl FloorPlan {
    /// Makes the plan of a scene whose floor is at z = 0. `None` when a robot of this radius fits nowhere.
    #[must_use]
    pub fn new(scene: &Scene, radius_m: f64) -> Option<Self> {
        let (low, high) = level::bounds(scene)?;
        let frame = Frame::covering(low, high, CELL_M);
        let mut supported = vec![false; frame.cells()];
        let mut blocked = vec![false; frame.cells()];
        for triangle in &scene.triangles {
            frame.mark(triangle, [-STEP_M, STEP_M], false, &mut supported);
            frame.mark(triangle, BAND_M, true, &mut blocked);
        }
        close_seams(&mut supported, &frame);
        let open: Vec<bool> = supported.iter().zip(&blocked).map(|(floor, wall)| *floor && !*wall).collect();
        let cells = distance::to_closed(&open, &frame);
        // From the middle of a closed cell to its edge is half a cell.
        let clearance_m: Vec<f32> = cells.iter().map(|d| ((f64::from(*d) - 0.5) * CELL_M).max(0.0) as f32).collect();
        let free: Vec<bool> = clearance_m.iter().map(|clearance| f64::from(*clearance) >= radius_m).collect();
        let largest = components(&free, &frame).into_iter().max_by_key(Vec::len)?;
        Some(Self { frame, radius_m, open, clearance_m, largest })
    }

    /// Side of a cell, metres.
    #[must_use]
    pub fn resolution_m(&self) -> f64 {
        self.frame.cell_m
    }

    /// Outer corner of the first cell in the world, metres.
    #[must_use]
    pub fn origin_m(&self) -> [f64; 2] {
        self.frame.origin_m
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.frame.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.frame.height
    }

    /// Distance from a place to the nearest obstacle or edge of the floor, metres; 0 within one.
    #[must_use]
    pub fn clearance_m(&self, x_m: f64, y_m: f64) -> f64 {
        let Frame { origin_m, cell_m, width, height } = self.frame;
        let (u, v) = ((x_m - origin_m[0]) / cell_m - 0.5, (y_m - origin_m[1]) / cell_m - 0.5);
        if !(u >= 0.0 && v >= 0.0 && u < (width - 1) as f64 && v < (height - 1) as f64) {
            return 0.0;
        }
        let (column, row) = (u as usize, v as usize);
        let (right, up) = (u.fract(), v.fract());
        let at = |dc: usize, dr: usize| f64::from(self.clearance_m[(row + dr) * width + column + dc]);
        let low = at(0, 0) * (1.0 - right) + at(1, 0) * right;
        let high = at(0, 1) * (1.0 - right) + at(1, 1) * right;
        low * (1.0 - up) + high * up
    }

    /// Whether the footprint fits around a place.
    #[must_use]
    pub fn is_free(&self, x_m: f64, y_m: f64) -> bool {
        self.clearance_m(x_m, y_m) >= self.radius_m
    }

    /// The place nearest to (`x_m`, `y_m`) in the largest connected part of the floor where the footprint fits.
    #[must_use]
    pub fn nearest_free(&self, x_m: f64, y_m: f64) -> [f64; 2] {
        let far = |index: &usize| {
            let [cx, cy] = self.frame.center_m(*index);
            (cx - x_m).hypot(cy - y_m)
        };
        let nearest = self.largest.iter().min_by(|a, b| far(a).total_cmp(&far(b)));
        nearest.map_or([x_m, y_m], |index| self.frame.center_m(*index))
    }

    /// A random place where the footprint fits.
    pub fn random_free(&self, rng: &mut Pcg64Mcg) -> Option<[f64; 2]> {
        let index = self.largest.get(rng.random_range(0..self.largest.len().max(1)))?;
        Some(self.frame.center_m(*index))
    }

    /// A place with much room around it, looking where the way is longest.
    #[must_use]
    pub fn start_pose(&self, seed: u64) -> Option<Pose2> {
        let mut clearances: Vec<f32> = self.largest.iter().map(|index| self.clearance_m[*index]).collect();
        clearances.sort_by(f32::total_cmp);
        let least = *clearances.get((clearances.len() as f64 * START_QUANTILE) as usize)?;
        let roomy: Vec<usize> =
            self.largest.iter().copied().filter(|index| self.clearance_m[*index] >= least).collect();
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let [x_m, y_m] = self.frame.center_m(*roomy.get(rng.random_range(0..roomy.len().max(1)))?);
        let directions = (0..32).map(|i| f64::from(i) * std::f64::consts::TAU / 32.0);
        let yaw = directions.max_by(|a, b| self.way_m(x_m, y_m, *a).total_cmp(&self.way_m(x_m, y_m, *b)))?;
        Some(Pose2::new(x_m, y_m, yaw))
    }

    /// How far the robot could drive straight on, metres.
    fn way_m(&self, x_m: f64, y_m: f64, yaw_rad: f64) -> f64 {
        let (sin, cos) = yaw_rad.sin_cos();
        let free = |step: &u32| {
            let way = f64::from(*step) * CELL_M;
            self.is_free(x_m + way * cos, y_m + way * sin)
        };
        f64::from((1..1000).take_while(free).count() as u32) * CELL_M
    }

    /// The floor that the footprint can cover from a start: row-major, true where it can.
    #[must_use]
    pub fn reachable_floor(&self, from: &Pose2) -> Vec<bool> {
        let mut free: Vec<bool> = self.clearance_m.iter().map(|c| f64::from(*c) >= self.radius_m).collect();
        let mut covered = vec![false; self.frame.cells()];
        let [x_m, y_m] = self.nearest_free_from(from);
        let Some(start) = self.frame.index(x_m, y_m) else { return covered };
        let reach = (self.radius_m / CELL_M).ceil() as i64;
        for index in take_connected(start, &mut free, &self.frame) {
            let (column, row) = ((index % self.frame.width) as i64, (index / self.frame.width) as i64);
            for (dc, dr) in (-reach..=reach).flat_map(|dr| (-reach..=reach).map(move |dc| (dc, dr))) {
                let near = ((dc * dc + dr * dr) as f64).sqrt() * CELL_M <= self.radius_m;
                let (c, r) = (column + dc, row + dr);
                let inside = (0..self.frame.width as i64).contains(&c) && (0..self.frame.height as i64).contains(&r);
                let at = (r * self.frame.width as i64 + c) as usize;
                if near && inside && self.open[at] {
                    covered[at] = true;
                }
            }
        }
        covered
    }

    /// The start itself when its cell is free, else the nearest free cell: a start may stand between cell middles.
    fn nearest_free_from(&self, from: &Pose2) -> [f64; 2] {
        let free = |index: usize| f64::from(self.clearance_m[index]) >= self.radius_m;
        let here = self.frame.index(from.x_m, from.y_m).filter(|index| free(*index));
        if here.is_some() {
            return [from.x_m, from.y_m];
        }
        let far = |index: &usize| {
            let [cx, cy] = self.frame.center_m(*index);
            (cx - from.x_m).hypot(cy - from.y_m)
        };
        let nearest = (0..self.frame.cells()).filter(|index| free(*index)).min_by(|a, b| far(a).total_cmp(&far(b)));
        nearest.map_or([from.x_m, from.y_m], |index| self.frame.center_m(index))
    }

    /// Area of the largest connected part of where the robot's middle can be, square metres.
    #[must_use]
    pub fn largest_m2(&self) -> f64 {
        self.largest.len() as f64 * CELL_M * CELL_M
    }
}

/// Connected parts (4 neighbours) of the cells that are set, in the order of their first cells.
fn components(set: &[bool], frame: &Frame) -> Vec<Vec<usize>> {
    let mut left = set.to_vec();
    (0..set.len()).map(|start| take_connected(start, &mut left, frame)).filter(|part| !part.is_empty()).collect()
}

/// Takes the cells connected to `start` out of `left`.
fn take_connected(start: usize, left: &mut [bool], frame: &Frame) -> Vec<usize> {
    if !std::mem::take(&mut left[start]) {
        return Vec::new();
    }
    let mut taken = vec![start];
    let mut next = 0;
    while let Some(index) = taken.get(next).copied() {
        next += 1;
        taken.extend(frame.neighbours(index).filter(|neighbour| std::mem::take(&mut left[*neighbour])));
    }
    taken
}

/// Fills gaps of one cell between floor tiles: seams of scans, not holes to fall into.
fn close_seams(supported: &mut [bool], frame: &Frame) {
    let before = supported.to_vec();
    for index in 0..before.len() {
        let (left_right, up_down): (Vec<usize>, Vec<usize>) =
            frame.neighbours(index).partition(|neighbour| neighbour.abs_diff(index) == 1);
        let both = |pair: &[usize]| pair.len() == 2 && pair.iter().all(|neighbour| before[*neighbour]);
        supported[index] |= both(&left_right) || both(&up_down);
    }
}

#[cfg(test)]
mod tests;
