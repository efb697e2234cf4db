//! Markers on the map: goals, safety stops, start and robot.

use hal::Pose2;

use super::view::View;
use super::{END, FAINT, GOAL, Goal, GoalFate, INK, PAGE, SEEN, START, TRIP};
use crate::report::canvas::{Canvas, Font};

/// Markers of different kinds nearer to each other than this would cover each other, pixels.
const APART: f64 = 11.0;
/// Goals of one fate and stops within this distance share a marker with their number, pixels. A strip of forty goals would
/// otherwise be unreadable.
const TOGETHER: f64 = 30.0;

/// Draws goals: the reached ones above the others.
pub(super) fn goals(canvas: &mut Canvas, view: &View, goals: &[Goal]) {
    let mut drawn: Vec<Group> = Vec::new();
    for fate in GoalFate::ALL {
        let places = goals.iter().filter(|goal| goal.fate == fate);
        for group in grouped(places.map(|goal| view.pixel(goal.at_m))) {
            if drawn.iter().all(|other| other.distance(group.at) >= APART) {
                goal_marker(canvas, group.at, fate);
                group.draw_count(canvas);
                drawn.push(group);
            }
        }
    }
}

/// Draws safety stops.
pub(super) fn trips(canvas: &mut Canvas, view: &View, trips: &[[f64; 2]]) {
    for group in grouped(trips.iter().map(|trip| view.pixel(*trip))) {
        trip_marker(canvas, group.at);
        group.draw_count(canvas);
    }
}

/// Markers that are drawn as one.
struct Group {
    /// Place of the first of them, pixels.
    at: [f64; 2],
    count: usize,
}

impl Group {
    fn distance(&self, at: [f64; 2]) -> f64 {
        (at[0] - self.at[0]).hypot(at[1] - self.at[1])
    }

    /// Writes the number of markers beside a group, with a white edge that sets it off from walls.
    fn draw_count(&self, canvas: &mut Canvas) {
        if self.count < 2 {
            return;
        }
        let text = self.count.to_string();
        let x = self.at[0] as i64 + 9;
        let y = self.at[1] as i64 - 8;
        for (right, down) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            canvas.text(x + right, y + down, &text, Font::Label, PAGE);
        }
        canvas.text(x, y, &text, Font::Label, INK);
    }
}

/// Puts every place into the group of the first place near it.
fn grouped(places: impl Iterator<Item = [f64; 2]>) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for at in places {
        match groups.iter_mut().find(|group| group.distance(at) < TOGETHER) {
            Some(group) => group.count += 1,
            None => groups.push(Group { at, count: 1 }),
        }
    }
    groups
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forty_goals_in_a_strip_are_a_few_markers_that_add_up() {
        let groups = grouped((0..40).map(|index| [3.0 * f64::from(index), 50.0]));
        assert!((2..=5).contains(&groups.len()), "{}", groups.len());
        assert_eq!(groups.iter().map(|group| group.count).sum::<usize>(), 40);
        assert!(groups.windows(2).all(|pair| pair[0].distance(pair[1].at) >= TOGETHER));
    }

    #[test]
    fn a_goal_by_itself_has_no_number() {
        let mut canvas = Canvas::new(60, 40, PAGE);
        let untouched = canvas.bytes().to_vec();
        Group { at: [20.0, 20.0], count: 1 }.draw_count(&mut canvas);
        assert_eq!(canvas.bytes(), untouched);
        Group { at: [20.0, 20.0], count: 12 }.draw_count(&mut canvas);
        assert_ne!(canvas.bytes(), untouched);
    }
}
