//! The legend below the map.

use super::view::{GAP, LEGEND, View};
use super::{
    BELIEVED, FAINT, FREE, GoalFate, INK, MISSED, MapPlot, OCCUPIED, OFF, PLAN, UNKNOWN, marks,
};
use crate::report::canvas::{Canvas, Font};
use crate::report::colors::{self, Rgb};

/// Height of a row, pixels.
const ROW: i64 = 26;

pub(super) fn draw(picture: &MapPlot<'_>, canvas: &mut Canvas, view: &View) {
    let top = view.page_height - LEGEND;
    surfaces(picture, &mut Row { canvas, x: GAP, y: top });
    let has_path = picture.trajectory.len() > 1 || picture.truth.is_some();
    if has_path {
        paths(picture, &mut Row { canvas, x: GAP, y: top + ROW });
    }
    let below = if has_path { 2 } else { 1 };
    markers(picture, has_path, &mut Row { canvas, x: GAP, y: top + below * ROW });
}

fn surfaces(picture: &MapPlot<'_>, row: &mut Row<'_>) {
    row.swatch(FREE, "free");
    row.swatch(OCCUPIED, "occupied");
    if picture.truth.is_some() {
        row.swatch(OFF, "occupied, nothing within 10 cm");
        row.swatch(MISSED, "true obstacle");
    }
    row.swatch(UNKNOWN, "unknown");
    if picture.truth.is_some() {
        row.line(PLAN, "reachable floor");
    }
}

fn paths(picture: &MapPlot<'_>, row: &mut Row<'_>) {
    for step in 0..60 {
        let color = colors::time(f64::from(step) / 59.0);
        row.canvas.fill(row.x + i64::from(step), row.y + 4, 1, 8, color);
    }
    row.x += 46;
    if picture.truth.is_some() {
        row.label("true path, first to last");
        row.line(BELIEVED, "believed path");
    } else {
        row.label("path, first to last");
    }
}

fn markers(picture: &MapPlot<'_>, has_path: bool, row: &mut Row<'_>) {
    if has_path {
        marks::dot(row.canvas, row.marker());
        row.label("start");
    }
    marks::arrow(row.canvas, row.marker(), 0.0, 7.0);
    row.label(&robot(picture));
    for fate in GoalFate::ALL {
        let count = picture.goals.iter().filter(|goal| goal.fate == fate).count();
        if count > 0 {
            marks::goal_marker(row.canvas, row.marker(), fate);
            row.label(&format!("{count} {}", fate.name(count)));
        }
    }
    let stops = picture.trips.len();
    if stops > 0 {
        marks::trip_marker(row.canvas, row.marker());
        row.label(&format!("{stops} safety stop{}", if stops == 1 { "" } else { "s" }));
    }
}

/// The robot's heading at the end: 0 degrees is along x, and the angle grows to the left.
fn robot(picture: &MapPlot<'_>) -> String {
    let heading = picture.path().last().filter(|pose| pose.is_finite());
    heading.map_or_else(
        || "robot".to_owned(),
        |pose| format!("robot, heading {:.0} deg", pose.yaw_rad.to_degrees()),
    )
}

/// A row of the legend and the position of its next entry, pixels.
struct Row<'a> {
    canvas: &'a mut Canvas,
    x: i64,
    y: i64,
}

impl Row<'_> {
    fn swatch(&mut self, color: Rgb, label: &str) {
        self.canvas.fill(self.x, self.y + 1, 14, 14, color);
        self.canvas.frame(self.x, self.y + 1, 14, 14, FAINT);
        self.label(label);
    }

    fn line(&mut self, color: Rgb, label: &str) {
        let y = self.y as f64 + 8.0;
        self.canvas.line([self.x as f64, y], [self.x as f64 + 14.0, y], 2.0, color, 1.0);
        self.label(label);
    }

    /// Centre of the marker of the next entry.
    fn marker(&self) -> [f64; 2] {
        [self.x as f64 + 7.0, self.y as f64 + 8.0]
    }

    /// Draws the label beside a marker that is 14 pixels wide, and moves on to the next entry.
    fn label(&mut self, label: &str) {
        self.canvas.text(self.x + 20, self.y, label, Font::Label, INK);
        self.x += 20 + Font::Label.width(label) + 18;
    }
}
