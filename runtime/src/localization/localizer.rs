//! Local and global pose together: what the robot's tick calls.

use hal::{LaserScan, Pose2, ScanGeometry};
use nalgebra::Matrix3;

use crate::snapshot::{SnapshotError, State};

use super::local::LocalTracker;
use super::{LocalizationConfig, LocalizationError, ScanFit};

/// Where the robot is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Pose at the time of the update, in `odom`: smooth, never jumps. The first pose is the identity.
    pub t_odom_base: Pose2,
    /// Pose at the middle of the scan, in `odom`; `None` without a scan.
    pub t_odom_base_at_scan: Option<Pose2>,
    /// Covariance of `t_odom_base` against the scans of the last metres: x and y in the axes of `odom` (m²), yaw (rad²). The
    /// relative pose of two updates has the sum of their covariances, and the drift between their keyframes.
    pub covariance: Matrix3<f64>,
    /// Pose of `odom` in `map`: changes when a loop is closed.
    pub t_map_odom: Pose2,
    /// How well the scan fits; `None` without a scan.
    pub fit: Option<ScanFit>,
    /// The scan corrected the pose. False without a scan, and for a scan that does not fit.
    pub matched: bool,
}

impl Estimate {
    /// Pose at the time of the update, in `map`.
    #[must_use]
    pub fn t_map_base(&self) -> Pose2 {
        self.t_map_odom.compose(&self.t_odom_base)
    }
}

/// Estimates the robot's pose. It keeps its memory, and allocates nothing once its keyframes are full.
pub struct Localizer {
    local: LocalTracker,
    t_map_odom: Pose2,
}

impl Localizer {
    /// A robot that has not moved and seen nothing yet, with its scanner mounted at `t_base_laser`.
    ///
    /// # Errors
    /// A configuration that is out of range, a scanner with too few beams, or a mount that is not finite.
    pub fn new(
        config: &LocalizationConfig,
        geometry: ScanGeometry,
        t_base_laser: Pose2,
    ) -> Result<Self, LocalizationError> {
        config.validate()?;
        let ScanGeometry { beams, angle_increment_rad: increment_rad, .. } = geometry;
        let is_usable = (8..=100_000).contains(&beams)
            && increment_rad.abs() > 0.0
            && increment_rad.abs() < 0.2
            && geometry.angle_min_rad.is_finite();
        if !is_usable {
            return Err(LocalizationError::Scanner { beams, increment_rad });
        }
        if !t_base_laser.is_finite() {
            return Err(LocalizationError::Mount { value: format!("{t_base_laser:?}") });
        }
        Ok(Self {
            local: LocalTracker::new(config, geometry, t_base_laser),
            t_map_odom: Pose2::IDENTITY,
        })
    }

    /// Takes wheel odometry at `time_ns`, and at most one scan with the wheel odometry at the middle of the scan.
    ///
    /// The scan may be a little older or newer than `time_ns`. A scan of another shape than the scanner's, and odometry that is
    /// not finite, are left out: the caller checks and reports them.
    pub fn update(
        &mut self,
        wheel: &Pose2,
        time_ns: u64,
        scan: Option<(&LaserScan, &Pose2)>,
    ) -> Estimate {
        let beams = self.local.geometry().beams;
        let scan = scan.filter(|(scan, at)| scan.ranges.len() == beams && at.is_finite());
        if !wheel.is_finite() {
            return self.estimate();
        }
        self.local.measure_velocity(wheel, time_ns);
        let mut tracked = None;
        let mut t_odom_base_at_scan = None;
        if let Some((scan, wheel_at_scan)) = scan {
            self.local.predict(wheel_at_scan);
            tracked = Some(self.local.track(scan));
            t_odom_base_at_scan = Some(self.local.pose());
        }
        self.local.predict(wheel);
        Estimate {
            t_odom_base_at_scan,
            fit: tracked.map(|tracked| tracked.fit),
            matched: tracked.is_some_and(|tracked| tracked.matched),
            ..self.estimate()
        }
    }

    /// The pose as it is now.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        Estimate {
            t_odom_base: self.local.pose(),
            t_odom_base_at_scan: None,
            covariance: *self.local.covariance(),
            t_map_odom: self.t_map_odom,
            fit: None,
            matched: false,
        }
    }

    /// What the wheels do not report: radians per metre, radians per radian, metres per metre.
    #[must_use]
    pub fn wheel_errors(&self) -> [f64; 3] {
        self.local.wheel().errors()
    }
}

impl State for Localizer {
    fn write(&self, to: &mut Vec<u8>) {
        self.local.write(to);
        self.t_map_odom.write(to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.local.restore(from)?;
        self.t_map_odom.read(from)
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_room::{TestRobot, rectangle, round_trip};
    use super::*;
    use hal::wrap_angle;

    fn localizer(robot: &TestRobot) -> Localizer {
        let config = LocalizationConfig::default();
        Localizer::new(&config, robot.geometry, Pose2::IDENTITY).unwrap()
    }

    fn update(localizer: &mut Localizer, robot: &mut TestRobot) -> Estimate {
        let scan = robot.scan();
        localizer.update(&robot.wheel, robot.time_ns, Some((&scan, &robot.wheel)))
    }

    /// Root mean squares of the errors of position (m) and yaw (rad) between updates `gap` steps apart.
    fn relative_errors(poses: &[(Pose2, Pose2)], gap: usize) -> [f64; 2] {
        let mut squares = [0.0; 2];
        for ((truth, pose), (next_truth, next)) in poses.iter().zip(&poses[gap..]) {
            let expected = truth.inverse().compose(next_truth);
            let error = expected.inverse().compose(&pose.inverse().compose(next));
            squares[0] += error.x_m * error.x_m + error.y_m * error.y_m;
            squares[1] += error.yaw_rad * error.yaw_rad;
        }
        squares.map(|sum| (sum / (poses.len() - gap) as f64).sqrt())
    }

    fn drive(robot: &mut TestRobot, steps: usize) -> Vec<(Pose2, Pose2)> {
        let mut localizer = localizer(robot);
        let poses = round_trip(steps).map(|(forward_m, yaw_rad)| {
            robot.step(forward_m, yaw_rad);
            let estimate = update(&mut localizer, robot);
            (robot.truth, estimate.t_odom_base)
        });
        poses.collect()
    }

    #[test]
    fn between_frames_20_cm_apart_the_pose_is_right_to_2_mm_and_1_mrad() {
        for seed in 0..4 {
            let mut robot = TestRobot::in_room(seed);
            robot.drift_rad_per_m = if seed % 2 == 0 { 0.03 } else { -0.06 };
            let poses = drive(&mut robot, 1200);
            let [metres, radians] = relative_errors(&poses, 7);
            assert!(metres < 0.002 && radians < 0.001, "seed {seed}: {metres} m, {radians} rad");
        }
    }

    #[test]
    fn after_40_metres_in_one_room_the_pose_is_right_to_3_cm() {
        let mut robot = TestRobot::in_room(7);
        let poses = drive(&mut robot, 2000);
        let (first_truth, first) = poses[0];
        let (truth, pose) = poses[1999];
        let expected = first_truth.inverse().compose(&truth);
        let error = expected.inverse().compose(&first.inverse().compose(&pose));
        let metres = error.x_m.hypot(error.y_m);
        assert!(metres < 0.03 && error.yaw_rad.abs() < 0.01, "{error:?}");
    }

    #[test]
    fn in_a_corridor_the_wheels_carry_the_pose_along_and_the_walls_across() {
        let walls = rectangle([-100.0, -0.9], [100.0, 0.9]).to_vec();
        let mut robot = TestRobot::new(walls, 3);
        let mut localizer = localizer(&robot);
        let mut estimate = localizer.estimate();
        for _ in 0..500 {
            robot.step(0.03, 0.0);
            estimate = update(&mut localizer, &mut robot);
        }
        let error = estimate.t_odom_base.inverse().compose(&robot.truth);
        assert!(error.x_m.abs() < 0.1, "along: {error:?}");
        assert!(error.y_m.abs() < 0.01 && error.yaw_rad.abs() < 0.005, "across: {error:?}");
        let [along, across] = [(0, 0), (1, 1)].map(|at| estimate.covariance[at].sqrt());
        assert!(along > 5.0 * across, "{along} {across}");
    }

    #[test]
    fn a_second_localizer_goes_on_from_a_snapshot_to_the_bit() {
        let mut robot = TestRobot::in_room(5);
        let mut first = localizer(&robot);
        let mut second = localizer(&robot);
        for (step, (forward_m, yaw_rad)) in round_trip(300).enumerate() {
            robot.step(forward_m, yaw_rad);
            let scan = robot.scan();
            let input = Some((&scan, &robot.wheel));
            let estimate = first.update(&robot.wheel, robot.time_ns, input);
            if step > 150 {
                let again = second.update(&robot.wheel, robot.time_ns, input);
                assert_eq!(estimate, again, "step {step}");
            }
            if step == 150 {
                let mut bytes = Vec::new();
                State::write(&first, &mut bytes);
                let mut from = bytes.as_slice();
                State::read(&mut second, &mut from).unwrap();
                assert!(from.is_empty());
            }
        }
    }

    #[test]
    fn a_scan_of_another_shape_and_odometry_that_is_not_finite_change_nothing() {
        let mut robot = TestRobot::in_room(5);
        let mut localizer = localizer(&robot);
        for _ in 0..5 {
            robot.step(0.03, 0.0);
            update(&mut localizer, &mut robot);
        }
        let before = localizer.estimate();
        let mut scan = robot.scan();
        scan.ranges.pop();
        let input = Some((&scan, &robot.wheel));
        let after = localizer.update(&robot.wheel, robot.time_ns, input);
        assert!(after.t_odom_base_at_scan.is_none());
        assert!(wrap_angle(after.t_odom_base.yaw_rad - before.t_odom_base.yaw_rad).abs() < 1e-12);
        let nan = Pose2 { x_m: f64::NAN, ..robot.wheel };
        assert_eq!(localizer.update(&nan, robot.time_ns, None), localizer.estimate());
    }
}
