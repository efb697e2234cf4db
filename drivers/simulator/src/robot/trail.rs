//! The recent true poses of the robot: sensors need time to measure, and the robot moves meanwhile.

use std::collections::VecDeque;

use hal::Pose2;

/// Poses older than this are forgotten, nanoseconds: more than two scans and the largest latency of
/// a camera.
const KEPT_NS: u64 = 1_000_000_000;

/// The true poses of the last second, at the ends of the simulation's steps.
#[derive(Debug, Clone)]
pub(super) struct Trail {
    /// Time of the end of a step, and `t_world_base` then; never empty.
    ends: VecDeque<(u64, Pose2)>,
}

impl Trail {
    /// The trail of a robot that has always stood at `start`.
    pub fn new(now_ns: u64, start: Pose2) -> Self {
        Self { ends: VecDeque::from([(now_ns, start)]) }
    }

    /// Adds the pose at the end of a step. Times must increase.
    pub fn push(&mut self, time_ns: u64, pose: Pose2) {
        self.ends.push_back((time_ns, pose));
        // The last one before the kept time remains, as the beginning of the first kept step.
        while self.ends.get(1).is_some_and(|(then_ns, _)| then_ns + KEPT_NS < time_ns) {
            self.ends.pop_front();
        }
    }

    /// The robot is at `pose` at the end of the last step: it was pushed during that step.
    pub fn move_end(&mut self, pose: Pose2) {
        if let Some((_, end)) = self.ends.back_mut() {
            *end = pose;
        }
    }

    /// The pose at a time, along the arc of the step in which it lies. Before the first known time the robot stands.
    /// After the last known time it continues with the motion of the last step, because the exposure of a frame ends
    /// later than its middle.
    pub fn at(&self, time_ns: i64) -> Pose2 {
        let after = self.ends.partition_point(|(then_ns, _)| (*then_ns as i64) < time_ns);
        let last = self.ends.len() - 1;
        let (end_ns, end) = self.ends[after.min(last)];
        let Some((start_ns, start)) = after.min(last).checked_sub(1).map(|i| self.ends[i]) else {
            return end;
        };
        let share = (time_ns - start_ns as i64) as f64 / (end_ns - start_ns) as f64;
        start.compose(&part_of(&start.inverse().compose(&end), share))
    }

    /// Whether the robot moved in the last step.
    pub fn moved(&self) -> bool {
        let [before, last] = [2, 1].map(|back| self.ends.len().checked_sub(back));
        before.zip(last).is_some_and(|(before, last)| self.ends[before].1 != self.ends[last].1)
    }
}

/// A part of a motion along its arc (the exponential map of a share of its logarithm).
fn part_of(motion: &Pose2, share: f64) -> Pose2 {
    let half = motion.yaw_rad / 2.0;
    let part = half * share;
    let (sin, cos) = (part - half).sin_cos();
    let scale = share * chord_by_arc(part) / chord_by_arc(half);
    Pose2::new(
        scale * (cos * motion.x_m - sin * motion.y_m),
        scale * (sin * motion.x_m + cos * motion.y_m),
        motion.yaw_rad * share,
    )
}

/// The length of a chord divided by that of its arc: sin(x) / x, where x is half of the arc's angle.
fn chord_by_arc(half_angle: f64) -> f64 {
    if half_angle.abs() < 1e-9 { 1.0 } else { half_angle.sin() / half_angle }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Twist2;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_part_of_an_arc_lies_on_it(v in -1.0..1.0, w in -3.0..3.0, share in 0.0..1.0) {
            let twist = Twist2 { linear_mps: v, angular_radps: w };
            let part = part_of(&twist.integrate(0.5), share);
            let expected = twist.integrate(0.5 * share);
            prop_assert!(part.distance_m(&expected) < 1e-9, "{part:?} for {expected:?}");
            prop_assert!((part.yaw_rad - expected.yaw_rad).abs() < 1e-9);
        }
    }

    #[test]
    fn poses_between_steps_are_interpolated_and_after_the_last_one_the_motion_goes_on() {
        let mut trail = Trail::new(0, Pose2::new(1.0, 0.0, 0.0));
        trail.push(100, Pose2::new(2.0, 0.0, 0.0));
        trail.push(200, Pose2::new(2.0, 0.0, 1.0));
        for (time_ns, x, yaw) in [
            (-50, 1.0, 0.0),
            (0, 1.0, 0.0),
            (25, 1.25, 0.0),
            (100, 2.0, 0.0),
            (150, 2.0, 0.5),
            (250, 2.0, 1.5),
        ] {
            let pose = trail.at(time_ns);
            assert!(
                (pose.x_m - x).abs() < 1e-12 && (pose.yaw_rad - yaw).abs() < 1e-12,
                "{time_ns}"
            );
        }
    }

    #[test]
    fn the_memory_is_bounded_and_covers_the_last_second() {
        let mut trail = Trail::new(0, Pose2::IDENTITY);
        for step in 1..=5000_u64 {
            trail.push(step * 10_000_000, Pose2::new(step as f64, 0.0, 0.0));
        }
        assert!(trail.ends.len() < 110);
        assert!((trail.at(49_005_000_000).x_m - 4900.5).abs() < 1e-9);
    }
}
