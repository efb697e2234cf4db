//! A floor that is not quite flat, and tilts the robot a little.

use hal::{Pose2, Pose3};
use nalgebra::{UnitQuaternion, Vector3};

/// Wavelengths of the floor's waves, metres, and the directions in which they run, radians. They are
/// spread over half a circle, so that the mean square slope is the same in every direction.
const WAVES: [(f64, f64); 4] = [
    (0.9, 0.3),
    (1.3, 0.3 + std::f64::consts::FRAC_PI_4),
    (1.9, 0.3 + std::f64::consts::FRAC_PI_2),
    (2.7, 0.3 + 3.0 * std::f64::consts::FRAC_PI_4),
];

/// Waves of a floor, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unevenness {
    /// Largest slope of each wave.
    slope: f64,
}

impl Unevenness {
    /// A floor whose slope along any direction has this root mean square, radians.
    #[must_use]
    pub fn new(tilt_rad: f64) -> Self {
        // Each wave has half of its squared slope on average, and its direction's share of that:
        // over four directions the shares add up to 2.
        Self { slope: tilt_rad.tan() }
    }

    /// `t_world_base` of a robot at a place of the floor.
    #[must_use]
    pub fn raise(&self, pose: &Pose2) -> Pose3 {
        let level = pose.to_pose3();
        if self.slope == 0.0 {
            return level;
        }
        let mut height_m = 0.0;
        let mut gradient = [0.0; 2];
        for (index, (wavelength_m, direction_rad)) in WAVES.into_iter().enumerate() {
            let (sin, cos) = direction_rad.sin_cos();
            let wave_number = std::f64::consts::TAU / wavelength_m;
            let phase = wave_number * (cos * pose.x_m + sin * pose.y_m) + index as f64;
            height_m += self.slope / wave_number * phase.sin();
            gradient[0] += self.slope * cos * phase.cos();
            gradient[1] += self.slope * sin * phase.cos();
        }
        let normal = Vector3::new(-gradient[0], -gradient[1], 1.0);
        // The slope is small, so the normal is never opposite to the vertical.
        let tilt = UnitQuaternion::rotation_between(&Vector3::z(), &normal)
            .unwrap_or_else(UnitQuaternion::identity);
        let mut raised = level;
        raised.translation.z += height_m;
        raised.rotation = tilt * level.rotation;
        raised
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_floor_tilts_nothing() {
        let pose = Pose2::new(1.0, 2.0, 0.5);
        assert_eq!(Unevenness::new(0.0).raise(&pose), pose.to_pose3());
    }

    #[test]
    fn pitch_and_roll_have_the_stated_size_and_the_heading_stays() {
        let floor = Unevenness::new(0.004);
        let mut pitches = 0.0;
        let mut rolls = 0.0;
        let count = 20_000;
        for step in 0..count {
            let along = f64::from(step);
            let pose = Pose2::new(along * 0.137, along * 0.071, along * 0.37);
            let raised = floor.raise(&pose);
            let ahead = raised.rotation * Vector3::x();
            let left = raised.rotation * Vector3::y();
            pitches += ahead.z.powi(2);
            rolls += left.z.powi(2);
            let yaw = ahead.y.atan2(ahead.x);
            assert!(hal::wrap_angle(yaw - pose.yaw_rad).abs() < 1e-3);
            assert!(raised.translation.z.abs() < 0.006);
        }
        for sum in [pitches, rolls] {
            let rms = (sum / f64::from(count)).sqrt();
            assert!((rms / 0.004 - 1.0).abs() < 0.05, "{rms}");
        }
    }

    #[test]
    fn the_tilt_is_that_of_the_ground_under_the_robot() {
        let floor = Unevenness::new(0.005);
        let here = floor.raise(&Pose2::new(0.4, -1.1, 0.0));
        let ahead = floor.raise(&Pose2::new(0.401, -1.1, 0.0));
        let slope = (ahead.translation.z - here.translation.z) / 0.001;
        let forward = here.rotation * Vector3::x();
        assert!((forward.z / forward.x - slope).abs() < 1e-4);
    }
}
