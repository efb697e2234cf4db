//! A robot in a built-in home with devices that may misbehave, in virtual time.

use std::sync::Arc;

use drivers::fault::{
    Fault, Faults, FaultyBase, FaultyCamera, FaultyClock, FaultyLidar, random_faults,
};
use hal::{
    Base, Camera, CameraModel, Clock, DriveCommand, Error, Frame, LaserScan, Lidar, Pose2, Twist2,
    WheelFeedback,
};
use runtime::exploration::{ExplorationConfig, PolicyKind};
use runtime::mapping::MapConfig;
use runtime::perception::CoarseConfig;
use runtime::planning::{FollowerConfig, PlanConfig};
use runtime::robot::{DepthSource, Robot, RobotConfig};
use runtime::safety::SafetyConfig;
use runtime::tick::{Decision, TickInput};
use simulator::robot::{SimBase, SimCamera, SimClock, SimLidar, Truth};
use simulator::{OpenOptions, RobotOptions, SimulatedRobot, World};

const TICK_NS: u64 = 100_000_000;
/// A shadow begins anew after so many turns.
const SHADOW_TURNS: u64 = 7;

/// A run in progress.
pub struct Scenario {
    camera: FaultyCamera<SimCamera>,
    lidar: FaultyLidar<SimLidar>,
    base: FaultyBase<SimBase>,
    clock: FaultyClock<SimClock>,
    truth: Truth,
    robot: Robot,
    /// Decides the same turns, and begins anew from a snapshot now and then.
    shadow: Option<Robot>,
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
    /// A robot with a small camera in an apartment, and what is wrong with its devices; `random` stands for a minute's faults
    /// by dice.
    ///
    /// # Errors
    /// A text that names no fault. When a built-in home cannot be opened or a default configuration is refused: a defect of
    /// the project.
    pub fn new(
        policy: PolicyKind,
        faults: &[&str],
        seed: u64,
    ) -> Result<Self, Box<dyn std::error::Error>> {
        let world = World::open("builtin:apartment?seed=1", &OpenOptions::default())?;
        let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
        let options = RobotOptions { camera, seed, ..RobotOptions::default() };
        let t_base_camera = options.t_base_camera;
        let simulated = SimulatedRobot::new(Arc::new(world), options)?;
        let (devices, clock) = (simulated.devices(), simulated.devices().clock);
        let faults = Faults::new(read(faults, seed)?, seed, Arc::new(move || clock.now_ns()));
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
            camera: FaultyCamera::new(devices.camera, &faults),
            lidar: FaultyLidar::new(devices.lidar, &faults),
            base: FaultyBase::new(devices.base, &faults),
            clock: FaultyClock::new(devices.clock, &faults),
            truth: devices.truth,
            robot: Robot::new(config, None)?,
            shadow: None,
            frame: Frame::empty(),
            wheel: WheelFeedback::default(),
            tick: 0,
        })
    }

    /// From now on every turn is also decided by a robot that knew nothing but a snapshot of this one some turns ago.
    ///
    /// # Errors
    /// As [`successor`].
    pub fn shadowed(self) -> Result<Self, Box<dyn std::error::Error>> {
        Ok(Self { shadow: Some(successor(&self.robot)?), ..self })
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// One turn of the loop, as `firmware-host` does it.
    ///
    /// # Errors
    /// When the shadow decides otherwise, when a frame is not what it says, or a command is refused.
    pub fn turn(&mut self) -> Result<Turn, Box<dyn std::error::Error>> {
        self.clock.sleep_until_ns(self.tick * TICK_NS);
        let time_ns = self.clock.now_ns();
        // An error is no reading, and never a reason to keep the last one.
        let has_frame = self.camera.poll_frame(&mut self.frame).unwrap_or(false);
        let has_scan = self.lidar.poll_scan(&mut self.scan).unwrap_or(false);
        if let Ok(Some(wheel)) = self.base.poll_feedback() {
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
        if self.shadow.is_some() && self.tick.is_multiple_of(SHADOW_TURNS) {
            self.shadow = Some(successor(&self.robot)?);
        }
        let decision = self.robot.tick(&input, &mut ());
        if let Some(other) = self
            .shadow
            .as_mut()
            .map(|shadow| shadow.tick(&input, &mut ()))
            .filter(|other| *other != decision)
        {
            return Err(format!(
                "from its snapshot, turn {} is {other:?}, not {decision:?}",
                self.tick
            )
            .into());
        }
        let command = DriveCommand {
            twist: decision.command.into(),
            counter: self.tick as u32 + 1,
            plan_age_ns: 0,
        };
        // A base that cannot be reached stops by its own watchdog; one that refuses to be driven was asked for nonsense.
        if let Err(error) = self.base.drive(&command)
            && error.kind() == hal::ErrorKind::Rejected
        {
            return Err(error.to_string().into());
        }
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

/// A new robot of the same configuration that knows what this one knows.
///
/// # Errors
/// A snapshot that cannot be taken up: a defect.
pub fn successor(robot: &Robot) -> Result<Robot, Box<dyn std::error::Error>> {
    let mut new = Robot::new(robot.config().clone(), None)?;
    new.restore(&robot.snapshot())?;
    Ok(new)
}

fn read(texts: &[&str], seed: u64) -> Result<Vec<Fault>, drivers::fault::FaultTextError> {
    let mut faults = Vec::new();
    for text in texts {
        match *text {
            "random" => faults.extend(random_faults(seed, 60.0)),
            text => faults.push(text.parse()?),
        }
    }
    Ok(faults)
}
