//! Rasterised floor and obstacles.

use super::distance::distance_to;
use super::grid::Grid;
use super::polygon::Polygon;
use super::{Corners, RESOLUTION_M, STEP_M, seen_from_above};

/// Holes in the floor that are narrower than twice this distance are closed, metres: gaps between
/// planks and between the triangles of a scan.
const CLOSED_GAP_M: f64 = 0.1;

/// Steeper surfaces are not floor: cosine of 45 degrees. Scanned floors are uneven.
const FLOOR_SLOPE: f64 = 0.7;

/// Maximum side of a raster, metres: a ground plane may be a kilometre wide, a home is not.
const MAX_SIDE_M: f64 = 100.0;

/// Floor and obstacles for one floor height.
#[derive(Debug, Clone)]
pub(super) struct Raster {
    pub grid: Grid,
    /// The cell contains floor, within the step height of the level.
    pub supported: Vec<bool>,
    /// An obstacle between the step height and the robot's height touches the cell.
    pub blocked: Vec<bool>,
}

impl Raster {
    pub fn new(triangles: &[Corners], grid: Grid, floor_m: f64, height_m: f64) -> Self {
        let mut raster =
            Self { grid, supported: vec![false; grid.cells()], blocked: vec![false; grid.cells()] };
        for triangle in triangles {
            if let Some(shape) = Polygon::from_band(triangle, floor_m - STEP_M, floor_m + STEP_M)
                && seen_from_above(triangle).1 > FLOOR_SLOPE
            {
                shape.for_each_cell(&grid, |cell| raster.supported[cell] = true);
            }
            if let Some(shape) = obstacle(triangle, floor_m, height_m) {
                shape.for_each_cell(&grid, |cell| raster.blocked[cell] = true);
            }
        }
        raster.close_gaps();
        raster
    }

    /// Whether the robot's centre cannot be in the cell.
    pub fn is_obstacle(&self, cell: usize) -> bool {
        self.blocked[cell] || !self.supported[cell]
    }

    fn close_gaps(&mut self) {
        let gap = CLOSED_GAP_M as f32;
        let to_floor = distance_to(&self.grid, |cell| self.supported[cell]);
        let to_void = distance_to(&self.grid, |cell| to_floor[cell] > gap);
        let width = self.grid.width;
        let height = self.grid.height;
        for (cell, supported) in self.supported.iter_mut().enumerate() {
            let column = cell % width;
            let row = cell / width;
            // Cells beyond the raster are unknown, so the rim counts as the end of the floor.
            let is_rim = column == 0 || row == 0 || column + 1 == width || row + 1 == height;
            *supported = !is_rim && (*supported || to_void[cell] > gap);
        }
    }
}

/// The part of a triangle that blocks the robot, seen from above.
pub(super) fn obstacle(triangle: &Corners, floor_m: f64, height_m: f64) -> Option<Polygon> {
    Polygon::from_band(triangle, floor_m + STEP_M, floor_m + height_m)
}

/// The grid that covers the world except for a few stray corners far away from it.
pub(super) fn region(triangles: &[Corners]) -> Grid {
    let spans = [0, 1].map(|axis| {
        let mut weighted = Vec::with_capacity(triangles.len() * 3);
        for triangle in triangles.iter().filter(|t| !is_stray(t)) {
            // Large triangles have more weight in finding the extent of the world, up to a limit.
            let weight = area(triangle).min(10.0);
            weighted.extend(triangle.iter().map(|corner| (corner[axis], weight)));
        }
        weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: f64 = weighted.iter().map(|w| w.1).sum();
        let low = weighted_quantile(1e-4, &weighted, total);
        let middle = weighted_quantile(0.5, &weighted, total);
        let high = weighted_quantile(1.0 - 1e-4, &weighted, total);
        // Margin for the rim and for what the quantiles cut off.
        let margin = 1.0 + 0.01 * (high - low);
        [
            (low - margin).max(middle - MAX_SIDE_M / 2.0),
            (high + margin).min(middle + MAX_SIDE_M / 2.0),
        ]
    });
    Grid::covering(spans.map(|s| s[0]), spans.map(|s| s[1]), RESOLUTION_M)
}

/// The value below which a share of the total weight lies. The values are sorted.
fn weighted_quantile(share: f64, weighted: &[(f64, f64)], total: f64) -> f64 {
    let mut sum = 0.0;
    let found = weighted.iter().find(|(_, weight)| {
        sum += weight;
        sum > share * total
    });
    found.or(weighted.last()).map_or(0.0, |w| w.0)
}

/// Whether a triangle is a sliver with one wrong corner: over 50 m long and 50 times as long as
/// wide.
pub(super) fn is_stray(triangle: &Corners) -> bool {
    let longest = side_length(0, 1, triangle)
        .max(side_length(1, 2, triangle))
        .max(side_length(2, 0, triangle));
    longest > 50.0 && 2.0 * area(triangle) < 0.02 * longest * longest
}

fn side_length(a: usize, b: usize, triangle: &Corners) -> f64 {
    (0..3).map(|i| (triangle[a][i] - triangle[b][i]).powi(2)).sum::<f64>().sqrt()
}

fn area(corners: &Corners) -> f64 {
    let [a, b, c] = corners;
    let u: [f64; 3] = std::array::from_fn(|i| b[i] - a[i]);
    let v: [f64; 3] = std::array::from_fn(|i| c[i] - a[i]);
    let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    normal.iter().map(|c| c * c).sum::<f64>().sqrt() / 2.0
}
