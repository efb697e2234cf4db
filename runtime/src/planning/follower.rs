//! From a path to motion primitives.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::config::{ConfigError, FollowerConfig};

/// One step of motion, as in the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Primitive {
    /// A step forward, by default 0.03 m.
    Forward,
    /// A step of turning counter-clockwise, by default 2 degrees.
    TurnLeft,
    /// A step of turning clockwise.
    TurnRight,
    /// Nothing.
    Stay,
}

/// How far along the path the robot is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Progress {
    /// On the way.
    Following,
    /// Within the tolerance of the path's end.
    Reached,
    /// Too far from the path: plan again.
    OffPath,
}

/// What to do next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// The motion; [`Primitive::Stay`] unless following.
    pub primitive: Primitive,
    /// Where the robot is on its way.
    pub progress: Progress,
    /// Length of the path that is left, metres.
    pub remaining_m: f64,
    /// Distance from the path, metres.
    pub cross_track_m: f64,
}

/// Why no step could be chosen.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FollowError {
    /// The pose holds NaN or infinity.
    #[error("the pose is not finite: leave this step out")]
    PoseNotFinite,
    /// There is no path to follow.
    #[error("the path has no points, or some that are not finite")]
    NoPath,
}

/// Follows a polyline by pure pursuit (Coulter 1992) with a hysteresis: the robot turns on the spot when it looks far away
/// from the point ahead, and otherwise drives, correcting only errors that matter. Steps of the path's cells then do not turn
/// into turns of the robot.
#[derive(Debug, Clone)]
pub struct Follower {
    config: FollowerConfig,
    points_m: Vec<[f64; 2]>,
    /// Length of the path up to each point, metres.
    lengths_m: Vec<f64>,
    /// Length of the path that is done, metres.
    done_m: f64,
    turning: bool,
}

impl Follower {
    /// A follower without a path.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(config: &FollowerConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self { config: config.clone(), points_m: Vec::new(), lengths_m: Vec::new(), done_m: 0.0, turning: false })
    }

    /// Begins a new path: corner points in the frame of the poses, metres.
    ///
    /// # Errors
    /// [`FollowError::NoPath`] when there are no points or one is not finite; there is then no path.
    pub fn set_path(&mut self, points_m: &[[f64; 2]]) -> Result<(), FollowError> {
        self.clear();
        if points_m.is_empty() || points_m.iter().flatten().any(|number| !number.is_finite()) {
            return Err(FollowError::NoPath);
        }
        let mut length_m = 0.0;
        for (at, point) in points_m.iter().enumerate() {
            if let Some(before) = at.checked_sub(1).and_then(|before| points_m.get(before)) {
                length_m += distance(*before, *point);
            }
            self.points_m.push(*point);
            self.lengths_m.push(length_m);
        }
        Ok(())
    }

    /// Forgets the path.
    pub fn clear(&mut self) {
        self.points_m.clear();
        self.lengths_m.clear();
        self.done_m = 0.0;
        self.turning = false;
    }

    /// The path's corner points, metres; empty without a path.
    #[must_use]
    pub fn path_m(&self) -> &[[f64; 2]] {
        &self.points_m
    }

    /// The next step for a robot at `pose`.
    ///
    /// # Errors
    /// When the pose is not finite or there is no path.
    pub fn next(&mut self, pose: &Pose2) -> Result<Step, FollowError> {
        if !pose.is_finite() {
            return Err(FollowError::PoseNotFinite);
        }
        let (Some(goal), Some(length_m)) = (self.points_m.last().copied(), self.lengths_m.last().copied()) else {
            return Err(FollowError::NoPath);
        };
        let here = [pose.x_m, pose.y_m];
        let (done_m, cross_track_m) = self.locate(here);
        self.done_m = done_m;
        let remaining_m = length_m - done_m;
        let ended = |progress| Step { primitive: Primitive::Stay, progress, remaining_m, cross_track_m };
        // A loop passes its end early: only the last stretch counts.
        if distance(here, goal) <= self.config.goal_tolerance_m && remaining_m <= self.config.lookahead_m {
            return Ok(ended(Progress::Reached));
        }
        if cross_track_m > self.config.off_path_m {
            return Ok(ended(Progress::OffPath));
        }
        let ahead = self.point_at(done_m + self.config.lookahead_m);
        let bearing_rad = (ahead[1] - here[1]).atan2(ahead[0] - here[0]);
        let primitive = self.steer(wrap_angle(bearing_rad - pose.yaw_rad));
        Ok(Step { primitive, progress: Progress::Following, remaining_m, cross_track_m })
    }

    fn steer(&mut self, error_rad: f64) -> Primitive {
        let config = &self.config;
        let size = error_rad.abs();
        self.turning = if self.turning { size > config.aligned_rad } else { size > config.turn_in_place_rad };
        if !self.turning && size <= config.correct_rad {
            Primitive::Forward
        } else if error_rad > 0.0 {
            Primitive::TurnLeft
        } else {
            Primitive::TurnRight
        }
    }

    /// Length of the path up to the point nearest to `here`, and the distance to it. Looks from where the robot was to a
    /// little beyond the point ahead, so that a path that comes back close to itself is not cut short.
    fn locate(&self, here: [f64; 2]) -> (f64, f64) {
        let until_m = self.done_m + 2.0 * self.config.lookahead_m;
        let mut best = (self.done_m, distance(here, self.point_at(self.done_m)));
        for (ends, lengths) in self.points_m.windows(2).zip(self.lengths_m.windows(2)) {
            let (&[a, b], &[start_m, end_m]) = (ends, lengths) else { continue };
            if end_m < self.done_m || start_m > until_m || end_m <= start_m {
                continue;
            }
            let along = ((here[0] - a[0]) * (b[0] - a[0]) + (here[1] - a[1]) * (b[1] - a[1])) / (end_m - start_m);
            let at_m = (start_m + along).clamp(start_m, end_m).clamp(self.done_m, until_m);
            let away = distance(here, self.point_at(at_m));
            if away < best.1 {
                best = (at_m, away);
            }
        }
        best
    }

    /// The point of the path after `length_m`; its end beyond.
    fn point_at(&self, length_m: f64) -> [f64; 2] {
        let next = self.lengths_m.partition_point(|end_m| *end_m < length_m);
        let before = next.saturating_sub(1);
        match (self.points_m.get(before), self.points_m.get(next)) {
            (Some(a), Some(b)) if next > before => {
                let (start_m, end_m) = (self.lengths_m[before], self.lengths_m[next]);
                let share = (length_m - start_m) / (end_m - start_m);
                [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
            }
            (_, Some(point)) => *point,
            _ => self.points_m.last().copied().unwrap_or_default(),
        }
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
