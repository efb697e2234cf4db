//! Positions and orientations in the plane and in space.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// A rigid transform in space. `t_a_b` maps points of frame b into frame a; compose with `*`,
/// invert with `.inverse()`.
pub type Pose3 = Isometry3<f64>;

/// A rigid transform in the plane. The pose of frame b in frame a is `t_a_b`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pose2 {
    pub x_m: f64,
    pub y_m: f64,
    /// Heading, counter-clockwise from the x axis, in (-pi, pi].
    pub yaw_rad: f64,
}

impl Pose2 {
    /// The identity transform.
    pub const IDENTITY: Self = Self { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0 };

    /// A pose whose heading is wrapped to (-pi, pi].
    #[must_use]
    pub fn new(x_m: f64, y_m: f64, yaw_rad: f64) -> Self {
        Self { x_m, y_m, yaw_rad: wrap_angle(yaw_rad) }
    }

    /// `t_a_b.compose(t_b_c) = t_a_c`.
    #[must_use]
    pub fn compose(&self, t_b_c: &Self) -> Self {
        let (x_m, y_m) = self.transform(t_b_c.x_m, t_b_c.y_m);
        Self::new(x_m, y_m, self.yaw_rad + t_b_c.yaw_rad)
    }

    /// `t_a_b.inverse() = t_b_a`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (sin, cos) = sin_cos(self.yaw_rad);
        Self::new(
            -(cos * self.x_m + sin * self.y_m),
            sin * self.x_m - cos * self.y_m,
            -self.yaw_rad,
        )
    }

    /// Maps a point of frame b into frame a.
    #[must_use]
    pub fn transform(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        let (sin, cos) = sin_cos(self.yaw_rad);
        (self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m)
    }

    /// Straight-line distance between the two origins, metres.
    #[must_use]
    pub fn distance_m(&self, other: &Self) -> f64 {
        hypot(self.x_m - other.x_m, self.y_m - other.y_m)
    }

    /// The same pose in space, at height 0.
    #[must_use]
    pub fn to_pose3(&self) -> Pose3 {
        Pose3::from_parts(
            Translation3::new(self.x_m, self.y_m, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw_rad),
        )
    }

    /// The part in the plane of a pose that is turned about the vertical only.
    #[must_use]
    pub fn of_level(pose: &Pose3) -> Self {
        let ahead = pose.rotation * Vector3::x();
        Self::new(
            pose.translation.x,
            pose.translation.y,
            nalgebra::RealField::atan2(ahead.y, ahead.x),
        )
    }

    /// Whether every component is finite. A pose that is not finite must be refused, never
    /// repaired.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.yaw_rad.is_finite()
    }
}

/// Wraps `angle_rad` to (-pi, pi].
#[must_use]
pub fn wrap_angle(angle_rad: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    let wrapped = angle_rad - TAU * nalgebra::ComplexField::floor((angle_rad + PI) / TAU);
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

fn sin_cos(angle_rad: f64) -> (f64, f64) {
    nalgebra::ComplexField::sin_cos(angle_rad)
}

fn hypot(x: f64, y: f64) -> f64 {
    nalgebra::ComplexField::hypot(x, y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-20.0..20.0, -20.0..20.0, -10.0..10.0).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    fn close(a: &Pose2, b: &Pose2) -> bool {
        a.distance_m(b) < 1e-9 && wrap_angle(a.yaw_rad - b.yaw_rad).abs() < 1e-9
    }

    proptest! {
        #[test]
        fn a_pose_and_its_inverse_cancel(a in pose()) {
            prop_assert!(close(&a.compose(&a.inverse()), &Pose2::IDENTITY));
            prop_assert!(close(&a.inverse().compose(&a), &Pose2::IDENTITY));
        }

        #[test]
        fn composition_is_associative(a in pose(), b in pose(), c in pose()) {
            prop_assert!(close(&a.compose(&b).compose(&c), &a.compose(&b.compose(&c))));
        }

        #[test]
        fn a_planar_pose_and_its_spatial_pose_map_points_equally(
            a in pose(),
            x in -5.0..5.0,
            y in -5.0..5.0,
        ) {
            let (px, py) = a.transform(x, y);
            let p = a.to_pose3() * Point3::new(x, y, 0.0);
            prop_assert!((p.x - px).abs() < 1e-9 && (p.y - py).abs() < 1e-9 && p.z.abs() < 1e-12);
        }

        #[test]
        fn the_planar_part_of_a_raised_pose_is_the_pose(a in pose(), height_m in -1.0..2.0) {
            let raised = Pose3::translation(0.0, 0.0, height_m) * a.to_pose3();
            prop_assert!(close(&Pose2::of_level(&raised), &a));
        }

        #[test]
        fn wrapped_angles_are_equivalent_and_in_range(angle in -100.0..100.0f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -core::f64::consts::PI - 1e-12);
            prop_assert!(wrapped <= core::f64::consts::PI + 1e-12);
            prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-9);
            prop_assert!((wrapped.cos() - angle.cos()).abs() < 1e-9);
        }
    }

    #[test]
    fn a_pose_with_nan_is_not_finite() {
        assert!(!Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY }.is_finite());
        assert!(Pose2::IDENTITY.is_finite());
    }
}
