//! Where camera and LiDAR are mounted, in the words of a tape measure and a protractor.

use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::{Pose2, Pose3};

/// The camera's place on the robot. By default it is 0.8 m high, as in the paper, and looks forward and 16 degrees down: a camera with
/// 33 degrees between the upper and the lower edge of its image sees the floor from 1.25 m on, and the horizon at the upper edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraMount {
    /// Height of the optical centre above the floor.
    pub height_m: f64,
    /// Distance from `base_link` forward to the optical centre.
    pub forward_m: f64,
    /// Distance from `base_link` to the left to the optical centre.
    pub left_m: f64,
    /// Angle of the optical axis below the horizon.
    pub pitch_down_deg: f64,
    /// Rotation about the optical axis: positive where the image's right side is lower on the robot.
    pub roll_deg: f64,
    /// Direction of the optical axis, counter-clockwise from forward as seen from above.
    pub yaw_deg: f64,
}

impl Default for CameraMount {
    fn default() -> Self {
        Self { pitch_down_deg: 16.0, ..Self::LEVEL }
    }
}

impl CameraMount {
    /// The paper's mount: level. It sees the floor from 2.7 m on, so that stairs nearer than that are not seen.
    pub const LEVEL: Self = Self {
        height_m: 0.8,
        forward_m: 0.0,
        left_m: 0.0,
        pitch_down_deg: 0.0,
        roll_deg: 0.0,
        yaw_deg: 0.0,
    };

    /// The mount whose pose is `t_base_camera`. A camera that points straight up or down has no yaw.
    #[must_use]
    pub fn of(t_base_camera: &Pose3) -> Self {
        let turned = t_base_camera.rotation.to_rotation_matrix() * level().inverse();
        let (roll, pitch, yaw) = turned.euler_angles();
        let place_m = t_base_camera.translation.vector;
        Self {
            height_m: place_m.z,
            forward_m: place_m.x,
            left_m: place_m.y,
            pitch_down_deg: pitch.to_degrees(),
            roll_deg: roll.to_degrees(),
            yaw_deg: yaw.to_degrees(),
        }
    }

    /// `t_base_camera`: the pose of `camera_optical` (x right, y down, z forward) in `base_link`. The rotations follow REP-103:
    /// roll about x first, then pitch about y, then yaw about z.
    #[must_use]
    pub fn t_base_camera(&self) -> Pose3 {
        let angles_deg = [self.roll_deg, self.pitch_down_deg, self.yaw_deg];
        camera_pose([self.forward_m, self.left_m, self.height_m], angles_deg.map(f64::to_radians))
    }
}

/// The LiDAR's place on the robot. Its scan plane is level. The default is low enough for the feet of chairs, which are narrower
/// than their seats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LidarMount {
    /// Height of the scan plane above the floor.
    pub height_m: f64,
    /// Distance from `base_link` forward to the scanner's axis.
    pub forward_m: f64,
    /// Distance from `base_link` to the left to the scanner's axis.
    pub left_m: f64,
    /// Direction of the scanner's front, counter-clockwise from forward as seen from above.
    pub yaw_deg: f64,
}

impl Default for LidarMount {
    fn default() -> Self {
        Self { height_m: 0.18, forward_m: 0.0, left_m: 0.0, yaw_deg: 0.0 }
    }
}

impl LidarMount {
    /// `t_base_laser` in the scan plane.
    #[must_use]
    pub fn t_base_laser(&self) -> Pose2 {
        Pose2::new(self.forward_m, self.left_m, self.yaw_deg.to_radians())
    }

    /// `t_base_laser` with the height of the scan plane.
    #[must_use]
    pub fn t_base_laser_3d(&self) -> Pose3 {
        Pose3::translation(0.0, 0.0, self.height_m) * self.t_base_laser().to_pose3()
    }
}

/// The pose `t_base_camera` of a camera that faces forward, `height_m` above the origin of `base_link` and `forward_m` in front of
/// it, pitched `pitch_down_rad` below the horizon.
#[must_use]
pub fn camera_mount(forward_m: f64, height_m: f64, pitch_down_rad: f64) -> Pose3 {
    camera_pose([forward_m, 0.0, height_m], [0.0, pitch_down_rad, 0.0])
}

fn camera_pose(place_m: [f64; 3], [roll, pitch, yaw]: [f64; 3]) -> Pose3 {
    let roll = Rotation3::from_axis_angle(&Vector3::x_axis(), roll);
    let pitch = Rotation3::from_axis_angle(&Vector3::y_axis(), pitch);
    let yaw = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
    let rotation = yaw * pitch * roll * level();
    Pose3::from_parts(Translation3::from(place_m), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// The columns are the optical axes x (right), y (down), z (forward) of a level camera in `base_link`.
fn level() -> Rotation3<f64> {
    Rotation3::from_matrix_unchecked(Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    fn close(a: Point3<f64>, b: [f64; 3]) -> bool {
        (a - Point3::from(b)).norm() < 1e-12
    }

    #[test]
    fn a_level_camera_looks_forward_with_x_right_and_y_down() {
        let t_base_camera = camera_mount(0.1, 0.8, 0.0);
        assert!(close(t_base_camera * Point3::new(0.0, 0.0, 2.0), [2.1, 0.0, 0.8]));
        assert!(close(t_base_camera * Point3::new(1.0, 0.0, 0.0), [0.1, -1.0, 0.8]));
        assert!(close(t_base_camera * Point3::new(0.0, 0.8, 0.0), [0.1, 0.0, 0.0]));
    }

    #[test]
    fn a_camera_pitched_down_sees_the_floor_in_its_centre() {
        let t_base_camera = camera_mount(0.0, 1.0, core::f64::consts::FRAC_PI_4);
        let centre = t_base_camera * Point3::new(0.0, 0.0, core::f64::consts::SQRT_2);
        assert!(close(centre, [1.0, 0.0, 0.0]));
    }

    #[test]
    fn yaw_turns_the_optical_axis_to_the_left_and_left_moves_the_camera_there() {
        let mount = CameraMount { left_m: 0.2, yaw_deg: 90.0, ..CameraMount::LEVEL };
        let ahead = mount.t_base_camera() * Point3::new(0.0, 0.0, 1.0);
        assert!(close(ahead, [0.0, 1.2, 0.8]));
    }

    #[test]
    fn a_positive_roll_lowers_the_right_side_of_the_camera() {
        let mount = CameraMount { roll_deg: 30.0, ..CameraMount::LEVEL };
        let right = mount.t_base_camera() * Point3::new(1.0, 0.0, 0.0);
        assert!(close(right, [0.0, -(0.75_f64.sqrt()), 0.3]));
    }

    #[test]
    fn a_turned_scanner_sees_with_its_front_what_is_beside_the_robot() {
        let mount = LidarMount { left_m: 0.1, yaw_deg: 90.0, ..LidarMount::default() };
        let (x_m, y_m) = mount.t_base_laser().transform(1.0, 0.0);
        assert!(x_m.abs() < 1e-12 && (y_m - 1.1).abs() < 1e-12);
        let in_space = mount.t_base_laser_3d() * Point3::new(1.0, 0.0, 0.0);
        assert!(close(in_space, [0.0, 1.1, 0.18]));
    }

    proptest! {
        #[test]
        fn a_mount_is_known_by_its_pose(
            roll_deg in -45.0..45.0f64, yaw_deg in -170.0..170.0f64, pitch_down_deg in -80.0..80.0f64,
        ) {
            let mount = CameraMount { left_m: 0.1, pitch_down_deg, roll_deg, yaw_deg, ..CameraMount::LEVEL };
            let found = CameraMount::of(&mount.t_base_camera());
            prop_assert!((found.roll_deg - roll_deg).abs() < 1e-6);
            prop_assert!((found.pitch_down_deg - pitch_down_deg).abs() < 1e-6);
            prop_assert!((found.yaw_deg - yaw_deg).abs() < 1e-6);
            prop_assert!((found.left_m - 0.1).abs() < 1e-12);
        }

        #[test]
        fn roll_never_moves_the_optical_axis(roll_deg in -180.0..180.0f64, yaw_deg in -180.0..180.0f64, pitch_down_deg in -80.0..80.0f64) {
            let mount = CameraMount { pitch_down_deg, yaw_deg, ..CameraMount::LEVEL };
            let rolled = CameraMount { roll_deg, ..mount };
            let ahead = Point3::new(0.0, 0.0, 1.0);
            let difference = mount.t_base_camera() * ahead - rolled.t_base_camera() * ahead;
            prop_assert!(difference.norm() < 1e-12);
        }
    }
}
