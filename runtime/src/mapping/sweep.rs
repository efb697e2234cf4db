//! Where the scanner was while it measured the beams of a scan: the robot drives and rotates meanwhile.

use hal::{Pose2, Twist2};

/// A robot is not faster, m/s and rad/s: wheels that seem to be have slipped or were corrected in one step. As for the poses of
/// other programs.
const FASTEST: [f64; 2] = [2.0, 4.0];

/// Pose of the scanner during a scan. At 1 rad/s a scanner of 10 revolutions per second measures its last beam .05 rad after the
/// middle of the scan, which is 10 cm at 2 m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sweep {
    /// At the middle of the scan, in the frame of the map.
    pub t_map_laser: Pose2,
    /// Velocity of the scanner in the frame of the map, m/s.
    x_mps: f64,
    y_mps: f64,
    yaw_radps: f64,
}

impl Sweep {
    /// A scan during which the robot stands.
    #[must_use]
    pub fn at_rest(t_map_laser: Pose2) -> Self {
        Self { t_map_laser, x_mps: 0.0, y_mps: 0.0, yaw_radps: 0.0 }
    }

    /// A scan with the robot at `t_map_base` in its middle, and with this velocity. One that no robot has counts as none.
    #[must_use]
    pub fn new(t_map_base: &Pose2, t_base_laser: &Pose2, twist: &Twist2) -> Self {
        let t_map_laser = t_map_base.compose(t_base_laser);
        let Twist2 { linear_mps, angular_radps } = *twist;
        let [fastest_mps, fastest_radps] = FASTEST;
        // NaN fails these comparisons.
        if !(linear_mps.abs() <= fastest_mps && angular_radps.abs() <= fastest_radps) {
            return Self::at_rest(t_map_laser);
        }
        // A scanner that is not on the axis of the wheels moves sideways while the robot rotates.
        let forward_mps = linear_mps - angular_radps * t_base_laser.y_m;
        let left_mps = angular_radps * t_base_laser.x_m;
        let (sin, cos) = t_map_base.yaw_rad.sin_cos();
        Self {
            t_map_laser,
            x_mps: cos * forward_mps - sin * left_mps,
            y_mps: sin * forward_mps + cos * left_mps,
            yaw_radps: angular_radps,
        }
    }

    /// The pose `after_s` after the middle of the scan. That the path is bent in this time is left out: half a millimetre at
    /// .3 m/s, 1 rad/s and .05 s.
    pub(super) fn at(&self, after_s: f64) -> Pose2 {
        let Pose2 { x_m, y_m, yaw_rad } = self.t_map_laser;
        Pose2 {
            x_m: x_m + self.x_mps * after_s,
            y_m: y_m + self.y_mps * after_s,
            yaw_rad: yaw_rad + self.yaw_radps * after_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_pose_is_that_of_a_scanner_on_a_robot_that_drives_an_arc(
            x in -5.0..5.0, y in -5.0..5.0, yaw in -3.0..3.0, forward in -0.2..0.3, left in -0.2..0.2,
            v in -0.3..0.3, w in -1.0..1.0, after_s in -0.05..0.05,
        ) {
            let t_map_base = Pose2::new(x, y, yaw);
            let t_base_laser = Pose2::new(forward, left, 0.4);
            let twist = Twist2 { linear_mps: v, angular_radps: w };
            let moved = t_map_base.compose(&twist.integrate(after_s)).compose(&t_base_laser);
            let found = Sweep::new(&t_map_base, &t_base_laser, &twist).at(after_s);
            prop_assert!(found.distance_m(&moved) < 1e-3, "{found:?} {moved:?}");
            prop_assert!(hal::wrap_angle(found.yaw_rad - moved.yaw_rad).abs() < 1e-9);
        }
    }

    #[test]
    fn a_velocity_that_no_robot_has_counts_as_none() {
        for [linear_mps, angular_radps] in [[f64::NAN, 1.0], [1e10, 0.0], [0.0, -4.1]] {
            let twist = Twist2 { linear_mps, angular_radps };
            let sweep = Sweep::new(&Pose2::IDENTITY, &Pose2::IDENTITY, &twist);
            assert_eq!(sweep, Sweep::at_rest(Pose2::IDENTITY));
        }
    }
}
