//! The part of the world that the image shows, and its place on the page.

use super::{CellState, Cells, MapPlot};

/// Space around and between the parts of the page, pixels.
pub(super) const GAP: i64 = 16;
/// Heights of the title and of the legend, pixels.
const TITLE: i64 = 58;
pub(super) const LEGEND: i64 = 86;
/// Minimum width of the page, and largest side of the map when it is scaled up, pixels.
const MIN_WIDTH: i64 = 840;
const MAP_SIDE: i64 = 1400;
/// Largest side of a cell, pixels.
const MAX_CELL: i64 = 10;
/// Margin around the known area, metres.
const MARGIN_M: f64 = 0.5;

/// An axis-aligned rectangle in the world, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    min_m: [f64; 2],
    max_m: [f64; 2],
}

impl Extent {
    pub const NOTHING: Self = Self { min_m: [f64::INFINITY; 2], max_m: [f64::NEG_INFINITY; 2] };

    pub fn add(&mut self, point_m: [f64; 2]) {
        for axis in 0..2 {
            if point_m[axis].is_finite() {
                self.min_m[axis] = self.min_m[axis].min(point_m[axis]);
                self.max_m[axis] = self.max_m[axis].max(point_m[axis]);
            }
        }
    }
}

/// The visible part of the world, its scale, and its position on the page.
#[derive(Debug)]
pub(super) struct View {
    pub min_m: [f64; 2],
    pub pixels_per_m: f64,
    pub left: i64,
    pub top: i64,
    pub width: i64,
    pub height: i64,
    pub page_width: i64,
    pub page_height: i64,
}

impl View {
    pub fn of(picture: &MapPlot<'_>) -> Self {
        let mut extent = picture.map.extent(|cell| cell != CellState::Unknown);
        picture.trajectory.iter().for_each(|pose| extent.add([pose.x_m, pose.y_m]));
        if let Some(truth) = &picture.truth {
            let floor = truth.reachable.extent(|reachable| reachable);
            extent.add(floor.min_m);
            extent.add(floor.max_m);
            truth.trajectory.iter().for_each(|pose| extent.add([pose.x_m, pose.y_m]));
        }
        if extent.min_m[0] > extent.max_m[0] || extent.min_m[1] > extent.max_m[1] {
            extent = Extent { min_m: [-1.0; 2], max_m: [1.0; 2] };
        }
        // The view begins at the corner of a cell, and a cell is a whole number of pixels, so that
        // all cells look the same.
        let cell_m = picture.map.resolution_m;
        let origin_m = picture.map.origin_m;
        let low =
            [0, 1].map(|axis| ((extent.min_m[axis] - MARGIN_M - origin_m[axis]) / cell_m).floor());
        let high =
            [0, 1].map(|axis| ((extent.max_m[axis] + MARGIN_M - origin_m[axis]) / cell_m).ceil());
        let columns = [0, 1].map(|axis| ((high[axis] - low[axis]) as i64).clamp(1, 8192));
        let cell = (MAP_SIDE / columns[0].max(columns[1])).clamp(1, MAX_CELL);
        let width = columns[0] * cell;
        let height = columns[1] * cell;
        let page_width = (width + 2 * GAP).max(MIN_WIDTH);
        Self {
            min_m: [0, 1].map(|axis| origin_m[axis] + low[axis] * cell_m),
            pixels_per_m: cell as f64 / cell_m,
            left: (page_width - width) / 2,
            top: TITLE + 6,
            width,
            height,
            page_width,
            page_height: TITLE + 6 + height + GAP + LEGEND,
        }
    }

    /// All pixels of the map.
    pub fn pixels(&self) -> impl Iterator<Item = (i64, i64)> + use<> {
        let columns = self.left..self.left + self.width;
        (self.top..self.top + self.height).flat_map(move |y| columns.clone().map(move |x| (x, y)))
    }

    /// Whether the cell at a pixel is set.
    pub fn is_set(&self, cells: &Cells<'_, bool>, x: i64, y: i64) -> bool {
        let [x_m, y_m] = self.meters(x, y);
        cells.get(x_m, y_m).unwrap_or(false)
    }

    /// Centre of a pixel in the world, metres.
    pub fn meters(&self, x: i64, y: i64) -> [f64; 2] {
        let right = (x - self.left) as f64 + 0.5;
        let up = (self.top + self.height - y) as f64 - 0.5;
        [self.min_m[0] + right / self.pixels_per_m, self.min_m[1] + up / self.pixels_per_m]
    }

    /// Pixel coordinates of a point of the world.
    pub fn pixel(&self, point_m: [f64; 2]) -> [f64; 2] {
        let right = (point_m[0] - self.min_m[0]) * self.pixels_per_m;
        let up = (point_m[1] - self.min_m[1]) * self.pixels_per_m;
        [self.left as f64 + right - 0.5, (self.top + self.height) as f64 - up - 0.5]
    }
}
