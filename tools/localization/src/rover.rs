//! A simulated robot that follows given poses: its scanner rotates while it moves, and its wheels are those of an ordinary base.

use std::sync::Arc;

use anyhow::{Result, ensure};
use hal::{Clock, Imu, LaserScan, Lidar, Pose2, wrap_angle};
use runtime::imu::ImuHistory;
use runtime::localization::{Estimate, LocalizationConfig, Localizer};
use simulator::odometry::{Odometer, OdometryNoise};
use simulator::robot::{SimClock, SimImu, SimLidar};
use simulator::{RobotOptions, SimulatedRobot, World};

/// Time between two scans.
pub const STEP_NS: u64 = 100_000_000;

/// The robot, and what its sensors measured last.
pub struct Rover {
    robot: SimulatedRobot,
    lidar: SimLidar,
    imu: SimImu,
    rotation: ImuHistory,
    clock: SimClock,
    odometer: Odometer,
    /// Half the time of a scan, as a share of the time between two scans.
    half_scan: f64,
    t_base_laser: Pose2,
    truth: Pose2,
    scan: LaserScan,
    /// The wheels in the middle of the scan.
    wheel_at_scan: Pose2,
}

impl Rover {
    /// Stands at the start of `world`. `seed` gives the errors of its wheels and the noise of its scanner.
    ///
    /// # Errors
    /// A world without a place for the robot.
    pub fn new(world: &Arc<World>, seed: u64) -> Result<Self> {
        let options = RobotOptions { seed, ..RobotOptions::default() };
        let mount = options.t_base_laser.translation;
        let robot = SimulatedRobot::new(world.clone(), options)?;
        let devices = robot.devices();
        let geometry = devices.lidar.geometry();
        Ok(Self {
            robot,
            lidar: devices.lidar,
            imu: devices.imu,
            rotation: ImuHistory::default(),
            clock: devices.clock,
            odometer: Odometer::new(OdometryNoise::ORDINARY, seed),
            half_scan: 0.5 * geometry.period_ns as f64 / STEP_NS as f64,
            t_base_laser: Pose2::new(mount.x, mount.y, 0.0),
            truth: devices.truth.pose(),
            scan: LaserScan::empty(geometry),
            wheel_at_scan: Pose2::IDENTITY,
        })
    }

    /// Where it is in the world.
    pub fn truth(&self) -> Pose2 {
        self.truth
    }

    /// What its wheels report.
    pub fn wheel(&self) -> Pose2 {
        self.odometer.pose()
    }

    pub fn scan(&self) -> &LaserScan {
        &self.scan
    }

    pub fn t_base_laser(&self) -> Pose2 {
        self.t_base_laser
    }

    /// A localizer for this robot.
    ///
    /// # Errors
    /// A scanner that localization refuses.
    pub fn localizer(&self) -> Result<Localizer> {
        let config = LocalizationConfig::default();
        Ok(Localizer::new(&config, self.scan.geometry, self.t_base_laser)?)
    }

    /// Is lifted and put down at `truth`. Its wheels do not notice.
    pub fn put(&mut self, truth: Pose2) {
        self.robot.carry_to(truth);
        self.truth = truth;
    }

    /// Moves to `truth` until the next scan ends, and takes that scan.
    ///
    /// # Errors
    /// A pose where the robot does not fit.
    pub fn move_to(&mut self, truth: Pose2) -> Result<()> {
        let motion = self.truth.inverse().compose(&truth);
        let to_middle = part_of(&motion, 1.0 - self.half_scan);
        self.odometer.advance(&to_middle);
        self.wheel_at_scan = self.odometer.pose();
        self.odometer.advance(&to_middle.inverse().compose(&motion));
        self.truth = truth;
        self.clock.sleep_until_ns(self.clock.now_ns() + STEP_NS);
        ensure!(self.robot.push_by(&motion), "the robot does not fit at {truth:?}");
        self.lidar.poll_scan(&mut self.scan)?;
        while let Some(sample) = self.imu.poll_sample()? {
            self.rotation.push(&sample);
        }
        Ok(())
    }

    /// Gives the localizer what the sensors measured.
    pub fn update(&self, localizer: &mut Localizer) -> Estimate {
        let scan = Some((&self.scan, &self.wheel_at_scan));
        localizer.update(&self.wheel(), self.clock.now_ns(), scan)
    }

    /// The same for a robot with an inertial unit.
    pub fn update_with_imu(&self, localizer: &mut Localizer) -> Estimate {
        let now_ns = self.clock.now_ns();
        let scan = Some((&self.scan, &self.wheel_at_scan));
        let imu = self.rotation.at(now_ns, Some(self.scan.middle_ns()));
        localizer.update_with_imu(&self.wheel(), now_ns, scan, imu.as_ref())
    }
}

/// A part of a motion of centimetres or some degrees: its arc is as good as straight.
pub fn part_of(motion: &Pose2, share: f64) -> Pose2 {
    Pose2::new(share * motion.x_m, share * motion.y_m, share * wrap_angle(motion.yaw_rad))
}
