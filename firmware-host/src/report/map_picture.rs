//! `map.png`: an image of the map with the path of the robot, its goals and its safety stops.

use std::path::Path;

use hal::Pose2;
pub use runtime::mapping::CellState;

use super::{
    atomic::ReportError,
    canvas::{Canvas, Font},
    colors::{self, Rgb},
};

/// Name of the file in the output directory.
pub const MAP_FILE: &str = "map.png";

const PAGE: Rgb = [255, 255, 255];
const UNKNOWN: Rgb = [222, 226, 230];
const FREE: Rgb = [252, 252, 250];
const OCCUPIED: Rgb = [52, 58, 70];
const PLAN: Rgb = [70, 130, 180];
const INK: Rgb = [40, 44, 52];
const FAINT: Rgb = [120, 126, 136];
const START: Rgb = [46, 140, 70];
const END: Rgb = [239, 108, 0];
const TRIP: Rgb = [205, 30, 45];
const GOAL: Rgb = [0, 137, 150];

/// Space around and between the parts, pixels.
const GAP: i64 = 16;
/// Heights of the title and of the legend, pixels.
const TITLE: i64 = 36;
const LEGEND: i64 = 60;
/// Minimum width of the page, and largest side of the map when it is scaled up, pixels.
const MIN_WIDTH: i64 = 840;
const MAP_SIDE: i64 = 1400;
/// Largest side of a cell, pixels.
const MAX_CELL: i64 = 10;
/// Margin around the known area, metres.
const MARGIN_M: f64 = 0.5;

/// A grid of square cells. Row 0 has the lowest y, column 0 the lowest x.
#[derive(Debug, Clone, Copy)]
pub struct Cells<'a, T> {
    /// Number of columns.
    pub width: usize,
    /// Row-major; the length must be a multiple of `width`.
    pub cells: &'a [T],
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Outer corner of the first cell in the world, metres.
    pub origin_m: [f64; 2],
}

impl<T: Copy> Cells<'_, T> {
    fn get(&self, x_m: f64, y_m: f64) -> Option<T> {
        let [column, row] = [x_m - self.origin_m[0], y_m - self.origin_m[1]]
            .map(|along| (along / self.resolution_m).floor());
        let inside = column >= 0.0 && row >= 0.0 && (column as usize) < self.width;
        inside
            .then(|| self.cells.get(row as usize * self.width + column as usize).copied())
            .flatten()
    }

    fn check(&self, what: &'static str) -> Result<(), ReportError> {
        let height = self.cells.len().checked_div(self.width).unwrap_or(0);
        let sound = self.width * height == self.cells.len()
            && self.resolution_m > 0.0
            && self.resolution_m.is_finite();
        if sound {
            return Ok(());
        }
        Err(ReportError::Shape { what, width: self.width, height, actual: self.cells.len() })
    }

    /// Bounding box of the cells for which `is_shown` is true, metres.
    fn extent(&self, is_shown: impl Fn(T) -> bool) -> Extent {
        let mut extent = Extent::NOTHING;
        for (index, _) in self.cells.iter().enumerate().filter(|(_, cell)| is_shown(**cell)) {
            for corner in [0, 1] {
                let column = index % self.width + corner;
                let row = index / self.width + corner;
                extent.add([
                    self.origin_m[0] + column as f64 * self.resolution_m,
                    self.origin_m[1] + row as f64 * self.resolution_m,
                ]);
            }
        }
        extent
    }
}

/// The content of the image. All positions are in the frame of the map, in metres.
#[derive(Debug, Clone, Copy)]
pub struct MapPlot<'a> {
    /// Title line that names the run.
    pub title: &'a str,
    pub map: Cells<'a, CellState>,
    /// Pose of the robot in each frame.
    pub trajectory: &'a [Pose2],
    /// Goals of the exploration.
    pub goals: &'a [[f64; 2]],
    /// Obstacles for which the safety plane stopped the robot.
    pub trips: &'a [[f64; 2]],
    /// Ground truth of the reachable floor, if it is known.
    pub reachable: Option<Cells<'a, bool>>,
}

impl MapPlot<'_> {
    /// Draws the image and writes `map.png` into `dir`.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn write(&self, dir: &Path) -> Result<(), ReportError> {
        self.draw()?.write_png(&dir.join(MAP_FILE))
    }

    /// Draws the image.
    ///
    /// # Errors
    /// [`ReportError::Shape`].
    pub fn draw(&self) -> Result<Canvas, ReportError> {
        self.map.check("map")?;
        if let Some(reachable) = &self.reachable {
            reachable.check("reachable floor")?;
        }
        let view = View::of(self);
        let mut canvas = Canvas::new(view.page_width as u32, view.page_height as u32, PAGE);
        canvas.text(
            GAP,
            10,
            &Font::Title.fit(self.title, view.page_width - 2 * GAP),
            Font::Title,
            INK,
        );
        self.draw_cells(&mut canvas, &view);
        self.draw_plan(&mut canvas, &view);
        self.draw_trajectory(&mut canvas, &view);
        self.draw_markers(&mut canvas, &view);
        canvas.frame(view.left - 1, view.top - 1, view.width + 2, view.height + 2, [190, 195, 200]);
        draw_scale_bar(&mut canvas, &view);
        self.draw_legend(&mut canvas, &view);
        Ok(canvas)
    }

    fn draw_cells(&self, canvas: &mut Canvas, view: &View) {
        for y in view.top..view.top + view.height {
            for x in view.left..view.left + view.width {
                let [x_m, y_m] = view.meters(x, y);
                let color = match self.map.get(x_m, y_m).unwrap_or(CellState::Unknown) {
                    CellState::Unknown => UNKNOWN,
                    CellState::Free => FREE,
                    CellState::Occupied => OCCUPIED,
                };
                canvas.blend(x, y, color, 1.0);
            }
        }
    }

    /// Draws the outline of the reachable floor.
    fn draw_plan(&self, canvas: &mut Canvas, view: &View) {
        let Some(plan) = &self.reachable else { return };
        for y in view.top..view.top + view.height {
            for x in view.left..view.left + view.width {
                let here = view.is_set(plan, x, y);
                if here != view.is_set(plan, x + 1, y) || here != view.is_set(plan, x, y + 1) {
                    canvas.blend(x, y, PLAN, 0.55);
                }
            }
        }
    }

    fn draw_trajectory(&self, canvas: &mut Canvas, view: &View) {
        let last = self.trajectory.len().saturating_sub(1).max(1) as f64;
        let mut points: Vec<(f64, [f64; 2])> = Vec::new();
        for (index, pose) in self.trajectory.iter().enumerate() {
            let at = view.pixel([pose.x_m, pose.y_m]);
            // Steps shorter than a pixel are invisible and only cost time.
            let far = points
                .last()
                .is_none_or(|(_, from)| (at[0] - from[0]).hypot(at[1] - from[1]) >= 1.0);
            if pose.is_finite() && (far || index + 1 == self.trajectory.len()) {
                points.push((index as f64 / last, at));
            }
        }
        for pair in points.windows(2) {
            canvas.line(pair[0].1, pair[1].1, 5.0, FREE, 0.8);
        }
        for pair in points.windows(2) {
            canvas.line(pair[0].1, pair[1].1, 2.6, colors::time(pair[1].0), 1.0);
        }
    }

    fn draw_markers(&self, canvas: &mut Canvas, view: &View) {
        for goal in self.goals {
            goal_marker(canvas, view.pixel(*goal));
        }
        for trip in self.trips {
            trip_marker(canvas, view.pixel(*trip));
        }
        if let (Some(start), Some(end)) = (self.trajectory.first(), self.trajectory.last()) {
            dot(canvas, view.pixel([start.x_m, start.y_m]), START);
            arrow(canvas, view, end);
        }
    }

    fn draw_legend(&self, canvas: &mut Canvas, view: &View) {
        let mut row = Legend { x: GAP, y: view.page_height - LEGEND };
        for (color, label) in [(FREE, "free"), (OCCUPIED, "occupied"), (UNKNOWN, "unknown")] {
            row.swatch(canvas, color, label);
        }
        if self.reachable.is_some() {
            canvas.line(
                [row.x as f64, row.y as f64 + 8.0],
                [row.x as f64 + 14.0, row.y as f64 + 8.0],
                1.5,
                PLAN,
                0.8,
            );
            row.label(canvas, "true reachable floor");
        }
        let mut row = Legend { x: GAP, y: view.page_height - LEGEND + 26 };
        for step in 0..90 {
            canvas.fill(row.x + step, row.y + 4, 1, 8, colors::time(step as f64 / 89.0));
        }
        row.x += 76;
        row.label(canvas, &format!("path, frame 0 to {}", self.trajectory.len().saturating_sub(1)));
        dot(canvas, row.marker(), START);
        row.label(canvas, "start");
        dot(canvas, row.marker(), END);
        row.label(canvas, "end");
        if !self.goals.is_empty() {
            goal_marker(canvas, row.marker());
            row.label(canvas, "goal");
        }
        if !self.trips.is_empty() {
            trip_marker(canvas, row.marker());
            row.label(canvas, "safety stop");
        }
    }
}

/// Position of the next entry of a row of the legend, pixels.
struct Legend {
    x: i64,
    y: i64,
}

impl Legend {
    fn swatch(&mut self, canvas: &mut Canvas, color: Rgb, label: &str) {
        canvas.fill(self.x, self.y + 1, 14, 14, color);
        canvas.frame(self.x, self.y + 1, 14, 14, FAINT);
        self.label(canvas, label);
    }

    /// Centre of the marker of the next entry.
    fn marker(&self) -> [f64; 2] {
        [self.x as f64 + 7.0, self.y as f64 + 8.0]
    }

    /// Draws the label beside a marker that is 14 pixels wide, and moves on to the next entry.
    fn label(&mut self, canvas: &mut Canvas, label: &str) {
        canvas.text(self.x + 20, self.y, label, Font::Label, INK);
        self.x += 20 + Font::Label.width(label) + 20;
    }
}

fn dot(canvas: &mut Canvas, center: [f64; 2], color: Rgb) {
    canvas.disc(center, 7.5, PAGE);
    canvas.disc(center, 6.0, color);
}

fn goal_marker(canvas: &mut Canvas, center: [f64; 2]) {
    canvas.diamond(center, 7.0, PAGE);
    canvas.diamond(center, 5.5, GOAL);
    canvas.diamond(center, 2.5, PAGE);
}

fn trip_marker(canvas: &mut Canvas, center: [f64; 2]) {
    canvas.cross(center, 4.0, 4.5, PAGE);
    canvas.cross(center, 4.0, 2.2, TRIP);
}

/// Draws the last pose of the robot with its heading.
fn arrow(canvas: &mut Canvas, view: &View, pose: &Pose2) {
    let at = view.pixel([pose.x_m, pose.y_m]);
    let tip = [at[0] + 15.0 * pose.yaw_rad.cos(), at[1] - 15.0 * pose.yaw_rad.sin()];
    canvas.line(at, tip, 5.5, PAGE, 1.0);
    canvas.line(at, tip, 3.0, END, 1.0);
    dot(canvas, at, END);
}

/// Draws a scale bar of 1 m, or of 10 m if 1 m is too short to see.
fn draw_scale_bar(canvas: &mut Canvas, view: &View) {
    let length_m = if view.pixels_per_m < 20.0 { 10.0 } else { 1.0 };
    let length = (length_m * view.pixels_per_m).round() as i64;
    let x = view.left + 14;
    let y = view.top + view.height - 20;
    canvas.fill(x - 6, y - 24, length.max(40) + 12, 36, PAGE);
    canvas.fill(x, y, length, 4, INK);
    canvas.text(x, y - 20, &format!("{length_m} m"), Font::Label, INK);
}

/// An axis-aligned rectangle in the world, metres.
#[derive(Debug, Clone, Copy)]
struct Extent {
    min_m: [f64; 2],
    max_m: [f64; 2],
}

impl Extent {
    const NOTHING: Self = Self { min_m: [f64::INFINITY; 2], max_m: [f64::NEG_INFINITY; 2] };

    fn add(&mut self, point_m: [f64; 2]) {
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
struct View {
    min_m: [f64; 2],
    pixels_per_m: f64,
    left: i64,
    top: i64,
    width: i64,
    height: i64,
    page_width: i64,
    page_height: i64,
}

impl View {
    fn of(picture: &MapPlot<'_>) -> Self {
        let mut extent = picture.map.extent(|cell| cell != CellState::Unknown);
        if let Some(reachable) = &picture.reachable {
            let floor = reachable.extent(|reachable| reachable);
            extent.add(floor.min_m);
            extent.add(floor.max_m);
        }
        picture.trajectory.iter().for_each(|pose| extent.add([pose.x_m, pose.y_m]));
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

    /// Whether the cell at a pixel is set.
    fn is_set(&self, cells: &Cells<'_, bool>, x: i64, y: i64) -> bool {
        let [x_m, y_m] = self.meters(x, y);
        cells.get(x_m, y_m).unwrap_or(false)
    }

    /// Centre of a pixel in the world, metres.
    fn meters(&self, x: i64, y: i64) -> [f64; 2] {
        let right = (x - self.left) as f64 + 0.5;
        let up = (self.top + self.height - y) as f64 - 0.5;
        [self.min_m[0] + right / self.pixels_per_m, self.min_m[1] + up / self.pixels_per_m]
    }

    /// Pixel coordinates of a point of the world.
    fn pixel(&self, point_m: [f64; 2]) -> [f64; 2] {
        let right = (point_m[0] - self.min_m[0]) * self.pixels_per_m;
        let up = (point_m[1] - self.min_m[1]) * self.pixels_per_m;
        [self.left as f64 + right - 0.5, (self.top + self.height) as f64 - up - 0.5]
    }
}

#[cfg(test)]
#[path = "map_picture_tests.rs"]
mod tests;
