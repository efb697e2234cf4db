//! Associates lists with different rates by time.

use hal::Pose3;

use super::list::{ImageEntry, PoseEntry};

/// The entry of `entries` (sorted by time) nearest to `time_ns`, if it is within `tolerance_ns`.
#[must_use]
pub fn nearest(entries: &[ImageEntry], time_ns: u64, tolerance_ns: u64) -> Option<&ImageEntry> {
    let after = entries.partition_point(|entry| entry.time_ns < time_ns);
    let around = [after.checked_sub(1).and_then(|i| entries.get(i)), entries.get(after)];
    around
        .into_iter()
        .flatten()
        .min_by_key(|entry| entry.time_ns.abs_diff(time_ns))
        .filter(|entry| entry.time_ns.abs_diff(time_ns) <= tolerance_ns)
}

/// The pose at `time_ns`, from the first of these that exists: a listed pose of exactly that time;
/// the interpolation (slerp) between two listed poses that are at most `3 * tolerance_ns` apart;
/// the nearest listed pose within `tolerance_ns`. `None` in a gap of the list.
///
/// With half a frame period as tolerance, the limit for interpolation is one period plus its
/// jitter.
#[must_use]
pub fn pose_at(poses: &[PoseEntry], time_ns: u64, tolerance_ns: u64) -> Option<Pose3> {
    let after = poses.partition_point(|entry| entry.time_ns < time_ns);
    let later = poses.get(after);
    if let Some(listed) = later.filter(|entry| entry.time_ns == time_ns) {
        return Some(listed.t_world_camera);
    }
    let earlier = after.checked_sub(1).and_then(|i| poses.get(i));
    if let (Some(a), Some(b)) = (earlier, later)
        && b.time_ns - a.time_ns <= 3 * tolerance_ns
    {
        let fraction = (time_ns - a.time_ns) as f64 / (b.time_ns - a.time_ns) as f64;
        return a.t_world_camera.try_lerp_slerp(&b.t_world_camera, fraction, 1e-9);
    }
    let near = [earlier, later]
        .into_iter()
        .flatten()
        .min_by_key(|entry| entry.time_ns.abs_diff(time_ns))?;
    (near.time_ns.abs_diff(time_ns) <= tolerance_ns).then_some(near.t_world_camera)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    fn pose(time_ns: u64, x_m: f64, yaw_rad: f64) -> PoseEntry {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad);
        PoseEntry {
            time_ns,
            t_world_camera: Pose3::from_parts(Translation3::new(x_m, 0.0, 0.0), rotation),
        }
    }

    fn image(time_ns: u64) -> ImageEntry {
        ImageEntry { time_ns, path: "x".into() }
    }

    #[test]
    fn the_nearest_image_within_the_tolerance_is_taken() {
        let list = [image(100), image(200)];
        assert_eq!(nearest(&list, 140, 50), Some(&list[0]));
        assert_eq!(nearest(&list, 160, 50), Some(&list[1]));
        assert_eq!(nearest(&list, 260, 50), None);
        assert_eq!(nearest(&list, 40, 50), None);
    }

    #[test]
    fn between_two_poses_position_and_heading_are_interpolated() {
        let at = pose_at(&[pose(100, 0.0, 0.0), pose(200, 1.0, 0.4)], 125, 50).unwrap();
        assert!(
            (at.translation.x - 0.25).abs() < 1e-12 && (at.rotation.angle() - 0.1).abs() < 1e-9
        );
    }

    #[test]
    fn a_listed_pose_is_returned_unchanged() {
        let list = [pose(100, 0.0, 0.0), pose(200, 1.0, 0.4)];
        assert!((pose_at(&list, 200, 50).unwrap().translation.x - 1.0).abs() < 1e-12);
        assert_eq!(pose_at(&list, 100, 50).unwrap(), list[0].t_world_camera);
    }

    #[test]
    fn poses_are_not_interpolated_across_a_gap() {
        let list = [pose(100, 0.0, 0.0), pose(900, 1.0, 0.4)];
        assert_eq!(pose_at(&list, 500, 50), None);
        assert_eq!(pose_at(&list, 130, 50), Some(list[0].t_world_camera));
        assert_eq!(pose_at(&list, 1000, 50), None);
    }

    #[test]
    fn quaternions_of_opposite_sign_are_the_same_heading() {
        let mut b = pose(200, 0.0, 0.2);
        b.t_world_camera.rotation =
            UnitQuaternion::new_unchecked(-b.t_world_camera.rotation.into_inner());
        let at = pose_at(&[pose(100, 0.0, 0.0), b], 150, 50).unwrap();
        assert!((at.rotation.angle() - 0.1).abs() < 1e-9);
    }
}
