//! A robot in a built-in home with devices that may misbehave, in virtual time.

use std::error::Error;
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use drivers::fault::{
    Fault, FaultTextError, Faults, FaultyBase, FaultyCamera, FaultyClock, FaultyImu, FaultyLidar,
    random_faults,
};
use hal::{CameraModel, CameraMount, Clock, Pose2, RobotDescription, Twist2};
use runtime::exploration::PolicyKind;
use runtime::recording::RecordedTick;
use runtime::robot::{DepthSource, Robot, RobotConfig, SAFETY_HZ, Stage, StageTimer};
use runtime::safety::SentCommand;
use runtime::safety::{Request, SafetyConfig, SafetyLoop};
use runtime::session::{Observer, Session, VirtualDevices, VirtualTime, recompute, safety_link};
use runtime::tick::{Decision, TickInput};
use simulator::laser::LaserModel;
use simulator::robot::{SimBase, SimCamera, SimClock, SimLidar, Truth};
use simulator::{OpenOptions, RobotOptions, SimulatedRobot, World};

const SAFETY_NS: u64 = (1e9 / SAFETY_HZ) as u64;
/// Ticks after which a shadow starts again from a snapshot.
const SHADOW_TICKS: u64 = 7;

type Time = FaultyClock<VirtualTime<SimClock, FaultyBase<SimBase>, FaultyLidar<SimLidar>>>;
type Devices = VirtualDevices<Time, FaultyCamera<SimCamera>>;

/// A run in progress.
pub struct Scenario {
    session: Session<Devices>,
    simulated: SimulatedRobot,
    truth: Truth,
    observer: ScenarioObserver,
}

/// One tick as an observer of the robot sees it.
#[derive(Debug, Clone)]
pub struct Tick {
    /// The robot's decision.
    pub decision: Decision,
    /// Every command that the base received since the previous tick.
    pub sent: Vec<SentCommand>,
    /// True pose of the robot, `t_world_base`.
    pub pose: Pose2,
    /// Whether the robot touched an obstacle since the previous tick (ground truth).
    pub contact: bool,
}

impl Tick {
    /// The newest command that the base received before this tick.
    #[must_use]
    pub fn command(&self) -> Twist2 {
        self.decision.sent.map_or(Twist2::ZERO, Into::into)
    }
}

/// What differs between the robots of scenarios.
#[derive(Debug, Clone)]
pub struct Sensors {
    /// The home: `builtin:apartment?seed=1`.
    pub scene: String,
    pub laser: LaserModel,
    pub mount: CameraMount,
    pub camera: CameraModel,
    /// The depth that goes into the map.
    pub depth: DepthSource,
    /// Whether the robot has an inertial measurement unit.
    pub imu: bool,
}

impl Default for Sensors {
    /// The camera is small, because rendering takes most of the time of a scenario.
    fn default() -> Self {
        Self {
            scene: "builtin:apartment?seed=1".to_owned(),
            laser: LaserModel::UTM_30LX,
            mount: CameraMount::default(),
            camera: CameraModel::pinhole(160, 64, FRAC_PI_2),
            depth: DepthSource::Dense,
            imu: false,
        }
    }
}

impl Scenario {
    /// The default robot with a small camera in an apartment, with injected faults. The fault `random` is replaced by a minute of
    /// random faults.
    ///
    /// # Errors
    /// A text that is not a fault. A built-in home that cannot be opened or a default configuration that is refused is a defect
    /// of the project.
    pub fn new(policy: PolicyKind, faults: &[&str], seed: u64) -> Result<Self, Box<dyn Error>> {
        Self::with_sensors(policy, faults, seed, Sensors::default())
    }

    /// As [`new`](Self::new), with other sensors.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_sensors(
        policy: PolicyKind,
        faults: &[&str],
        seed: u64,
        sensors: Sensors,
    ) -> Result<Self, Box<dyn Error>> {
        let Sensors { scene, laser, mount, camera, depth, imu } = sensors;
        let world = World::open(&scene, &OpenOptions::default())?;
        let description = RobotDescription { camera: mount, ..RobotDescription::default() };
        let t_base_camera = mount.t_base_camera();
        let options =
            RobotOptions { camera, seed, laser, t_base_camera, ..RobotOptions::default() };
        let config = RobotConfig {
            depth_source: depth,
            ..RobotConfig::of(&description, camera, policy, seed)
        };
        let robot = Robot::new(config, None)?;
        let simulated = SimulatedRobot::new(Arc::new(world), options)?;
        let devices = simulated.devices();
        let clock = simulated.devices().clock;
        let faults = Faults::new(parse(faults, seed)?, seed, Arc::new(move || clock.now_ns()));
        let base = FaultyBase::new(devices.base, &faults);
        let lidar = FaultyLidar::new(devices.lidar, &faults);
        // As on a robot, the safety plane runs ten times in a tick; the default period is a whole tick.
        let safety = SafetyConfig { period_s: SAFETY_NS as f64 * 1e-9, ..SafetyConfig::default() };
        let (task, port) = safety_link(SafetyLoop::new(safety, base, lidar));
        let mut time = VirtualTime::new(devices.clock, task, SAFETY_NS);
        time.request(Request::Arm);
        let camera = FaultyCamera::new(devices.camera, &faults);
        let unit = FaultyImu::new(devices.imu, &faults);
        let mut devices = VirtualDevices::new(FaultyClock::new(time, &faults), camera);
        if imu {
            devices = devices.with_imu(unit);
        }
        let observer = ScenarioObserver { shadow: None, sent: Vec::new() };
        let session = Session::new(devices, robot, port, description.tick_ms * 1_000_000);
        let truth = simulated.devices().truth;
        Ok(Self { session, simulated, truth, observer })
    }

    /// Adds a second robot, the shadow, which decides every tick as well and starts again from a snapshot of the first
    /// one every few ticks.
    ///
    /// # Errors
    /// As [`successor`].
    pub fn shadowed(mut self) -> Result<Self, Box<dyn Error>> {
        self.observer.shadow = Some(successor(self.session.robot())?);
        Ok(self)
    }

    /// The robot, for reading its state.
    #[must_use]
    pub fn robot(&self) -> &Robot {
        self.session.robot()
    }

    /// The robot, for changes between two ticks.
    pub fn robot_mut(&mut self) -> &mut Robot {
        self.session.robot_mut()
    }

    /// Lifts the robot and puts it down at `t_world_base`.
    pub fn carry_to(&self, pose: Pose2) {
        self.simulated.carry_to(pose);
    }

    /// Passes an operator's request to the safety loop.
    pub fn request(&mut self, request: Request) {
        self.session.devices_mut().clock_mut().inner_mut().request(request);
    }

    /// Runs one tick of the loop.
    ///
    /// # Errors
    /// When the shadow decides otherwise, or the wheels have never reported.
    pub fn tick(&mut self) -> Result<Tick, Box<dyn Error>> {
        self.session.wait();
        let decision = self.session.tick(&mut self.observer)?;
        let decision = decision.ok_or("the wheels have not reported yet")?;
        let contact = self.truth.take_contact();
        let sent = std::mem::take(&mut self.observer.sent);
        Ok(Tick { decision, sent, pose: self.truth.pose(), contact })
    }

    /// Runs `count` ticks.
    ///
    /// # Errors
    /// As [`tick`](Self::tick).
    pub fn ticks(&mut self, count: usize) -> Result<Vec<Tick>, Box<dyn Error>> {
        (0..count).map(|_| self.tick()).collect()
    }
}

/// Compares the robot with its shadow and keeps the sent commands.
struct ScenarioObserver {
    shadow: Option<Robot>,
    sent: Vec<SentCommand>,
}

impl StageTimer for ScenarioObserver {
    fn ended(&mut self, _stage: Stage) {}
}

impl Observer for ScenarioObserver {
    type Error = Box<dyn Error>;

    fn before(&mut self, robot: &mut Robot, input: &TickInput<'_>) -> Result<(), Self::Error> {
        if self.shadow.is_some() && input.tick.is_multiple_of(SHADOW_TICKS) {
            self.shadow = Some(successor(robot)?);
        }
        Ok(())
    }

    fn after(
        &mut self,
        _robot: &mut Robot,
        input: &TickInput<'_>,
        decision: &Decision,
    ) -> Result<(), Self::Error> {
        self.sent.extend_from_slice(&input.safety.sent);
        let Some(shadow) = &mut self.shadow else { return Ok(()) };
        let other = recompute(shadow, &RecordedTick::capture(input, None)?)?;
        if other == *decision {
            return Ok(());
        }
        let tick = input.tick;
        Err(format!("from its snapshot, tick {tick} is {other:?}, not {decision:?}").into())
    }
}

/// A new robot of the same configuration, with this one's memory.
///
/// # Errors
/// A snapshot that is refused: a defect.
pub fn successor(robot: &Robot) -> Result<Robot, Box<dyn Error>> {
    let mut new = Robot::new(robot.config().clone(), None)?;
    new.restore(&robot.snapshot())?;
    Ok(new)
}

fn parse(texts: &[&str], seed: u64) -> Result<Vec<Fault>, FaultTextError> {
    let mut faults = Vec::new();
    for text in texts {
        match *text {
            "random" => faults.extend(random_faults(seed, 60.0)),
            text => faults.push(text.parse()?),
        }
    }
    Ok(faults)
}
