//! Counts the frames in which the robot made no progress.

use std::collections::VecDeque;

use hal::{Pose2, wrap_angle};

/// Number of frames of a window. With the paper's steps a working robot moves 0.6 m or rotates 40
/// degrees in this time.
const WINDOW: usize = 20;
/// Largest movement of a stuck robot, metres: less than one step forward.
const DISTANCE_M: f64 = 0.02;
/// Largest rotation of a stuck robot, radians: two rotation steps, which is dithering left and
/// right.
const ROTATION_RAD: f64 = 4.0 * std::f64::consts::PI / 180.0;

/// Counts stuck frames from ground-truth poses.
///
/// A frame is stuck if it belongs to 20 frames in a row in which the robot stayed within 2 cm and 4
/// degrees of one pose. The cause does not matter: a robot without a goal counts as stuck, like one
/// with blocked wheels.
#[derive(Debug, Clone, Default)]
pub struct StuckMeter {
    recent: VecDeque<Pose2>,
    seen: u64,
    /// Index one past the last frame that is known to be stuck.
    stuck_until: u64,
    stuck: u64,
    streak: u64,
    longest: u64,
}

impl StuckMeter {
    /// Adds the pose of the next frame.
    pub fn frame(&mut self, pose: Pose2) {
        if self.recent.len() == WINDOW {
            self.recent.pop_front();
        }
        self.recent.push_back(pose);
        self.seen += 1;
        if self.recent.len() < WINDOW || !self.recent.iter().all(|other| is_close(&pose, other)) {
            return;
        }
        let window_start = self.seen - WINDOW as u64;
        if window_start > self.stuck_until || self.stuck_until == 0 {
            self.streak = 0;
        }
        let added = self.seen - window_start.max(self.stuck_until);
        self.stuck += added;
        self.streak += added;
        self.longest = self.longest.max(self.streak);
        self.stuck_until = self.seen;
    }

    /// Number of stuck frames so far.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.stuck
    }

    /// Largest number of stuck frames in a row so far.
    #[must_use]
    pub fn longest(&self) -> u64 {
        self.longest
    }
}

fn is_close(pose: &Pose2, other: &Pose2) -> bool {
    pose.distance_m(other) < DISTANCE_M
        && wrap_angle(pose.yaw_rad - other.yaw_rad).abs() < ROTATION_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn meter(poses: impl IntoIterator<Item = (f64, f64)>) -> StuckMeter {
        let mut meter = StuckMeter::default();
        poses
            .into_iter()
            .for_each(|(x, degrees)| meter.frame(Pose2::new(x, 0.0, f64::to_radians(degrees))));
        meter
    }

    #[test]
    fn driving_and_rotating_on_the_spot_are_not_stuck() {
        assert_eq!(meter((0..200).map(|i| (0.03 * f64::from(i), 0.0))).frames(), 0);
        assert_eq!(meter((0..200).map(|i| (0.0, 2.0 * f64::from(i)))).frames(), 0);
    }

    #[test]
    fn standing_is_stuck_from_its_first_frame() {
        let still = meter((0..50).map(|_| (0.0, 0.0)));
        assert_eq!((still.frames(), still.longest()), (50, 50));
        assert_eq!(meter((0..19).map(|_| (0.0, 0.0))).frames(), 0);
    }

    #[test]
    fn dithering_left_and_right_is_stuck() {
        let dithering = meter((0..60).map(|i| (0.0, if i % 2 == 0 { 179.5 } else { -178.5 })));
        assert_eq!(dithering.frames(), 60);
    }

    fn drive(from: f64) -> impl Iterator<Item = (f64, f64)> {
        (1..=30).map(move |i| (from + 0.03 * f64::from(i), 0.0))
    }

    fn stand(at: f64, frames: usize) -> impl Iterator<Item = (f64, f64)> {
        std::iter::repeat_n((at, 0.0), frames)
    }

    #[test]
    fn two_stops_are_two_streaks() {
        let run = meter(stand(0.0, 30).chain(drive(0.0)).chain(stand(0.9, 40)).chain(drive(0.9)));
        // The last frame of a drive is already at the place of the stop.
        assert_eq!((run.frames(), run.longest()), (30 + 41, 41));
    }

    proptest! {
        /// Compares the counts with a direct evaluation of the definition for every frame.
        #[test]
        fn counts_equal_the_definition(steps in proptest::collection::vec((0.0..0.004f64, -0.5..0.5f64), 1..120)) {
            let mut x = 0.0;
            let mut yaw = 0.0;
            let poses: Vec<(f64, f64)> = steps.iter().map(|(dx, dyaw)| { x += dx * dx * 400.0; yaw += dyaw; (x, yaw) }).collect();
            let run = meter(poses.iter().copied());
            let mut stuck = vec![false; poses.len()];
            for end in WINDOW..=poses.len() {
                let window = &poses[end - WINDOW..end];
                let (x, yaw) = poses[end - 1];
                if window.iter().all(|p| (p.0 - x).abs() < DISTANCE_M && (p.1 - yaw).abs().to_radians() < ROTATION_RAD) {
                    stuck[end - WINDOW..end].fill(true);
                }
            }
            prop_assert_eq!(run.frames(), stuck.iter().filter(|s| **s).count() as u64);
            let longest = stuck.split(|s| !s).map(<[bool]>::len).max().unwrap_or(0);
            prop_assert_eq!(run.longest(), longest as u64);
        }
    }
}
