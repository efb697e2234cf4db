//! Forward and inverse kinematics of two driven wheels, and odometry with its covariance.

use hal::{Pose2, Twist2};
use nalgebra::{Matrix2, Matrix3, Matrix3x2};

/// One value for each wheel: left, right.
pub type Wheels = [f64; 2];

/// A differential drive. Wheel velocities are at the rim, in m/s, positive forwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kinematics {
    /// Distance between the wheels' contact points, metres.
    pub track_m: f64,
}

impl Kinematics {
    /// Inverse kinematics: the wheel velocities that move `base_link` with this twist.
    #[must_use]
    pub fn wheels(&self, twist: &Twist2) -> Wheels {
        let yaw_mps = twist.angular_radps * self.track_m / 2.0;
        [twist.linear_mps - yaw_mps, twist.linear_mps + yaw_mps]
    }

    /// Forward kinematics: the twist of `base_link` for these wheel velocities, without slip.
    #[must_use]
    pub fn twist(&self, [left, right]: Wheels) -> Twist2 {
        Twist2 { linear_mps: (left + right) / 2.0, angular_radps: (right - left) / self.track_m }
    }
}

/// Dead reckoning from the wheels' travel.
///
/// *Model.* The error of each wheel's travel over a step is independent and unbiased. Its variance
/// grows with the distance: `slip_m * |distance|`, so 1 m of travel has a standard deviation of
/// `sqrt(slip_m)` (Chong and Kleeman 1997). The pose moves along the exact arc. The covariance is
/// propagated with the derivatives of the motion at the middle of the step. Errors of the wheel
/// radius and the track are not included: they are biases, which calibration must remove.
#[derive(Debug, Clone, PartialEq)]
pub struct Odometry {
    kinematics: Kinematics,
    slip_m: f64,
    pose: Pose2,
    covariance: Matrix3<f64>,
}

impl Odometry {
    /// Starts at the origin with zero covariance. `slip_m` is the variance per metre of one wheel's
    /// travel, in metres.
    #[must_use]
    pub fn new(kinematics: Kinematics, slip_m: f64) -> Self {
        Self { kinematics, slip_m, pose: Pose2::IDENTITY, covariance: Matrix3::zeros() }
    }

    /// Adds one step of both wheels, in metres at the rim.
    pub fn advance(&mut self, travel_m: Wheels) {
        let step = self.kinematics.twist(travel_m);
        let (sin, cos) = (self.pose.yaw_rad + step.angular_radps / 2.0).sin_cos();
        let length = step.linear_mps;
        let along_yaw =
            Matrix3::new(1.0, 0.0, -length * sin, 0.0, 1.0, length * cos, 0.0, 0.0, 1.0);
        // Derivatives of x, y and yaw with respect to the travel of the left and the right wheel.
        let side = length / (2.0 * self.kinematics.track_m);
        let along_wheels = Matrix3x2::new(
            cos / 2.0 + side * sin,
            cos / 2.0 - side * sin,
            sin / 2.0 - side * cos,
            sin / 2.0 + side * cos,
            -1.0 / self.kinematics.track_m,
            1.0 / self.kinematics.track_m,
        );
        let [left, right] = travel_m.map(|travel| self.slip_m * travel.abs());
        let noise = Matrix2::new(left, 0.0, 0.0, right);
        self.covariance = along_yaw * self.covariance * along_yaw.transpose()
            + along_wheels * noise * along_wheels.transpose();
        self.pose = self.pose.compose(&step.integrate(1.0));
    }

    /// The current pose, `t_odom_base`.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        self.pose
    }

    /// The covariance of x, y (m²) and yaw (rad²) in `odom`.
    #[must_use]
    pub fn covariance(&self) -> Matrix3<f64> {
        self.covariance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DRIVE: Kinematics = Kinematics { track_m: 0.3 };

    proptest! {
        #[test]
        fn forward_kinematics_inverts_inverse_kinematics(
            v in -2.0..2.0,
            w in -5.0..5.0,
            track_m in 0.05..1.0,
        ) {
            let drive = Kinematics { track_m };
            let twist = drive.twist(drive.wheels(&Twist2 { linear_mps: v, angular_radps: w }));
            prop_assert!((twist.linear_mps - v).abs() < 1e-12);
            prop_assert!((twist.angular_radps - w).abs() < 1e-9);
        }

        #[test]
        fn many_small_steps_equal_one_large_step(left in -1.0..1.0, right in -1.0..1.0) {
            let mut fine = Odometry::new(DRIVE, 1e-4);
            (0..100).for_each(|_| fine.advance([left / 100.0, right / 100.0]));
            let whole = DRIVE.twist([left, right]).integrate(1.0);
            prop_assert!(fine.pose().distance_m(&whole) < 1e-9);
            let yaw_error_rad = hal::wrap_angle(fine.pose().yaw_rad - whole.yaw_rad);
            prop_assert!(yaw_error_rad.abs() < 1e-9);
        }
    }

    #[test]
    fn a_positive_yaw_rate_moves_the_right_wheel_forwards() {
        let [left, right] = DRIVE.wheels(&Twist2 { linear_mps: 0.0, angular_radps: 1.0 });
        assert!((left + 0.15).abs() < 1e-12 && (right - 0.15).abs() < 1e-12);
    }

    /// A linear congruential generator, so that every run simulates the same robots.
    fn uniform(state: &mut u64) -> f64 {
        *state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((*state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    #[test]
    fn the_covariance_matches_a_monte_carlo_simulation() {
        use std::f64::consts::TAU;
        let steps = 50;
        let travel = [0.02, 0.025];
        let slip_m = 4e-5;
        let mut odometry = Odometry::new(DRIVE, slip_m);
        (0..steps).for_each(|_| odometry.advance(travel));
        let mut state = 1u64;
        let robots = 4000;
        let mut sum = Matrix3::zeros();
        for _ in 0..robots {
            let mut robot = Odometry::new(DRIVE, 0.0);
            for _ in 0..steps {
                // Box-Muller transform: two uniform numbers give a normally distributed one.
                let radius = (-2.0 * uniform(&mut state).ln()).sqrt();
                let (sin, cos) = (TAU * uniform(&mut state)).sin_cos();
                let noise = [radius * sin, radius * cos];
                let noisy = [0, 1].map(|k| travel[k] + noise[k] * (slip_m * travel[k]).sqrt());
                robot.advance(noisy);
            }
            let mean = odometry.pose();
            let pose = robot.pose();
            let error = nalgebra::Vector3::new(
                pose.x_m - mean.x_m,
                pose.y_m - mean.y_m,
                hal::wrap_angle(pose.yaw_rad - mean.yaw_rad),
            );
            sum += error * error.transpose();
        }
        let sampled = sum / f64::from(robots);
        let predicted = odometry.covariance();
        for k in 0..3 {
            let ratio = sampled[(k, k)] / predicted[(k, k)];
            assert!((0.9..1.1).contains(&ratio), "axis {k}: sampled over predicted {ratio}");
        }
    }
}
