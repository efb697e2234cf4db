//! The metric of Kuemmerle et al. 2009: how far the motion between two poses is from the true one.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use hal::Pose2;

use super::trajectory::{self, Trajectory};

/// The true pose of the second time in the frame of the first.
pub struct Relation {
    times_s: [f64; 2],
    motion: Pose2,
}

/// How the times and poses of relations become those of a log.
pub struct Clock {
    /// Relation time at log time 0.
    offset_s: f64,
    /// Only relations below this log time are measured: later times of the log have too few digits.
    end_s: f64,
    /// A pose of the log belongs to a time if it is this near; else poses are interpolated between scans.
    nearest_s: Option<f64>,
    /// Where the truth's frame is on the robot, forward.
    forward_m: f64,
}

impl Clock {
    /// Found by matching both files. Below 1,000 s the log's six digits name each line.
    pub const INTEL: Self = Self {
        offset_s: 976_052_857.337_503,
        end_s: 1000.0,
        nearest_s: Some(0.0015),
        forward_m: 0.0,
    };
    /// Found by matching both files.
    pub const FREIBURG: Self =
        Self { offset_s: 1211.44, end_s: f64::INFINITY, nearest_s: None, forward_m: 0.04 };

    /// The times and the frame of the truth are those of the log.
    #[cfg(test)]
    pub const PLAIN: Self =
        Self { offset_s: 0.0, end_s: f64::INFINITY, nearest_s: None, forward_m: 0.0 };

    /// The pose of the truth's frame at a time of the log. Lines of odometry lie between scans that are seconds apart.
    pub fn pose_in_log(&self, time_s: f64, trajectory: &Trajectory) -> Option<Pose2> {
        let pose = match self.nearest_s {
            Some(_) => trajectory.nearest(time_s, NEAREST_LINE_S),
            None => trajectory.between_scans(time_s).or_else(|| trajectory.nearest(time_s, 1e-6)),
        };
        pose.map(|pose| pose.compose(&self.t_base_truth()))
    }

    /// A motion of the robot as a motion of the truth's frame.
    pub fn in_truths_frame(&self, motion: &Pose2) -> Pose2 {
        let t_base_truth = self.t_base_truth();
        t_base_truth.inverse().compose(motion).compose(&t_base_truth)
    }

    fn t_base_truth(&self) -> Pose2 {
        Pose2::new(self.forward_m, 0.0, 0.0)
    }

    fn pose(&self, time_s: f64, trajectory: &Trajectory) -> Option<Pose2> {
        let time_s = time_s - self.offset_s;
        if time_s >= self.end_s {
            return None;
        }
        let pose = match self.nearest_s {
            Some(tolerance_s) => trajectory.nearest(time_s, tolerance_s),
            None => trajectory.between_scans(time_s),
        };
        pose.map(|pose| pose.compose(&self.t_base_truth()))
    }
}

impl Relation {
    /// Lines of `t1 t2 x y z roll pitch yaw`, compressed by gzip.
    pub fn read(path: &Path) -> Result<Vec<Self>> {
        let text = trajectory::text(path)?;
        text.lines().filter(|line| !line.trim().is_empty()).map(Self::parse).collect()
    }

    /// Both times in the log's time.
    pub fn log_times_s(&self, clock: &Clock) -> [f64; 2] {
        self.times_s.map(|time_s| time_s - clock.offset_s)
    }

    pub fn motion(&self) -> Pose2 {
        self.motion
    }

    pub fn parse(line: &str) -> Result<Self> {
        let values: Vec<f64> = line
            .split_whitespace()
            .map(str::parse)
            .collect::<Result<_, _>>()
            .with_context(|| format!("`{line}` is not a relation"))?;
        ensure!(values.len() == 8, "`{line}` has {} values instead of 8", values.len());
        let motion = Pose2::new(values[2], values[3], values[7]);
        Ok(Self { times_s: [values[0], values[1]], motion })
    }
}

/// A line of the log this near says where the robot was when a loop's submap began, seconds.
const NEAREST_LINE_S: f64 = 0.05;

/// Means and standard deviations of the errors of relations.
pub struct Errors {
    pub count: usize,
    /// Of distance (m) and of rotation (degrees).
    mean: [f64; 2],
    deviation: [f64; 2],
}

impl Errors {
    /// Of the relations whose times are further apart than `apart_s`.
    pub fn of(relations: &[Relation], clock: &Clock, poses: &Trajectory, apart_s: f64) -> Self {
        let mut errors = Vec::new();
        for Relation { times_s: [first_s, second_s], motion } in relations {
            if (second_s - first_s).abs() < apart_s {
                continue;
            }
            let ends = (clock.pose(*first_s, poses), clock.pose(*second_s, poses));
            if let (Some(first), Some(second)) = ends {
                let error = motion.inverse().compose(&first.inverse().compose(&second));
                errors.push([error.x_m.hypot(error.y_m), error.yaw_rad.abs().to_degrees()]);
            }
        }
        let count = errors.len();
        let mean = [0, 1].map(|axis| average(errors.iter().map(|error| error[axis]), count));
        let deviation = [0, 1].map(|axis| {
            let squares = errors.iter().map(|error| (error[axis] - mean[axis]).powi(2));
            average(squares, count).sqrt()
        });
        Self { count, mean, deviation }
    }

    pub fn means(&self) -> String {
        pair(self.mean)
    }

    pub fn deviations(&self) -> String {
        pair(self.deviation)
    }
}

fn average(values: impl Iterator<Item = f64>, count: usize) -> f64 {
    values.sum::<f64>() / count.max(1) as f64
}

fn pair([metres, degrees]: [f64; 2]) -> String {
    format!("{metres:.4} / {degrees:.2}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_is_what_is_left_of_the_motion_when_the_truth_is_taken_off() {
        let poses = Trajectory::of(&[
            (1.0, Pose2::new(5.0, 5.0, 1.0)),
            (2.0, Pose2::new(5.0, 5.0, 1.0).compose(&Pose2::new(1.3, 0.4, 0.2))),
        ]);
        let relation = Relation::parse("1 2 1.0 0 0 0 0 0.1").unwrap();
        let clock = Clock { offset_s: 0.0, end_s: 9.0, nearest_s: Some(0.1), forward_m: 0.0 };
        let errors = Errors::of(&[relation], &clock, &poses, 0.0);
        assert_eq!(errors.count, 1);
        assert_eq!(errors.means(), format!("0.5000 / {:.2}", 0.1_f64.to_degrees()));
        assert_eq!(errors.deviations(), "0.0000 / 0.00");
    }

    #[test]
    fn a_relation_without_poses_is_not_counted() {
        let poses = Trajectory::of(&[(1.0, Pose2::IDENTITY)]);
        let relation = Relation::parse("1 2 1.0 0 0 0 0 0.1").unwrap();
        assert_eq!(Errors::of(&[relation], &Clock::FREIBURG, &poses, 0.0).count, 0);
        assert!(Relation::parse("1 2 3").is_err());
    }
}
