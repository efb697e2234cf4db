//! `map.png`: an image of the map with the path of the robot, its goals and its safety stops, and the
//! true home where it is known.

mod legend;
mod marks;
#[cfg(test)]
mod tests;
mod view;

use std::path::Path;

use hal::Pose2;
pub use runtime::mapping::CellState;

use super::{
    atomic::ReportError,
    canvas::{Canvas, Font},
    colors::{self, Rgb},
};
use view::{Extent, GAP, View};

/// Name of the file in the output directory.
pub const MAP_FILE: &str = "map.png";

pub(super) const PAGE: Rgb = [255, 255, 255];
pub(super) const UNKNOWN: Rgb = [222, 226, 230];
pub(super) const FREE: Rgb = [252, 252, 250];
pub(super) const OCCUPIED: Rgb = [52, 58, 70];
/// Colour of occupied cells that are far from any true obstacle.
const OFF: Rgb = [222, 72, 60];
/// Colour of true obstacles that are not in the map.
const MISSED: Rgb = [158, 198, 232];
const PLAN: Rgb = [70, 130, 180];
const BELIEVED: Rgb = [0, 150, 60];
pub(super) const INK: Rgb = [40, 44, 52];
pub(super) const FAINT: Rgb = [120, 126, 136];
const GRID: Rgb = [150, 158, 168];
const START: Rgb = [46, 140, 70];
pub(super) const END: Rgb = [239, 108, 0];
const TRIP: Rgb = [205, 30, 45];
const GOAL: Rgb = [0, 137, 150];
/// Colour of goals that were resolved before the robot reached them.
const SEEN: Rgb = [110, 190, 200];

/// An occupied cell whose distance to the nearest true obstacle is larger is drawn as wrong, metres.
const OFF_M: f64 = 0.1;
/// Width of the lines as which true walls are drawn, metres.
const WALL_LINE_M: f32 = 0.02;

/// A grid of square cells. Row 0 has the lowest y, column 0 the lowest x.
#[derive(Debug, Clone, Copy)]
pub struct Cells<'a, T> {
    /// Number of columns of the grid.
    pub width: usize,
    /// Row-major; the length must be a multiple of `width`.
    pub cells: &'a [T],
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Outer corner of the first cell in the world, metres.
    pub origin_m: [f64; 2],
}

impl<T: Copy> Cells<'_, T> {
    /// The cell at a point; `None` outside of the grid.
    pub(super) fn get(&self, x_m: f64, y_m: f64) -> Option<T> {
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

/// Ground truth about the home. Positions are in the frame of the map, in metres.
#[derive(Debug, Clone, Copy)]
pub struct TrueHome<'a> {
    pub reachable: Cells<'a, bool>,
    /// Distance from the centre of each cell to the nearest obstacle, metres.
    pub to_obstacle_m: Cells<'a, f32>,
    /// True pose of the robot in each frame.
    pub trajectory: &'a [Pose2],
}

/// The outcome of a goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalFate {
    /// The robot is driving to the goal.
    Open,
    Reached,
    /// The frontier or inconsistency was resolved before the robot reached the goal.
    Seen,
    /// The robot gave up the goal.
    Dropped,
}

impl GoalFate {
    /// All fates, in the order of drawing.
    pub(super) const ALL: [Self; 4] = [Self::Open, Self::Reached, Self::Seen, Self::Dropped];

    /// Words that follow a number of goals.
    pub(super) fn name(self, count: usize) -> &'static str {
        match (self, count) {
            (Self::Open, _) => "current goal",
            (Self::Reached, 1) => "goal reached",
            (Self::Reached, _) => "goals reached",
            (Self::Seen, _) => "seen from afar",
            (Self::Dropped, _) => "given up",
        }
    }
}

/// A goal of the exploration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    pub at_m: [f64; 2],
    pub fate: GoalFate,
}

/// The content of the image. All positions are in the frame of the map, in metres.
#[derive(Debug, Clone, Copy)]
pub struct MapPlot<'a> {
    /// Title line that names the run.
    pub title: &'a str,
    /// Second line, with figures; may be empty.
    pub figures: &'a str,
    pub map: Cells<'a, CellState>,
    /// Pose of the robot in each frame, as it believed.
    pub trajectory: &'a [Pose2],
    pub goals: &'a [Goal],
    /// Obstacles for which the safety plane stopped the robot.
    pub trips: &'a [[f64; 2]],
    /// Ground truth, if it is known.
    pub truth: Option<TrueHome<'a>>,
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
        if let Some(truth) = &self.truth {
            truth.reachable.check("reachable floor")?;
            truth.to_obstacle_m.check("distance to obstacles")?;
        }
        let view = View::of(self);
        let mut canvas = Canvas::new(view.page_width as u32, view.page_height as u32, PAGE);
        let width = view.page_width - 2 * GAP;
        canvas.text(GAP, 10, &Font::Title.fit(self.title, width), Font::Title, INK);
        canvas.text(GAP, 36, &Font::Label.fit(self.figures, width), Font::Label, FAINT);
        self.draw_cells(&mut canvas, &view);
        draw_grid(&mut canvas, &view);
        if self.truth.is_none() {
            draw_coordinates(&mut canvas, &view);
        }
        self.draw_reachable(&mut canvas, &view);
        self.draw_paths(&mut canvas, &view);
        self.draw_markers(&mut canvas, &view);
        canvas.frame(view.left - 1, view.top - 1, view.width + 2, view.height + 2, [190, 195, 200]);
        draw_scale_bar(&mut canvas, &view);
        legend::draw(self, &mut canvas, &view);
        Ok(canvas)
    }

    fn draw_cells(&self, canvas: &mut Canvas, view: &View) {
        for (x, y) in view.pixels() {
            canvas.blend(x, y, self.color(view.meters(x, y)), 1.0);
        }
    }

    fn color(&self, [x_m, y_m]: [f64; 2]) -> Rgb {
        let to_obstacle_m = self.truth.and_then(|truth| truth.to_obstacle_m.get(x_m, y_m));
        match self.map.get(x_m, y_m).unwrap_or(CellState::Unknown) {
            CellState::Occupied => match to_obstacle_m {
                Some(distance_m) if f64::from(distance_m) > OFF_M => OFF,
                _ => OCCUPIED,
            },
            _ if to_obstacle_m.is_some_and(|distance_m| distance_m < WALL_LINE_M) => MISSED,
            CellState::Unknown => UNKNOWN,
            CellState::Free => FREE,
        }
    }

    /// Draws the outline of the reachable floor.
    fn draw_reachable(&self, canvas: &mut Canvas, view: &View) {
        let Some(floor) = self.truth.map(|truth| truth.reachable) else { return };
        for (x, y) in view.pixels() {
            let here = view.is_set(&floor, x, y);
            if here != view.is_set(&floor, x + 1, y) || here != view.is_set(&floor, x, y + 1) {
                canvas.blend(x, y, PLAN, 0.55);
            }
        }
    }

    fn draw_paths(&self, canvas: &mut Canvas, view: &View) {
        let Some(truth) = &self.truth else {
            return draw_timed(canvas, &steps(self.trajectory, view));
        };
        // The believed path is below the true one, so that it is seen only where it is wrong.
        for pair in steps(self.trajectory, view).windows(2) {
            canvas.line(pair[0].1, pair[1].1, 2.0, BELIEVED, 1.0);
        }
        draw_timed(canvas, &steps(truth.trajectory, view));
    }

    /// The true path where it is known, otherwise the believed one.
    fn path(&self) -> &[Pose2] {
        self.truth.map_or(self.trajectory, |truth| truth.trajectory)
    }

    fn draw_markers(&self, canvas: &mut Canvas, view: &View) {
        marks::goals(canvas, view, self.goals);
        marks::trips(canvas, view, self.trips);
        let path = self.path();
        if let (Some(start), Some(end)) = (path.first(), path.last()) {
            if path.len() > 1 {
                marks::dot(canvas, view.pixel([start.x_m, start.y_m]));
            }
            marks::robot(canvas, view, end);
        }
    }
}

/// The points of a path that are at least a pixel apart, with their share of the time. Shorter steps
/// are invisible and only cost time.
fn steps(trajectory: &[Pose2], view: &View) -> Vec<(f64, [f64; 2])> {
    let last = trajectory.len().saturating_sub(1).max(1) as f64;
    let mut points: Vec<(f64, [f64; 2])> = Vec::new();
    for (index, pose) in trajectory.iter().enumerate() {
        let at = view.pixel([pose.x_m, pose.y_m]);
        let far =
            points.last().is_none_or(|(_, from)| (at[0] - from[0]).hypot(at[1] - from[1]) >= 1.0);
        if pose.is_finite() && (far || index + 1 == trajectory.len()) {
            points.push((index as f64 / last, at));
        }
    }
    points
}

/// Draws a path in the colours of its time.
fn draw_timed(canvas: &mut Canvas, points: &[(f64, [f64; 2])]) {
    for pair in points.windows(2) {
        canvas.line(pair[0].1, pair[1].1, 5.0, FREE, 0.8);
    }
    for pair in points.windows(2) {
        canvas.line(pair[0].1, pair[1].1, 2.6, colors::time(pair[1].0), 1.0);
    }
}

/// Whether lines at every metre are far enough apart to be seen.
fn has_grid(view: &View) -> bool {
    view.pixels_per_m >= 20.0
}

/// Draws a line at every metre.
fn draw_grid(canvas: &mut Canvas, view: &View) {
    if !has_grid(view) {
        return;
    }
    for (x, y) in view.pixels() {
        let here = view.meters(x, y).map(f64::floor);
        let next = view.meters(x + 1, y - 1).map(f64::floor);
        if here[0] != next[0] || here[1] != next[1] {
            canvas.blend(x, y, GRID, 0.25);
        }
    }
}

/// Writes the coordinates in `map` beside the lines of the grid: the numbers that `go-to` takes.
fn draw_coordinates(canvas: &mut Canvas, view: &View) {
    // At this scale the numbers of neighbouring lines do not touch.
    let step = if view.pixels_per_m < 50.0 { 5 } else { 1 };
    if !has_grid(view) {
        return;
    }
    let [right_m, top_m] = view.meters(view.left + view.width, view.top);
    for x_m in whole_meters(view.min_m[0], right_m).filter(|x_m| x_m % step == 0) {
        let [x, _] = view.pixel([x_m as f64, top_m]);
        let text = format!("x {x_m}");
        if x as i64 + 4 + Font::Label.width(&text) < view.left + view.width {
            canvas.text(x as i64 + 4, view.top + 2, &text, Font::Label, FAINT);
        }
    }
    for y_m in whole_meters(view.min_m[1], top_m).filter(|y_m| y_m % step == 0) {
        let [_, y] = view.pixel([right_m, y_m as f64]);
        let text = format!("y {y_m}");
        if y as i64 - 18 > view.top + 20 {
            canvas.text(view.left + 4, y as i64 - 18, &text, Font::Label, FAINT);
        }
    }
}

fn whole_meters(from_m: f64, to_m: f64) -> std::ops::RangeInclusive<i64> {
    from_m.ceil() as i64..=to_m.floor() as i64
}

/// Draws a scale bar of 1 m, or of 10 m if 1 m is too short to see.
fn draw_scale_bar(canvas: &mut Canvas, view: &View) {
    let length_m = if has_grid(view) { 1.0 } else { 10.0 };
    let length = (length_m * view.pixels_per_m).round() as i64;
    let x = view.left + 14;
    let y = view.top + view.height - 20;
    let text = if has_grid(view) { "1 m, as the grid" } else { "10 m" };
    canvas.fill(x - 6, y - 24, length.max(Font::Label.width(text)) + 12, 36, PAGE);
    canvas.fill(x, y, length, 4, INK);
    canvas.text(x, y - 20, text, Font::Label, INK);
}
