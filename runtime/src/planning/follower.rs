//! Path following: chooses the motion primitives that lead along a path.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::config::{ConfigError, FollowerConfig};
use crate::snapshot::remembers;

/// One step of motion. The paper has the steps forward and the rotations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Primitive {
    /// A step forward, by default 0.03 m.
    Forward,
    /// A step of rotating counter-clockwise, by default 4 degrees.
    TurnLeft,
    /// A step of rotating clockwise, by default 4 degrees.
    TurnRight,
    /// Half a step forward while rotating counter-clockwise: corrects the heading without a stop.
    ArcLeft,
    /// Half a step forward while rotating clockwise.
    ArcRight,
    /// No motion in this tick.
    Stay,
}

/// State of path following.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Progress {
    Following,
    /// The robot is within the tolerance of the path's end.
    Reached,
    /// The robot is too far from the path; a new plan is needed.
    OffPath,
}

/// The next motion and the state of path following.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// The motion; [`Primitive::Stay`] unless following.
    pub primitive: Primitive,
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

/// Follows a polyline by pure pursuit (Coulter 1992) with hysteresis: the robot rotates on the spot
/// when its heading differs much from the direction of the lookahead point, and otherwise drives
/// and corrects only larger errors. So the staircase shape of a path of cells does not make the
/// robot rotate at every cell.
#[derive(Debug, Clone)]
pub struct Follower {
    config: FollowerConfig,
    points_m: Vec<[f64; 2]>,
    /// Length of the path up to each point, metres.
    lengths_m: Vec<f64>,
    /// Length of the path that the robot has completed, metres.
    done_m: f64,
    rotating: bool,
}

impl Follower {
    /// A follower without a path.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(config: &FollowerConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            config: config.clone(),
            points_m: Vec::new(),
            lengths_m: Vec::new(),
            done_m: 0.0,
            rotating: false,
        })
    }

    /// Starts a new path, given as corner points in the frame of the poses, metres.
    ///
    /// # Errors
    /// [`FollowError::NoPath`] if there are no points or one is not finite; the follower then has
    /// no path.
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

    /// Drops the current path.
    pub fn clear(&mut self) {
        self.points_m.clear();
        self.lengths_m.clear();
        self.done_m = 0.0;
        self.rotating = false;
    }

    /// The path's corner points, metres; empty without a path.
    #[must_use]
    pub fn path_m(&self) -> &[[f64; 2]] {
        &self.points_m
    }

    /// What is left of the path for a robot at `here_m`: the robot's place, then the corner points that it
    /// has not passed; empty without a path.
    #[must_use]
    pub fn rest_of_path_m(&self, here_m: [f64; 2]) -> Vec<[f64; 2]> {
        if self.points_m.is_empty() {
            return Vec::new();
        }
        let passed = self.lengths_m.partition_point(|length_m| *length_m <= self.done_m);
        // The end is always ahead, also for a robot that stands on it.
        let ahead = passed.min(self.points_m.len() - 1);
        std::iter::once(here_m).chain(self.points_m.iter().skip(ahead).copied()).collect()
    }

    /// The next step for a robot at `pose`.
    ///
    /// # Errors
    /// When the pose is not finite or there is no path.
    pub fn next(&mut self, pose: &Pose2) -> Result<Step, FollowError> {
        if !pose.is_finite() {
            return Err(FollowError::PoseNotFinite);
        }
        let goal = self.points_m.last().copied().ok_or(FollowError::NoPath)?;
        let length_m = self.lengths_m.last().copied().ok_or(FollowError::NoPath)?;
        let here = [pose.x_m, pose.y_m];
        let (done_m, cross_track_m) = self.locate(here);
        self.done_m = done_m;
        let remaining_m = length_m - done_m;
        // A path that is a loop passes its end early, so the end counts only on the last part of
        // the path.
        let at_end = distance(here, goal) <= self.config.goal_tolerance_m
            && remaining_m <= self.config.lookahead_m;
        let (progress, primitive) = if at_end {
            (Progress::Reached, Primitive::Stay)
        } else if cross_track_m > self.config.off_path_m {
            (Progress::OffPath, Primitive::Stay)
        } else {
            let ahead = self.point_at(done_m + self.config.lookahead_m);
            let bearing_rad = (ahead[1] - here[1]).atan2(ahead[0] - here[0]);
            (Progress::Following, self.steer(wrap_angle(bearing_rad - pose.yaw_rad)))
        };
        Ok(Step { primitive, progress, remaining_m, cross_track_m })
    }

    fn steer(&mut self, error_rad: f64) -> Primitive {
        let config = &self.config;
        let size = error_rad.abs();
        self.rotating =
            if self.rotating { size > config.aligned_rad } else { size > config.turn_in_place_rad };
        let left = error_rad > 0.0;
        match (self.rotating, config.arcs) {
            (false, _) if size <= config.correct_rad => Primitive::Forward,
            (false, true) if left => Primitive::ArcLeft,
            (false, true) => Primitive::ArcRight,
            _ if left => Primitive::TurnLeft,
            _ => Primitive::TurnRight,
        }
    }

    /// Length of the path up to the point nearest to `here`, and the distance to that point.
    /// Searches from the last position to a little beyond the lookahead point only, so that a path
    /// that comes back close to itself is not cut short.
    fn locate(&self, here: [f64; 2]) -> (f64, f64) {
        let until_m = self.done_m + 2.0 * self.config.lookahead_m;
        let mut best = (self.done_m, distance(here, self.point_at(self.done_m)));
        for (ends, lengths) in self.points_m.windows(2).zip(self.lengths_m.windows(2)) {
            let (&[a, b], &[start_m, end_m]) = (ends, lengths) else { continue };
            if end_m < self.done_m || start_m > until_m || end_m <= start_m {
                continue;
            }
            let along = ((here[0] - a[0]) * (b[0] - a[0]) + (here[1] - a[1]) * (b[1] - a[1]))
                / (end_m - start_m);
            let at_m = (start_m + along).clamp(start_m, end_m).clamp(self.done_m, until_m);
            let away = distance(here, self.point_at(at_m));
            if away < best.1 {
                best = (at_m, away);
            }
        }
        best
    }

    /// The point of the path after `length_m` metres; the path's end beyond its length.
    fn point_at(&self, length_m: f64) -> [f64; 2] {
        let next = self.lengths_m.partition_point(|end_m| *end_m < length_m);
        let before = next.saturating_sub(1);
        match (self.points_m.get(before), self.points_m.get(next)) {
            (Some(a), Some(b)) if next > before => {
                let start_m = self.lengths_m[before];
                let end_m = self.lengths_m[next];
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

remembers!(Follower: points_m, lengths_m, done_m, rotating);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct Drive {
        end: Pose2,
        reached: bool,
        rotations: usize,
        length_m: f64,
        steps: usize,
    }

    /// Drives an ideal unicycle robot along a path.
    fn drive(points_m: &[[f64; 2]], start: Pose2) -> Drive {
        drive_with(&FollowerConfig::default(), points_m, start)
    }

    fn drive_with(config: &FollowerConfig, points_m: &[[f64; 2]], start: Pose2) -> Drive {
        let mut follower = Follower::new(config).unwrap();
        follower.set_path(points_m).unwrap();
        let mut result =
            Drive { end: start, reached: false, rotations: 0, length_m: 0.0, steps: 0 };
        while result.steps < 5_000 {
            let step = follower.next(&result.end).unwrap();
            if step.progress != Progress::Following {
                assert_eq!(step.primitive, Primitive::Stay);
                result.reached = step.progress == Progress::Reached;
                break;
            }
            let motion = match step.primitive {
                Primitive::Forward => Pose2::new(config.forward_m, 0.0, 0.0),
                Primitive::TurnLeft => Pose2::new(0.0, 0.0, config.turn_rad),
                Primitive::TurnRight => Pose2::new(0.0, 0.0, -config.turn_rad),
                // The chord of the small arc has the same length within 0.1 %.
                Primitive::ArcLeft => Pose2::new(config.forward_m / 2.0, 0.0, config.turn_rad),
                Primitive::ArcRight => Pose2::new(config.forward_m / 2.0, 0.0, -config.turn_rad),
                Primitive::Stay => panic!("stays while following"),
            };
            result.end = result.end.compose(&motion);
            result.rotations += usize::from(motion.x_m == 0.0);
            result.length_m += motion.x_m;
            result.steps += 1;
        }
        result
    }

    #[test]
    fn a_curved_path_is_followed_on_arcs_without_a_stop() {
        let bend: Vec<[f64; 2]> = (0..100)
            .map(|i| f64::from(i) * 0.01)
            .map(|a| [2.0 * a.sin(), 2.0 - 2.0 * a.cos()])
            .collect();
        let [arcs, steps] = [true, false].map(|arcs| {
            let config = FollowerConfig { arcs, ..FollowerConfig::default() };
            drive_with(&config, &bend, Pose2::IDENTITY)
        });
        assert!(arcs.reached && arcs.rotations == 0, "{} rotations on the spot", arcs.rotations);
        assert!(steps.rotations > 10);
    }

    #[test]
    fn a_staircase_along_a_diagonal_takes_few_rotations() {
        for slope in [1.0, 0.5, 0.3] {
            let stairs: Vec<[f64; 2]> = (0..150)
                .map(|x| [f64::from(x) * 0.03, (f64::from(x) * slope).round() * 0.03])
                .collect();
            let result = drive(&stairs, Pose2::new(0.0, 0.0, f64::atan(slope)));
            assert!(result.reached);
            assert!(result.rotations < 10, "{} rotations", result.rotations);
        }
    }

    #[test]
    fn the_driven_length_is_that_of_the_path() {
        let path = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.5], [4.0, 2.5]];
        let length_m = 2.0 + 1.5 + 5f64.sqrt();
        let result = drive(&path, Pose2::IDENTITY);
        assert!(result.reached);
        assert!(
            (result.length_m - length_m).abs() < 0.05 * length_m,
            "{} m instead of {length_m} m",
            result.length_m
        );
    }

    #[test]
    fn a_robot_far_from_the_path_is_reported_as_off_path() {
        let mut follower = Follower::new(&FollowerConfig::default()).unwrap();
        follower.set_path(&[[0.0, 0.0], [3.0, 0.0]]).unwrap();
        let step = follower.next(&Pose2::new(1.0, 0.5, 0.0)).unwrap();
        assert_eq!((step.progress, step.primitive), (Progress::OffPath, Primitive::Stay));
    }

    #[test]
    fn a_path_that_passes_its_end_early_is_driven_to_the_end() {
        // A loop that returns to its start.
        let path = [[0.0, 0.0], [1.5, 0.0], [1.5, 1.5], [0.0, 1.5], [0.0, 0.0]];
        let result = drive(&path, Pose2::IDENTITY);
        assert!(result.reached);
        assert!(result.length_m > 5.5, "{} m", result.length_m);
    }

    #[test]
    fn a_path_of_one_point_is_reached_where_it_is() {
        assert!(drive(&[[0.0, 0.0]], Pose2::IDENTITY).reached);
        assert!(drive(&[[0.0, 0.2], [0.0, 0.2]], Pose2::IDENTITY).reached);
    }

    #[test]
    fn the_rest_of_a_path_begins_at_the_robot_and_has_the_corners_ahead() {
        let mut follower = Follower::new(&FollowerConfig::default()).unwrap();
        assert!(follower.rest_of_path_m([0.0, 0.0]).is_empty());
        follower.set_path(&[[0.0, 0.0], [0.4, 0.0], [0.4, 1.0]]).unwrap();
        assert_eq!(follower.rest_of_path_m([0.0, 0.0]), [[0.0, 0.0], [0.4, 0.0], [0.4, 1.0]]);
        for place in [Pose2::new(0.3, 0.0, 0.0), Pose2::new(0.41, 0.3, 1.57)] {
            follower.next(&place).unwrap();
        }
        assert_eq!(follower.rest_of_path_m([0.41, 0.3]), [[0.41, 0.3], [0.4, 1.0]]);
        follower.next(&Pose2::new(0.4, 1.0, 1.57)).unwrap();
        assert_eq!(follower.rest_of_path_m([0.4, 1.0]), [[0.4, 1.0], [0.4, 1.0]]);
    }

    #[test]
    fn nan_is_refused() {
        let mut follower = Follower::new(&FollowerConfig::default()).unwrap();
        assert_eq!(follower.next(&Pose2::IDENTITY), Err(FollowError::NoPath));
        assert_eq!(follower.set_path(&[[0.0, f64::NAN]]), Err(FollowError::NoPath));
        follower.set_path(&[[0.0, 0.0]]).unwrap();
        let nan = Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY };
        assert_eq!(follower.next(&nan), Err(FollowError::PoseNotFinite));
    }

    proptest! {
        #[test]
        fn any_path_is_driven_to_its_end_from_any_heading(
            yaw_rad in -3.2..3.2f64,
            pieces in proptest::collection::vec((0.15..1.5f64, -2.6..2.6f64), 1..7),
        ) {
            let mut points = vec![[0.0, 0.0]];
            let mut at = [0.0f64, 0.0];
            let mut heading = 0.0f64;
            for (length, rotation) in &pieces {
                heading += rotation;
                at = [at[0] + length * heading.cos(), at[1] + length * heading.sin()];
                points.push(at);
            }
            let length_m: f64 = pieces.iter().map(|(length, _)| length).sum();
            let result = drive(&points, Pose2::new(0.0, 0.0, yaw_rad));
            prop_assert!(result.reached, "ended at {:?} after {} steps", result.end, result.steps);
            prop_assert!((result.end.x_m - at[0]).hypot(result.end.y_m - at[1]) <= 0.061);
            // Pure pursuit cuts corners, so it may be shorter, never much longer.
            prop_assert!(result.length_m <= 1.05 * length_m + 0.1, "{} m instead of {} m", result.length_m, length_m);
        }
    }
}
