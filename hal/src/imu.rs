//! The inertial measurement unit: its samples, its orientation on the robot, and its trait.

use nalgebra::{UnitQuaternion, Vector3};

use crate::ErrorType;

/// One sample, in the axes of the `imu` frame (right-handed).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// Time of the measurement on the monotonic clock.
    pub time_ns: u64,
    /// Angular velocity about x, y and z, rad/s.
    pub angular_radps: [f64; 3],
    /// Specific force along x, y and z, m/s2: at rest, 9.8 upwards. `None` for a gyroscope alone.
    pub force_mps2: Option<[f64; 3]>,
}

impl ImuSample {
    /// Whether all numbers are finite. A sample that is not must be refused, never clamped.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let force = self.force_mps2.unwrap_or_default();
        self.angular_radps.iter().chain(&force).all(|value| value.is_finite())
    }

    /// The same sample in the axes into which `rotation` rotates those of the unit.
    #[must_use]
    pub fn rotated(&self, rotation: &UnitQuaternion<f64>) -> Self {
        let rotate = |vector: [f64; 3]| (rotation * Vector3::from(vector)).into();
        Self {
            time_ns: self.time_ns,
            angular_radps: rotate(self.angular_radps),
            force_mps2: self.force_mps2.map(rotate),
        }
    }
}

/// The unit's orientation on the robot. Its position does not matter: every point of a rigid robot rotates with the same angular
/// velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImuMount {
    /// Rotation about x, the first of the three (REP-103: roll, then pitch, then yaw, about the axes of `base_link`).
    pub roll_deg: f64,
    /// Rotation about y.
    pub pitch_deg: f64,
    /// Rotation about z.
    pub yaw_deg: f64,
}

impl ImuMount {
    /// Rotates vectors of `imu` into `base_link`.
    #[must_use]
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_euler_angles(
            self.roll_deg.to_radians(),
            self.pitch_deg.to_radians(),
            self.yaw_deg.to_radians(),
        )
    }

    /// The mount of a unit that measures this specific force while the robot stands on level floor. Gravity says nothing about the
    /// rotation about itself: `yaw_deg` is 0.
    #[must_use]
    pub fn of_force(force_mps2: [f64; 3]) -> Self {
        let [x, y, z] = force_mps2;
        let across = nalgebra::ComplexField::sqrt(y * y + z * z);
        Self {
            roll_deg: nalgebra::RealField::atan2(y, z).to_degrees(),
            pitch_deg: nalgebra::RealField::atan2(-x, across).to_degrees(),
            yaw_deg: 0.0,
        }
    }

    /// The direction up (z of `base_link`) in the axes of `imu`.
    #[must_use]
    pub fn up(&self) -> Vector3<f64> {
        self.rotation().inverse() * Vector3::z()
    }
}

/// An inertial measurement unit, or a gyroscope alone, that is fixed to the robot.
///
/// * *Blocking*: no method blocks. A driver reads the device on a thread of its own and queues its samples.
/// * *Freshness*: returns every sample once, oldest first, so that the caller can integrate them. A driver whose queue is full drops
///   samples: the gap shows in their times.
/// * *Unplug*: returns [`Disconnected`](crate::ErrorKind::Disconnected) until the driver has reopened the device.
/// * *Retries*: the driver retries; the caller only polls.
pub trait Imu: ErrorType {
    /// Returns the oldest sample that was not returned before, or `None` when there is none.
    ///
    /// # Errors
    /// As described for the trait, and [`Timeout`](crate::ErrorKind::Timeout) when no sample has come for longer than the driver
    /// allows.
    fn poll_sample(&mut self) -> Result<Option<ImuSample>, Self::Error>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_on_its_side_or_on_its_head_knows_where_up_is() {
        let level = ImuMount::default();
        assert!((level.up() - Vector3::z()).norm() < 1e-12);
        let on_its_head = ImuMount { roll_deg: 180.0, ..level };
        assert!((on_its_head.up() + Vector3::z()).norm() < 1e-12);
        // Rolled by 90 degrees about x (forward), its y axis points up.
        let on_its_side = ImuMount { roll_deg: 90.0, ..level };
        assert!((on_its_side.up() - Vector3::y()).norm() < 1e-12);
        let yawed = ImuMount { yaw_deg: 77.0, ..level };
        assert!((yawed.up() - Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn gravity_at_rest_tells_roll_and_pitch_of_the_mount() {
        for [roll_deg, pitch_deg] in [[0.0, 0.0], [180.0, 0.0], [90.0, 10.0], [-30.0, -60.0]] {
            let mount = ImuMount { roll_deg, pitch_deg, yaw_deg: 25.0 };
            let found = ImuMount::of_force((9.81 * mount.up()).into());
            let level = ImuMount { yaw_deg: 0.0, ..mount };
            assert!((found.up() - level.up()).norm() < 1e-9, "{found:?}");
            assert!((found.pitch_deg - pitch_deg).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn a_rotation_about_the_axis_that_points_up_is_a_yaw_of_the_robot() {
        let mount = ImuMount { roll_deg: 90.0, ..ImuMount::default() };
        let sample = ImuSample { time_ns: 7, angular_radps: [0.0, 0.5, 0.0], force_mps2: None };
        let rotated = sample.rotated(&mount.rotation());
        assert!((rotated.angular_radps[2] - 0.5).abs() < 1e-12, "{rotated:?}");
    }

    #[test]
    fn a_sample_with_a_number_that_is_not_finite_is_not_finite() {
        let sample = ImuSample { time_ns: 1, angular_radps: [0.1; 3], force_mps2: None };
        assert!(sample.is_finite());
        assert!(!ImuSample { angular_radps: [0.0, f64::NAN, 0.0], ..sample }.is_finite());
        assert!(!ImuSample { force_mps2: Some([f64::INFINITY, 0.0, 0.0]), ..sample }.is_finite());
    }
}
