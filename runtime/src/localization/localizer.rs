//! Local and global pose together: what the robot's tick calls.

use hal::{LaserScan, Pose2, ScanGeometry, Twist2};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use crate::imu::ImuInput;
use crate::snapshot::{SnapshotError, State};

use super::driven_leg::DrivenLeg;
use super::global::{GlobalMap, Joined};
use super::gyro_model::GyroAngle;
use super::local::{LocalTracker, Tracked};
use super::lost::{Doubt, LostReason, Whereabouts};
use super::relocalizer::{Relocalizer, Wanted};
use super::slip::{Slip, WheelError};
use super::{LocalizationConfig, LocalizationError, ScanFit};

/// Where the robot is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Pose at the time of the update, in `odom`: smooth, never jumps. The first pose is the identity.
    pub t_odom_base: Pose2,
    /// Pose at the middle of the scan, in `odom`; `None` without a scan.
    pub t_odom_base_at_scan: Option<Pose2>,
    /// Velocity between the last two reports of wheels and gyroscope, without its part to the side.
    pub twist: Twist2,
    /// Covariance of `t_odom_base` against the scans of the last metres: x and y in the axes of `odom` (m²), yaw (rad²). The
    /// relative pose of two updates has the sum of their covariances, and the drift between their keyframes.
    pub covariance: Matrix3<f64>,
    /// Pose of `odom` in `map`: changes when a loop is closed.
    pub t_map_odom: Pose2,
    /// How well the scan fits; `None` without a scan.
    pub fit: Option<ScanFit>,
    /// The scan corrected the pose. False without a scan, and for a scan that does not fit.
    pub matched: bool,
    /// A loop was closed, or the robot was found, by this update: `t_map_odom` and the submaps in `map` have changed.
    pub closed: bool,
    /// Whether `t_map_odom` is known.
    pub whereabouts: Whereabouts,
    /// The wheels have begun to contradict the scans. The scans keep the pose.
    pub wheel_error: Option<WheelError>,
    /// The gyroscope has contradicted the scans so often that it is not used any more, since this update.
    pub gyro_refused: bool,
    /// The stretch of the drive that this update's scan ended, if it ended one.
    pub leg: Option<DrivenLeg>,
    /// The map in which the robot is has met another one: both are one since this update.
    pub joined: Option<Joined>,
}

impl Estimate {
    /// Pose at the time of the update, in `map`.
    #[must_use]
    pub fn t_map_base(&self) -> Pose2 {
        self.t_map_odom.compose(&self.t_odom_base)
    }
}

/// What localization has learnt of the gyroscope.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Gyroscope {
    /// The rate that it reports at rest, rad/s.
    pub bias_radps: f64,
    /// Share by which it reports a rotation too large.
    pub scale: f64,
    /// It contradicts the scans, and is not used any more.
    pub is_refused: bool,
}

/// Two submaps whose poses in each other were found by matching: a loop, or the place where a lost robot was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closure {
    /// Indices of both submaps, as of [`Localizer::submap_in_map`].
    pub from: usize,
    pub to: usize,
    /// Pose of the second submap in the first, as it was matched.
    pub t_from_to: Pose2,
    /// 1, or less if the closure does not agree well with the others.
    pub weight: f64,
}

/// Estimates the robot's pose. It keeps its memory: once its keyframes are full, it allocates only where a submap is added or
/// searched for.
pub struct Localizer {
    local: LocalTracker,
    global: GlobalMap,
    whereabouts: Whereabouts,
    doubt: Doubt,
    slip: Slip,
    relocalizer: Relocalizer,
    /// The robot is not searched for in other maps than its own. The caller says so before an update.
    stays_in_map: bool,
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
            global: GlobalMap::new(),
            whereabouts: Whereabouts::Localized,
            doubt: Doubt::default(),
            slip: Slip::default(),
            relocalizer: Relocalizer::new(t_base_laser),
            stays_in_map: false,
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
        self.update_with_imu(wheel, time_ns, scan, None)
    }

    /// As [`update`](Self::update), with the angles of a gyroscope at both times. Angles that are not finite are left out.
    pub fn update_with_imu(
        &mut self,
        wheel: &Pose2,
        time_ns: u64,
        scan: Option<(&LaserScan, &Pose2)>,
        imu: Option<&ImuInput>,
    ) -> Estimate {
        let imu = imu.filter(|imu| imu.is_finite());
        let gyro = imu.map(|imu| GyroAngle { time_ns, gaps: imu.gaps, yaw_rad: imu.yaw_rad });
        let beams = self.local.geometry().beams;
        let scan = scan.filter(|(scan, at)| scan.ranges.len() == beams && at.is_finite());
        if !wheel.is_finite() {
            return self.estimate();
        }
        self.local.measure_velocity(wheel, gyro, time_ns);
        let gyro_was_refused = self.local.gyro().is_refused();
        let mut tracked = None;
        let mut t_odom_base_at_scan = None;
        let mut wheel_error = None;
        if let Some((scan, wheel_at_scan)) = scan {
            let gyro_at_scan = imu.map(|imu| GyroAngle {
                time_ns: scan.middle_ns(),
                gaps: imu.gaps,
                yaw_rad: imu.yaw_at_scan_rad,
            });
            self.local.predict(wheel_at_scan, gyro_at_scan);
            let by_wheels = self.local.pose_by_wheels();
            let result = self.track(scan, wheel_at_scan);
            if result.matched {
                wheel_error = self.slip.observe(&by_wheels, &self.local.pose());
            }
            tracked = Some(result);
            t_odom_base_at_scan = Some(self.local.pose());
        }
        let leg = self.local.take_leg();
        self.local.predict(wheel, gyro);
        let revision = self.global.revision();
        let joined = self.work();
        Estimate {
            t_odom_base_at_scan,
            fit: tracked.map(|tracked| tracked.fit),
            matched: tracked.is_some_and(|tracked| tracked.matched),
            closed: self.global.revision() > revision,
            wheel_error,
            gyro_refused: self.local.gyro().is_refused() && !gyro_was_refused,
            leg,
            joined,
            ..self.estimate()
        }
    }

    fn track(&mut self, scan: &LaserScan, wheel: &Pose2) -> Tracked {
        let tracked = self.local.track(scan);
        let lost = self.doubt.observe(&tracked, wheel);
        let pose = self.local.pose();
        match self.whereabouts {
            // It was moved once more: what it has seen since it was lost was seen from another place.
            Whereabouts::Lost(why) if lost.is_some() => self.lose(why),
            Whereabouts::Lost(_) if !self.doubt.is_doubtful() => {
                let here = self.global.map();
                let maps = self.global.maps().filter(|map| *map == here || !self.stays_in_map);
                self.relocalizer.offer(self.local.stretches(), &pose, maps);
            }
            Whereabouts::Lost(_) => {}
            Whereabouts::Localized | Whereabouts::Doubtful => {
                if let Some(why) = lost {
                    self.lose(why);
                    return tracked;
                }
                let is_doubtful = self.doubt.is_doubtful();
                self.whereabouts =
                    if is_doubtful { Whereabouts::Doubtful } else { Whereabouts::Localized };
                if tracked.keyframe {
                    self.global.add(&pose, self.local.stretches(), self.local.covariance());
                }
                let may_meet = self.global.has_other_maps() && !self.stays_in_map;
                if may_meet && tracked.matched && !is_doubtful {
                    let here = self.global.map();
                    let others = self.global.maps().filter(|map| *map != here);
                    self.relocalizer.offer(self.local.stretches(), &pose, others);
                }
            }
        }
        tracked
    }

    /// The global pose's share of an update.
    fn work(&mut self) -> Option<Joined> {
        if self.whereabouts.lost().is_none() {
            return self.work_localized();
        }
        // The search needs a map that stays as it is.
        if self.global.settle_poses() {
            return None;
        }
        // A scan may have been searched for in other maps before the robot was to keep to its own.
        let found = self.relocalizer.work(&self.global.known());
        let here = self.global.map();
        if let Some(found) = found.filter(|found| found.map == here || !self.stays_in_map) {
            self.global.join(&self.local.pose(), &found, self.local.keyframes());
            self.relocalizer.begin(Wanted::Meeting);
            self.whereabouts = Whereabouts::Localized;
        }
        None
    }

    /// Closes loops; while there are none to close, searches for the robot in the other maps, if there are others.
    fn work_localized(&mut self) -> Option<Joined> {
        let was_busy = self.global.is_busy();
        let revision = self.global.revision();
        self.global.work();
        if self.global.revision() != revision {
            self.relocalizer.restart();
        }
        if was_busy || self.stays_in_map {
            return None;
        }
        let found = self.relocalizer.work(&self.global.known())?;
        self.relocalizer.begin(Wanted::Meeting);
        self.global.join_maps(&found)
    }

    /// Whether the robot keeps to its map: it is not searched for in others, and its map is not joined to them. This is no part of the
    /// memory.
    pub fn stay_in_map(&mut self, stays: bool) {
        self.stays_in_map = stays;
    }

    /// Whether a scan did not fit a moment ago.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        self.doubt.is_doubtful()
    }

    /// A lost robot gives up searching on the spot, and begins another map. While it drives, it is searched for in the maps before;
    /// when it is found there, both maps become one. Without a map before, and when it is not lost, nothing changes.
    pub fn begin_map(&mut self) {
        if self.whereabouts.lost().is_some() {
            self.global.begin_map(&self.local.pose(), self.local.keyframes());
            self.relocalizer.begin(Wanted::Meeting);
            self.whereabouts = Whereabouts::Localized;
        }
    }

    /// Number of the map that the robot is in: 0, until it has begun another one.
    #[must_use]
    pub fn map(&self) -> u16 {
        self.global.map()
    }

    /// Number of the map that a submap belongs to.
    #[must_use]
    pub fn map_of(&self, submap: usize) -> u16 {
        self.global.map_of(submap)
    }

    /// Number of maps whose places in each other are not known; 0 before the first scan.
    #[must_use]
    pub fn maps(&self) -> usize {
        self.global.maps().count()
    }

    /// Their numbers, in order.
    pub(crate) fn map_numbers(&self) -> impl Iterator<Item = u16> {
        self.global.maps()
    }

    /// The robot does not know where it is: it was started in a saved map, or the caller knows that it was carried. The map stays
    /// as it is, and the robot is searched for in all of it. Without a map there is nothing to search in, and nothing changes.
    pub fn lose(&mut self, why: LostReason) {
        self.doubt = Doubt::default();
        self.slip = Slip::default();
        self.local.forget_surroundings();
        if why == LostReason::Loaded {
            self.local.forget_wheel_odometry();
        }
        if !self.global.is_empty() {
            self.global.interrupt();
            self.relocalizer.begin(Wanted::Robot);
            self.whereabouts = Whereabouts::Lost(why);
        }
    }

    /// Ends a search without success: the wheels say where the robot is. This is for logs of robots that were not carried. A robot
    /// that may have been carried would draw one place over another.
    pub fn continue_by_wheels(&mut self) {
        if self.whereabouts.lost().is_some() {
            self.global.continue_at(&self.local.pose(), self.local.keyframes());
            self.relocalizer.begin(Wanted::Meeting);
            self.whereabouts = Whereabouts::Localized;
        }
    }

    /// Scans that were searched for since the robot was lost, or since it began another map.
    #[must_use]
    pub fn scans_searched(&self) -> u32 {
        self.relocalizer.searched()
    }

    /// Everything that it remembers, as bytes.
    #[must_use]
    pub fn snapshot(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        State::write(self, &mut bytes);
        self.write_gyro(&mut bytes);
        self.write_layout_14(&mut bytes);
        bytes
    }

    /// Restores what [`snapshot`](Self::snapshot) wrote. This localizer must have the same configuration and scanner.
    ///
    /// # Errors
    /// Bytes that are not those of a localizer. It must not be used then.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let mut from = snapshot;
        State::read(self, &mut from)?;
        self.read_gyro(&mut from)?;
        self.read_layout_14(&mut from)?;
        match from.len() {
            0 => Ok(()),
            more => Err(SnapshotError::Damaged(format!("{more} bytes are left over"))),
        }
    }

    /// The memory of the gyroscope, which is not part of a saved map.
    pub(crate) fn write_gyro(&self, to: &mut Vec<u8>) {
        self.local.write_gyro(to);
    }

    pub(crate) fn read_gyro(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.local.read_gyro(from)
    }

    /// What robots with several maps remember.
    pub(crate) fn write_layout_14(&self, to: &mut Vec<u8>) {
        self.global.write_layout_14(to);
        self.relocalizer.write_layout_14(to);
    }

    pub(crate) fn read_layout_14(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.global.read_layout_14(from)?;
        self.relocalizer.read_layout_14(from)
    }

    /// Does all the work on loop closures that updates have put off.
    pub fn settle(&mut self) {
        self.global.settle();
    }

    /// Index of the submap that is being made: submaps count up along the path.
    #[must_use]
    pub fn submap(&self) -> usize {
        self.global.current()
    }

    /// Pose of a submap in `map`, as corrected now. `None` before the first scan, and beyond the last submap.
    #[must_use]
    pub fn submap_in_map(&self, index: usize) -> Option<Pose2> {
        self.global.submap_in_map(index)
    }

    /// Pose of a submap in `odom`, which never changes.
    #[must_use]
    pub fn submap_in_odom(&self, index: usize) -> Option<Pose2> {
        self.global.submap_in_odom(index)
    }

    /// Counts the corrections of submaps in `map`.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.global.revision()
    }

    /// Whether loops are being searched for or closed, in the updates to come.
    #[must_use]
    pub fn is_closing(&self) -> bool {
        self.global.is_busy()
    }

    /// Counts the loop closures that were accepted.
    #[must_use]
    pub fn closures(&self) -> u64 {
        self.global.closed()
    }

    /// The closures that hold now. Closures that contradict the others are dropped, and are not among them.
    pub fn held_closures(&self) -> impl Iterator<Item = Closure> {
        self.global.closures().iter().map(|edge| Closure {
            from: edge.from as usize,
            to: edge.to as usize,
            t_from_to: edge.t_from_to,
            weight: edge.weight,
        })
    }

    /// The pose as it is now.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        Estimate {
            t_odom_base: self.local.pose(),
            t_odom_base_at_scan: None,
            twist: self.local.twist(),
            covariance: *self.local.covariance(),
            t_map_odom: self.global.t_map_odom(),
            fit: None,
            matched: false,
            closed: false,
            whereabouts: self.whereabouts,
            wheel_error: None,
            gyro_refused: false,
            leg: None,
            joined: None,
        }
    }

    /// What was learnt of the gyroscope. Zero until then.
    #[must_use]
    pub fn gyroscope(&self) -> Gyroscope {
        let [per_second, per_radian] = self.local.gyro().errors();
        Gyroscope {
            bias_radps: -per_second,
            scale: -per_radian,
            is_refused: self.local.gyro().is_refused(),
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
        self.global.write(to);
        self.whereabouts.write(to);
        self.doubt.write(to);
        self.slip.write(to);
        self.relocalizer.write(to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.local.restore(from)?;
        self.global.restore(from)?;
        self.whereabouts.read(from)?;
        self.doubt.read(from)?;
        self.slip.read(from)?;
        self.relocalizer.read(from)?;
        self.relocalizer.forget_layout_14();
        self.relocalizer.forget_cache();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_room::{TestRobot, around_the_ring, rectangle, round_trip};
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

    /// An LD06 or an RPLIDAR measures for a tenth of a second, clockwise, while the robot rotates by .04 rad.
    #[test]
    fn a_scanner_that_rotates_slowly_and_clockwise_sees_the_room_as_it_is() {
        let geometry = ScanGeometry::LD06;
        for seed in 0..4 {
            let mut robot = TestRobot::in_room(seed);
            robot.geometry = geometry;
            let poses = drive(&mut robot, 1200);
            let [metres, radians] = relative_errors(&poses, 7);
            // As if it rotated counter-clockwise: 5 mm and 3 mrad.
            assert!(metres < 0.003 && radians < 0.001, "seed {seed}: {metres} m, {radians} rad");
        }
    }

    #[test]
    fn with_a_gyroscope_the_yaw_between_frames_20_cm_apart_is_right_to_half_a_milliradian() {
        for seed in 0..4 {
            let mut robot = TestRobot::in_room(seed);
            robot.wheel_noise = [0.03, 0.05];
            let mut localizer = localizer(&robot);
            let mut poses = Vec::new();
            for (forward_m, yaw_rad) in round_trip(1200) {
                robot.step(forward_m, yaw_rad);
                let scan = robot.scan();
                let scan = Some((&scan, &robot.wheel));
                let imu = Some(&robot.imu());
                let estimate = localizer.update_with_imu(&robot.wheel, robot.time_ns, scan, imu);
                poses.push((robot.truth, estimate.t_odom_base));
            }
            // The bias is learnt in the first seconds.
            let [_, radians] = relative_errors(&poses[200..], 7);
            assert!(radians < 0.0005, "seed {seed}: {radians} rad");
            let learnt = localizer.gyroscope();
            assert!((learnt.bias_radps - 0.02).abs() < 0.001, "{learnt:?}");
            assert!((learnt.scale - 0.01).abs() < 0.005, "{learnt:?}");
        }
    }

    /// A unit that is mounted upside down, and is configured as if it were not.
    #[test]
    fn a_gyroscope_with_the_wrong_sign_is_found_out_and_the_scans_keep_the_pose() {
        let mut robot = TestRobot::in_room(8);
        let mut localizer = localizer(&robot);
        let mut poses = Vec::new();
        let mut refused = 0;
        for (forward_m, yaw_rad) in round_trip(2000) {
            robot.step(forward_m, yaw_rad);
            let scan = robot.scan();
            let scan = Some((&scan, &robot.wheel));
            let ImuInput { yaw_rad, yaw_at_scan_rad, .. } = robot.imu();
            let imu =
                ImuInput { yaw_rad: -yaw_rad, yaw_at_scan_rad: -yaw_at_scan_rad, ..robot.imu() };
            let estimate = localizer.update_with_imu(&robot.wheel, robot.time_ns, scan, Some(&imu));
            refused += usize::from(estimate.gyro_refused);
            poses.push((robot.truth, estimate.t_odom_base));
        }
        assert_eq!(refused, 1);
        let [metres, radians] = relative_errors(&poses, 7);
        assert!(metres < 0.01 && radians < 0.01, "{metres} m, {radians} rad");
    }

    /// A blind robot whose wheels report rotations that do not happen: 0.07 rad in each of 30 ticks, after it has driven for a while.
    #[test]
    fn wheels_that_spin_on_the_spot_do_not_rotate_a_robot_with_a_gyroscope() {
        let mut robot = TestRobot::in_room(3);
        let mut localizer = localizer(&robot);
        for (forward_m, yaw_rad) in round_trip(300) {
            robot.step(forward_m, yaw_rad);
            let scan = robot.scan();
            let scan = Some((&scan, &robot.wheel));
            localizer.update_with_imu(&robot.wheel, robot.time_ns, scan, Some(&robot.imu()));
        }
        let before = localizer.estimate().t_odom_base;
        for _ in 0..30 {
            robot.step(0.0, 0.0);
            robot.wheel = robot.wheel.compose(&Pose2::new(0.0, 0.0, 0.07));
            localizer.update_with_imu(&robot.wheel, robot.time_ns, None, Some(&robot.imu()));
        }
        let rotated = before.inverse().compose(&localizer.estimate().t_odom_base);
        assert!(rotated.yaw_rad.abs() < 0.01, "{rotated:?}");
        // Its scans say so as well: the wheels are named.
        let mut errors = Vec::new();
        for _ in 0..30 {
            robot.step(0.0, 0.0);
            robot.wheel = robot.wheel.compose(&Pose2::new(0.0, 0.0, 0.07));
            let scan = robot.scan();
            let scan = Some((&scan, &robot.wheel));
            let imu = Some(&robot.imu());
            let estimate = localizer.update_with_imu(&robot.wheel, robot.time_ns, scan, imu);
            errors.extend(estimate.wheel_error);
        }
        assert_eq!(errors, [WheelError::Spin]);
    }

    #[test]
    fn angles_that_are_missing_interrupted_or_not_finite_leave_the_pose_to_wheels_and_scans() {
        let mut robot = TestRobot::in_room(6);
        let mut localizer = localizer(&robot);
        let mut poses = Vec::new();
        for (step, (forward_m, yaw_rad)) in round_trip(600).enumerate() {
            robot.step(forward_m, yaw_rad);
            let scan = robot.scan();
            let scan = Some((&scan, &robot.wheel));
            let imu = match step % 100 {
                0..30 => Some(robot.imu()),
                30..40 => None,
                40..70 => Some(ImuInput { gaps: 1, yaw_rad: 5.0, ..robot.imu() }),
                _ => Some(ImuInput { yaw_rad: f64::NAN, ..robot.imu() }),
            };
            // An angle that stands still after an interruption, while the robot rotates, is a surprise.
            let imu = imu.map(|imu| match imu.gaps {
                0 => imu,
                _ => ImuInput { yaw_at_scan_rad: 5.0, ..imu },
            });
            let estimate =
                localizer.update_with_imu(&robot.wheel, robot.time_ns, scan, imu.as_ref());
            poses.push((robot.truth, estimate.t_odom_base));
        }
        let (first_truth, first) = poses[0];
        let (truth, pose) = poses[599];
        let expected = first_truth.inverse().compose(&truth);
        let error = expected.inverse().compose(&first.inverse().compose(&pose));
        assert!(error.x_m.hypot(error.y_m) < 0.05 && error.yaw_rad.abs() < 0.02, "{error:?}");
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
            let imu = Some(robot.imu());
            let time_ns = robot.time_ns;
            let estimate = first.update_with_imu(&robot.wheel, time_ns, input, imu.as_ref());
            if step > 150 {
                let again = second.update_with_imu(&robot.wheel, time_ns, input, imu.as_ref());
                assert_eq!(estimate, again, "step {step}");
            }
            if step == 150 {
                second.restore(&first.snapshot()).unwrap();
            }
        }
    }

    /// Drives through the ring corridor. Returns the largest error of a submap in `map`, metres.
    fn worst_submap(localizer: &Localizer, truths: &[Pose2]) -> f64 {
        let mut worst = 0.0_f64;
        for (index, truth) in truths.iter().enumerate() {
            let in_map = localizer.submap_in_map(index).unwrap();
            let expected = truths[0].inverse().compose(truth);
            let first = localizer.submap_in_map(0).unwrap();
            worst = worst.max(first.inverse().compose(&in_map).distance_m(&expected));
        }
        worst
    }

    #[test]
    fn after_a_round_the_loop_is_closed_and_every_submap_is_where_it_was() {
        let mut robot = TestRobot::in_ring(11);
        let mut localizer = localizer(&robot);
        let mut truths = Vec::new();
        let mut closed = 0;
        for (forward_m, yaw_rad) in around_the_ring(2) {
            robot.step(forward_m, yaw_rad);
            let before = localizer.revision();
            let estimate = update(&mut localizer, &mut robot);
            closed += usize::from(estimate.closed);
            assert_eq!(estimate.closed, localizer.revision() > before);
            if localizer.submap_in_map(truths.len()).is_some() {
                truths.push(robot.truth);
            }
            let index = localizer.submap();
            let [in_map, in_odom] =
                [localizer.submap_in_map(index), localizer.submap_in_odom(index)]
                    .map(Option::unwrap);
            let expected = in_map.compose(&in_odom.inverse());
            assert!(expected.distance_m(&estimate.t_map_odom) < 1e-9);
        }
        assert!(closed > 5, "{closed} corrections");
        let worst = worst_submap(&localizer, &truths);
        assert!(worst < 0.06, "{worst} m");
        let held: Vec<_> = localizer.held_closures().collect();
        assert!(!held.is_empty() && held.len() as u64 <= localizer.closures());
        for Closure { from, to, t_from_to, .. } in held {
            let truth = truths[from].inverse().compose(&truths[to]);
            assert!(truth.distance_m(&t_from_to) < 0.1, "{from} {to}: {truth:?} {t_from_to:?}");
        }
    }

    #[test]
    fn a_snapshot_in_the_middle_of_a_closure_goes_on_to_the_bit() {
        let mut robot = TestRobot::in_ring(3);
        let mut first = localizer(&robot);
        let mut second: Option<Localizer> = None;
        let mut compared = 0;
        for (forward_m, yaw_rad) in around_the_ring(2) {
            robot.step(forward_m, yaw_rad);
            let scan = robot.scan();
            let input = Some((&scan, &robot.wheel));
            let estimate = first.update(&robot.wheel, robot.time_ns, input);
            if let Some(second) = &mut second {
                assert_eq!(second.update(&robot.wheel, robot.time_ns, input), estimate);
                assert_eq!(second.submap_in_map(3), first.submap_in_map(3));
                compared += usize::from(estimate.closed);
            } else if first.global.is_searching() && first.closures() > 0 {
                let mut bytes = Vec::new();
                State::write(&first, &mut bytes);
                let mut restored = localizer(&robot);
                State::read(&mut restored, &mut bytes.as_slice()).unwrap();
                second = Some(restored);
            }
        }
        assert!(compared > 3, "{compared} closures after the snapshot");
    }

    #[test]
    fn scans_between_submaps_allocate_nothing() {
        let mut robot = TestRobot::in_room(5);
        let mut localizer = localizer(&robot);
        let mut counted = 0;
        for (step, (forward_m, yaw_rad)) in round_trip(900).enumerate() {
            robot.step(forward_m, yaw_rad);
            let scan = robot.scan();
            let input = Some((&scan, &robot.wheel));
            let submap = localizer.submap();
            let is_busy = localizer.global.is_busy();
            let allocations = allocation_counter::measure(|| {
                localizer.update(&robot.wheel, robot.time_ns, input);
            });
            let is_plain = !is_busy && !localizer.global.is_busy() && localizer.submap() == submap;
            if step > 450 && is_plain {
                assert_eq!(allocations.count_total, 0, "step {step}");
                counted += 1;
            }
        }
        assert!(counted > 200, "{counted}");
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
