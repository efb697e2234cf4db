//! Poses at times.

use std::io::Read as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use firmware_host::localize::log::Log;
use hal::Pose2;

/// Poses in the order of a log's lines.
pub struct Trajectory {
    poses: Vec<Timed>,
    /// The poses of scans, sorted by time.
    scans: Vec<Timed>,
}

#[derive(Clone, Copy)]
struct Timed {
    time_s: f64,
    pose: Pose2,
}

impl Trajectory {
    /// A file of the TUM form that has one line for each line of the log.
    pub fn read(path: &Path, log: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let poses: Vec<Timed> = text.lines().map(parse).collect::<Result<_>>()?;
        Self::new(poses, &Log::read(log)?)
    }

    /// What the wheels alone say.
    pub fn by_wheels(log: &Path) -> Result<Self> {
        let log = Log::read(log)?;
        let lines = log.lines.iter();
        let poses = lines.map(|line| Timed { time_s: line.time_s, pose: line.wheel }).collect();
        Self::new(poses, &log)
    }

    fn new(poses: Vec<Timed>, log: &Log) -> Result<Self> {
        let lines = log.lines.len();
        ensure!(poses.len() == lines, "{} poses for {lines} lines of the log", poses.len());
        let with_lines = poses.iter().zip(&log.lines);
        let scans = with_lines.filter(|(_, line)| line.ranges.is_some());
        let mut scans: Vec<Timed> = scans.map(|(timed, _)| *timed).collect();
        scans.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        Ok(Self { poses, scans })
    }

    #[cfg(test)]
    pub fn of(poses: &[(f64, Pose2)]) -> Self {
        let poses: Vec<_> =
            poses.iter().map(|(time_s, pose)| Timed { time_s: *time_s, pose: *pose }).collect();
        Self { scans: poses.clone(), poses }
    }

    /// The pose whose time is nearest; of several, the last one in the log. Lines with time 0 have no time.
    pub fn nearest(&self, time_s: f64, tolerance_s: f64) -> Option<Pose2> {
        let mut best = None;
        let mut distance_s = tolerance_s;
        for timed in self.poses.iter().filter(|timed| timed.time_s != 0.0) {
            let apart_s = (timed.time_s - time_s).abs();
            if apart_s <= distance_s {
                distance_s = apart_s;
                best = Some(timed.pose);
            }
        }
        best
    }

    /// The pose at a time, interpolated between the scans before and after it.
    pub fn between_scans(&self, time_s: f64) -> Option<Pose2> {
        let after = self.scans.partition_point(|timed| timed.time_s < time_s);
        let before = self.scans.get(after.checked_sub(1)?)?;
        let after = self.scans.get(after)?;
        let share = (time_s - before.time_s) / (after.time_s - before.time_s).max(1e-9);
        let motion = before.pose.inverse().compose(&after.pose);
        let part = Pose2::new(share * motion.x_m, share * motion.y_m, share * motion.yaw_rad);
        Some(before.pose.compose(&part))
    }
}

fn parse(line: &str) -> Result<Timed> {
    let values: Vec<f64> = line
        .split_whitespace()
        .map(str::parse)
        .collect::<Result<_, _>>()
        .with_context(|| format!("`{line}` is not a pose"))?;
    let [time_s, x_m, y_m, _, _, _, qz, qw] = values[..] else {
        anyhow::bail!("`{line}` has {} values instead of 8", values.len());
    };
    Ok(Timed { time_s, pose: Pose2::new(x_m, y_m, 2.0 * f64::atan2(qz, qw)) })
}

/// The text of a file that is compressed by gzip.
pub fn text(path: &Path) -> Result<String> {
    let file = std::fs::File::open(path).with_context(|| path.display().to_string())?;
    let mut text = String::new();
    let read = flate2::read::MultiGzDecoder::new(file).read_to_string(&mut text);
    read.with_context(|| path.display().to_string())?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_between_two_scans_is_in_proportion_to_time() {
        let poses = [(1.0, Pose2::IDENTITY), (2.0, Pose2::new(1.0, 0.0, 0.4))];
        let pose = Trajectory::of(&poses).between_scans(1.25).unwrap();
        assert!((pose.x_m - 0.25).abs() < 1e-12 && (pose.yaw_rad - 0.1).abs() < 1e-12);
        assert!(Trajectory::of(&poses).between_scans(2.5).is_none());
    }

    #[test]
    fn of_two_lines_of_one_time_the_last_one_counts() {
        let poses = [(1.0, Pose2::IDENTITY), (1.0, Pose2::new(1.0, 0.0, 0.0))];
        assert_eq!(Trajectory::of(&poses).nearest(1.001, 0.0015), Some(poses[1].1));
        assert_eq!(Trajectory::of(&poses).nearest(1.1, 0.0015), None);
    }

    #[test]
    fn a_line_of_the_tum_form_is_read_back() {
        let timed = parse("1.5 1.0 -2.0 0 0 0 0.479425539 0.877582562").unwrap();
        assert!((timed.pose.yaw_rad - 1.0).abs() < 1e-8);
        assert!(parse("1 2 3").is_err());
    }
}
