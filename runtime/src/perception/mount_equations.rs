//! What the motion of an image says of the camera's mount.
//!
//! A camera that is turned by a small rotation `d` against its configured mount moves otherwise than the poses say, when the robot
//! moves. With the configured motion `(R, t)` of points from the camera before to the camera now, its rotation is wrong by
//! `(I - R) d`, and its translation by `-t x R d`: a rotation of the robot shows pitch and roll, a straight line shows yaw.
//!
//! A straight line would show pitch too, but far worse: over half a metre it was wrong by 0.01 to 0.02 rad, a rotation by 0.002 rad (the
//! default robot in the simulator). Together they would need two noises, so that pitch is taken from rotations alone.

use nalgebra::{Matrix3, SMatrix, Vector3, Vector6};

use crate::calibration_watch::Sums;

/// A motion between two frames that rotates by less than this is straight, rad. On an arc of 1.5 cm and 4 degrees an error of the
/// rotation looks like one of the direction.
const STRAIGHT_RAD: f64 = 0.01;

/// The motion between two frames: what was configured, and what image motion says of its errors.
pub(super) struct Moved {
    /// Rotation of points from the camera before to the camera now, by the poses.
    pub rotation: Matrix3<f64>,
    /// Translation of the same, metres.
    pub translation_m: Vector3<f64>,
    /// The errors of rotation (rad) and translation (m) that fit best, and their covariance.
    pub errors: Vector6<f64>,
    pub covariance: SMatrix<f64, 6, 6>,
    /// The inverse variances of these errors that were expected before.
    pub prior: Vector6<f64>,
}

/// The equations of pitch (positive down), yaw (positive to the left) and roll (positive when the right side is lower) about the
/// camera's own axes, radians, beside the configured mount.
///
/// The errors were expected to be zero with the variances `P`; with the mount `d` they are `B d` and more of the same variances. Then
/// the information on `d` is `B' (1/P - 1/P C 1/P) B` and its pull `B' 1/P e`, for the errors `e` and their covariance `C`.
pub(super) fn mount_equations(moved: &Moved) -> Sums<3> {
    let signs = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
    let rotated = (Matrix3::identity() - moved.rotation) * signs;
    let mut translated = -moved.translation_m.cross_matrix() * moved.rotation * signs;
    translated.set_column(0, &Vector3::zeros());
    if rotation_rad(&moved.rotation) > STRAIGHT_RAD {
        translated.fill(0.0);
    }
    let mut by_mount = SMatrix::<f64, 6, 3>::zeros();
    by_mount.fixed_rows_mut::<3>(0).copy_from(&rotated);
    by_mount.fixed_rows_mut::<3>(3).copy_from(&translated);
    let prior = SMatrix::<f64, 6, 6>::from_diagonal(&moved.prior);
    let learnt = prior - prior * moved.covariance * prior;
    Sums {
        information: by_mount.transpose() * learnt * by_mount,
        pull: by_mount.transpose() * moved.prior.component_mul(&moved.errors),
    }
}

fn rotation_rad(rotation: &Matrix3<f64>) -> f64 {
    ((rotation.trace() - 1.0) / 2.0).clamp(-1.0, 1.0).acos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{CameraMount, Pose2, Pose3};

    /// The errors of rotation and translation of a camera at `true_mount` that is taken to be at `mount`, when the robot moves.
    fn moved(mount: &Pose3, true_mount: &Pose3, motion: &Pose2) -> Moved {
        let configured = seen(mount, motion);
        let truth = seen(true_mount, motion);
        let rotation_error = (truth.rotation.inverse() * configured.rotation).scaled_axis();
        // In the camera now, to first order: what is left of the translation after the rotation's error.
        let rotation = configured.rotation.to_rotation_matrix().into_inner();
        let translation_m = configured.translation.vector;
        let omega = rotation * rotation_error;
        let turned = translation_m - omega.cross(&translation_m);
        let errors = turned - truth.translation.vector;
        Moved {
            rotation,
            translation_m,
            errors: Vector6::from_iterator(omega.iter().chain(errors.iter()).copied()),
            covariance: SMatrix::identity() * 1e-12,
            prior: Vector6::repeat(1e4),
        }
    }

    fn seen(mount: &Pose3, motion: &Pose2) -> Pose3 {
        (motion.to_pose3() * mount).inverse() * mount
    }

    #[test]
    fn rotations_and_straight_lines_together_show_the_whole_mount() {
        let configured = CameraMount::LEVEL;
        let truth = CameraMount { pitch_down_deg: 1.0, yaw_deg: -0.5, roll_deg: 0.7, ..configured };
        let [mount, true_mount] = [configured, truth].map(|mount| mount.t_base_camera());
        let mut sums = Sums::default();
        for motion in [Pose2::new(0.0, 0.0, 0.05), Pose2::new(0.03, 0.0, 0.0)] {
            sums.add(&mount_equations(&moved(&mount, &true_mount, &motion)));
        }
        let (found, _) = sums.solve(&Vector3::repeat(1e3)).unwrap();
        let found_deg = found.map(f64::to_degrees);
        let expected_deg = Vector3::new(1.0, -0.5, 0.7);
        assert!((found_deg - expected_deg).norm() < 0.03, "{found_deg}");
    }

    #[test]
    fn a_straight_line_shows_yaw_and_no_pitch() {
        let configured = CameraMount::LEVEL;
        let truth = CameraMount { pitch_down_deg: 1.0, yaw_deg: -0.5, ..configured };
        let [mount, true_mount] = [configured, truth].map(|mount| mount.t_base_camera());
        let sums = mount_equations(&moved(&mount, &true_mount, &Pose2::new(0.03, 0.0, 0.0)));
        let (found, _) = sums.solve(&Vector3::new(1e3, 1e3, 1e-6)).unwrap();
        assert!(found[0].abs() < 1e-9, "{found}");
        assert!((found[1].to_degrees() + 0.5).abs() < 0.03, "{found}");
    }

    #[test]
    fn an_arc_says_nothing_of_yaw() {
        let mount = CameraMount::LEVEL.t_base_camera();
        let arc = moved(&mount, &mount, &Pose2::new(0.015, 0.0, 0.07));
        let yaw_by_translation = Vector3::new(0.0, 1.0, 0.0);
        let errors = Vector6::new(0.0, 0.0, 0.0, 0.001, 0.0, 0.0);
        let sums = mount_equations(&Moved { errors, ..arc });
        assert!(sums.pull.dot(&yaw_by_translation).abs() < 1e-12, "{}", sums.pull);
        let line = moved(&mount, &mount, &Pose2::new(0.03, 0.0, 0.0));
        let sums = mount_equations(&Moved { errors, ..line });
        assert!(sums.pull.dot(&yaw_by_translation).abs() > 0.01, "{}", sums.pull);
    }

    #[test]
    fn a_robot_that_stands_says_nothing() {
        let mount = CameraMount::LEVEL.t_base_camera();
        let sums = mount_equations(&moved(&mount, &mount, &Pose2::IDENTITY));
        assert!(sums.information.norm() < 1e-9 && sums.pull.norm() < 1e-9);
    }
}
