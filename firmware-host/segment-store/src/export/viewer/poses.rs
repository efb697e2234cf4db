//! Where the robot and its scanner are in `map`, from the transforms that the recorder writes with every tick.

use foxglove::messages as fox;
use hal::Pose3;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

/// A robot that does not move for this long between two ticks, or whose recording has a gap, is not interpolated.
const MAX_STEP_NS: u64 = 1_000_000_000;

/// The poses of the newest two ticks.
#[derive(Debug, Default)]
pub(super) struct Poses {
    t_map_odom: Option<Pose3>,
    t_base_laser: Option<Pose3>,
    /// Time and `t_odom_base` of the tick before.
    before: Option<(u64, Pose3)>,
    /// The same of the newest tick.
    now: Option<(u64, Pose3)>,
}

impl Poses {
    /// Takes the transforms of a tick.
    pub fn take(&mut self, message: &fox::FrameTransforms, time_ns: u64) {
        self.before = self.now;
        self.now = pose_of(message, "base_link").map(|t_odom_base| (time_ns, t_odom_base));
        self.t_map_odom = pose_of(message, "odom");
        self.t_base_laser = pose_of(message, "laser");
    }

    /// The robot's pose in `map` at the newest tick, unless the robot is lost.
    pub fn t_map_base(&self) -> Option<Pose3> {
        Some(self.t_map_odom? * self.now?.1)
    }

    /// The scanner's pose in `map` at a time before the newest tick, at which the robot may have rotated.
    pub fn t_map_laser(&self, time_ns: u64) -> Option<Pose3> {
        Some(self.t_map_odom? * self.t_odom_base(time_ns)? * self.t_base_laser?)
    }

    fn t_odom_base(&self, time_ns: u64) -> Option<Pose3> {
        let (now_ns, now) = self.now?;
        let Some((before_ns, before)) = self.before else { return Some(now) };
        let step_ns = now_ns.saturating_sub(before_ns);
        if step_ns == 0 || step_ns > MAX_STEP_NS {
            return Some(now);
        }
        let share = time_ns.saturating_sub(before_ns) as f64 / step_ns as f64;
        Some(before.try_lerp_slerp(&now, share.min(1.0), 1e-9).unwrap_or(now))
    }
}

fn pose_of(message: &fox::FrameTransforms, child: &str) -> Option<Pose3> {
    pose(message.transforms.iter().find(|found| found.child_frame_id == child)?)
}

fn pose(transform: &fox::FrameTransform) -> Option<Pose3> {
    let at = transform.translation?;
    let q = transform.rotation?;
    let rotation = UnitQuaternion::try_new(Quaternion::new(q.w, q.x, q.y, q.z), 1e-6)?;
    Some(Pose3::from_parts(Translation3::new(at.x, at.y, at.z), rotation))
}

#[cfg(test)]
mod tests {
    use hal::Pose2;

    use super::*;

    fn transforms(x_m: f64, yaw_rad: f64) -> fox::FrameTransforms {
        fox::FrameTransforms {
            transforms: vec![
                transform("base_link", "laser", Pose3::translation(0.1, 0.0, 0.2)),
                transform("odom", "base_link", Pose2::new(x_m, 0.0, yaw_rad).to_pose3()),
                transform("map", "odom", Pose2::new(0.0, 5.0, 0.0).to_pose3()),
            ],
        }
    }

    fn transform(parent: &str, child: &str, pose: Pose3) -> fox::FrameTransform {
        let at = pose.translation.vector;
        let q = pose.rotation;
        fox::FrameTransform {
            timestamp: None,
            parent_frame_id: parent.to_owned(),
            child_frame_id: child.to_owned(),
            translation: Some(fox::Vector3 { x: at.x, y: at.y, z: at.z }),
            rotation: Some(fox::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
        }
    }

    #[test]
    fn a_scan_between_two_ticks_is_placed_where_the_robot_was_then() {
        let mut poses = Poses::default();
        poses.take(&transforms(1.0, 0.0), 100_000_000);
        poses.take(&transforms(2.0, 0.2), 200_000_000);
        let laser = poses.t_map_laser(150_000_000).unwrap();
        let expected = Pose2::new(1.5, 5.0, 0.1).to_pose3() * Pose3::translation(0.1, 0.0, 0.2);
        assert!((laser.translation.vector - expected.translation.vector).norm() < 1e-9);
        assert!(laser.rotation.angle_to(&expected.rotation) < 1e-6);
        assert!((poses.t_map_base().unwrap().translation.x - 2.0).abs() < 1e-9);
    }

    #[test]
    fn a_lost_robot_has_no_pose() {
        let mut poses = Poses::default();
        poses.take(&transforms(1.0, 0.0), 1);
        poses.take(&fox::FrameTransforms::default(), 2);
        assert!(poses.t_map_base().is_none() && poses.t_map_laser(2).is_none());
    }
}
