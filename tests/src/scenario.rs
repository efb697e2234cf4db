//! A robot in a built-in home with devices that may misbehave, in virtual time.

use std::sync::Arc;

use hal::{Base, Camera, CameraModel, Clock, DriveCommand, Frame, LaserScan, Lidar, Pose2, Twist2, WheelFeedback};
use runtime::exploration::{ExplorationConfig, PolicyKind};
use runtime::mapping::MapConfig;
use runtime::perception::CoarseConfig;
use runtime::planning::{FollowerConfig, PlanConfig};
use runtime::robot::{DepthSource, Robot, RobotConfig};
use runtime::safety::SafetyConfig;
use runtime::tick::{Decision, TickInput};
use simulator::robot::{SimBase, SimCamera, SimClock, SimLidar, Truth};
use simulator::{OpenOptions, RobotOptions, SimulatedRobot, World};

use crate::{BaseFaults, CameraFaults, FaultyBase, FaultyCamera, FaultyLidar, LidarFaults};

const TICK_NS: u64 = 100_000_000;

/// What is wrong with the devices.
#[derive(Debug, Clone, Default)]
pub struct Faults {
    /// The scanner.
    pub lidar: LidarFaults,
    /// The camera.
    pub camera: CameraFaults,
    /// The wheels.
    pub base: BaseFaults,
}

/// A run in progress.
pub struct Scenario {
    camera: FaultyCamera<SimCamera>,
    lidar: FaultyLidar<SimLidar>,
    base: FaultyBase<SimBase>,
    clock: SimClock,
    truth: Truth,
    robot: Robot,
    frame: Frame,
    scan: LaserScan,
    wheel: WheelFeedback,
    tick: u64,
}

/// One turn as seen from outside.
#[derive(Debug, Clone)]
pub struct Turn {
    /// What the robot decided.
    pub decision: Decision,
    /// Where it really is.
    pub pose: Pose2,
    /// Whether it really touches something.
    pub contact: bool,
}

impl Turn {
    /// The command that went to the base.
    #[must_use]
    pub fn command(&self) -> Twist2 {
        self.decision.command.into()
    }
}

impl Scenario {
    /// A robot with a small camera in an apartment.
    ///
    /// # Errors
    /// When a built-in home cannot be opened or a default configuration is refused: a defect of the project.
    pub fn new(policy: PolicyKind, faults: Faults, seed: u64) -> Result<Self, Box<dyn std::error::Error>> {
        let world = World::open("builtin:apartment?seed=1", &OpenOptions::default())?;
        let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
        let options = RobotOptions { camera, seed, ..RobotOptions::default() };
        let t_base_camera = options.t_base_camera;
        let devices = SimulatedRobot::new(Arc::new(world), options)?.devices();
        let config = RobotConfig {
            camera,
            t_base_camera,
            laser_forward_m: 0.0,
            forward_step_m: 0.03,
            turn_step_rad: 2f64.to_radians(),
            tick_s: TICK_NS as f64 * 1e-9,
            policy,
            seed,
            depth_source: DepthSource::Coarse,
            coarse: CoarseConfig::default(),
            map: MapConfig::default(),
            plan: PlanConfig { footprint_radius_m: 0.16, ..PlanConfig::default() },
            follower: FollowerConfig::default(),
            exploration: ExplorationConfig::default(),
            safety: SafetyConfig::default(),
            stand_without_pictures: None,
        };
        Ok(Self {
            scan: LaserScan::empty(devices.lidar.geometry()),
            camera: FaultyCamera::new(devices.camera, faults.camera, seed),
            lidar: FaultyLidar::new(devices.lidar, faults.lidar, seed),
            base: FaultyBase::new(devices.base, faults.base),
            clock: devices.clock,
            truth: devices.truth,
            robot: Robot::new(config, None)?,
            frame: Frame::empty(),
            wheel: WheelFeedback::default(),
            tick: 0,
        })
    }

    /// One turn of the loop, as `firmware-host` does it.
    ///
    /// # Errors
    /// When a device or a frame is refused.
    pub fn turn(&mut self) -> Result<Turn, Box<dyn std::error::Error>> {
        let time_ns = self.tick * TICK_NS;
        self.clock.sleep_until_ns(time_ns);
        let has_frame = self.camera.poll_frame(&mut self.frame)?;
        let has_scan = self.lidar.poll_scan(&mut self.scan)?;
        if let Some(wheel) = self.base.poll_feedback()? {
            self.wheel = wheel;
        }
        let contact = self.truth.contact();
        let input = TickInput {
            tick: self.tick,
            time_ns,
            wheel: self.wheel,
            scan: has_scan.then_some(&self.scan),
            frame: if has_frame { Some(self.frame.view()?) } else { None },
            truth: None,
            safety: None,
        };
        let decision = self.robot.tick(&input, &mut ());
        let command = DriveCommand { twist: decision.command.into(), counter: self.tick as u32 + 1, plan_age_ns: 0 };
        self.base.drive(&command)?;
        self.tick += 1;
        Ok(Turn { decision, pose: self.truth.pose(), contact })
    }

    /// Many turns.
    ///
    /// # Errors
    /// As [`turn`](Self::turn).
    pub fn turns(&mut self, count: usize) -> Result<Vec<Turn>, Box<dyn std::error::Error>> {
        (0..count).map(|_| self.turn()).collect()
    }
}
