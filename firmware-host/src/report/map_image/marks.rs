//! Markers on the map: goals, safety stops, start and robot.

use hal::Pose2;

use super::view::View;
use super::{END, FAINT, GOAL, Goal, GoalFate, INK, PAGE, SEEN, START, TRIP};
use crate::report::canvas::Canvas;

/// Markers nearer to each other than this are drawn once, pixels.
const APART: f64 = 11.0;

/// Draws goals: the reached ones above the others, and of goals on one spot only the first.
pub(super) fn goals(canvas: &mut Canvas, view: &View, goals: &[Goal]) {
    let mut drawn: Vec<[f64; 2]> = Vec::new();
    for fate in [GoalFate::Open, GoalFate::Reached, GoalFate::Seen, GoalFate::Dropped] {
        for goal in goals.iter().filter(|goal| goal.fate == fate) {
            let at = view.pixel(goal.at_m);
            if !is_taken(at, &drawn) {
                goal_marker(canvas, at, fate);
                drawn.push(at);
            }
        }
    }
}

/// Draws safety stops, of stops on one spot only the first.
pub(super) fn trips(canvas: &mut Canvas, view: &View, trips: &[[f64; 2]]) {
    let mut drawn: Vec<[f64; 2]> = Vec::new();
    for trip in trips {
        let at = view.pixel(*trip);
        if !is_taken(at, &drawn) {
            trip_marker(canvas, at);
            drawn.push(at);
        }
    }
}

fn is_taken(at: [f64; 2], drawn: &[[f64; 2]]) -> bool {
    drawn.iter().any(|other| (at[0] - other[0]).hypot(at[1] - other[1]) < APART)
}

pub(super) fn goal_marker(canvas: &mut Canvas, center: [f64; 2], fate: GoalFate) {
    canvas.diamond(center, 7.0, PAGE);
    match fate {
        GoalFate::Reached => canvas.diamond(center, 5.5, GOAL),
        GoalFate::Seen => canvas.diamond(center, 4.0, SEEN),
        GoalFate::Dropped => {
            canvas.diamond(center, 5.0, FAINT);
            canvas.diamond(center, 2.5, PAGE);
        }
        GoalFate::Open => {
            canvas.diamond(center, 5.5, GOAL);
            canvas.diamond(center, 2.5, PAGE);
        }
    }
}

pub(super) fn trip_marker(canvas: &mut Canvas, center: [f64; 2]) {
    canvas.cross(center, 4.0, 4.5, PAGE);
    canvas.cross(center, 4.0, 2.2, TRIP);
}

pub(super) fn dot(canvas: &mut Canvas, center: [f64; 2]) {
    canvas.disc(center, 7.5, PAGE);
    canvas.disc(center, 6.0, START);
}

/// Draws the robot as an arrow that points ahead.
pub(super) fn robot(canvas: &mut Canvas, view: &View, pose: &Pose2) {
    arrow(canvas, view.pixel([pose.x_m, pose.y_m]), pose.yaw_rad, 13.0);
}

/// Draws an arrow whose point is `length` pixels ahead of `at`.
pub(super) fn arrow(canvas: &mut Canvas, at: [f64; 2], yaw_rad: f64, length: f64) {
    for (color, grown) in [(INK, 2.0), (END, 0.0)] {
        let wedge =
            Wedge { at, yaw_rad, length: length + grown, half_width: 0.62 * length + grown };
        canvas.triangle(wedge.corners(), color);
    }
}

/// A triangle around a point that points in a direction, pixels.
struct Wedge {
    at: [f64; 2],
    yaw_rad: f64,
    length: f64,
    half_width: f64,
}

impl Wedge {
    fn corners(&self) -> [[f64; 2]; 3] {
        let back = -0.6 * self.length;
        [[self.length, 0.0], [back, self.half_width], [back, -self.half_width]]
            .map(|[ahead, left]| self.point(ahead, left))
    }

    /// Rows of an image point down.
    fn point(&self, ahead: f64, left: f64) -> [f64; 2] {
        let (sin, cos) = self.yaw_rad.sin_cos();
        [self.at[0] + ahead * cos - left * sin, self.at[1] - ahead * sin - left * cos]
    }
}
