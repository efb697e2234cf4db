//! Sequences of frames with ground-truth depth and poses, in memory.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use firmware_host::config::{Config, Odometry};
use firmware_host::dataset::Dataset;
use firmware_host::setup::Mission;
use firmware_host::simulation;
use hal::{
    Base, Camera, CameraModel, DepthMap, DriveCommand, ErrorType, LaserScan, Pose2, Pose3, Twist2,
    WheelFeedback,
};
use runtime::exploration::PolicyKind;
use runtime::perception::Moment;
use runtime::robot::{DepthSource, Robot, Stage, StageTimer};
use runtime::safety::{Request, SafetyLoop};
use runtime::session::{Observer, Session, VirtualDevices, VirtualTime, safety_link};
use runtime::tick::{Decision, TickInput};
use simulator::robot::Truth;
use simulator::{SimulatedRobot, World};

/// One frame with its ground truth.
pub struct View {
    /// The image, RGB8, row-major.
    pub rgb: Vec<u8>,
    /// Ground-truth z-depth, metres; 0 where unknown.
    pub truth: Option<DepthMap>,
    /// Ground truth of `t_odom_camera`.
    pub t_odom_camera: Pose3,
    /// The scan of the frame's tick and `t_odom_laser` when it was taken.
    pub scan: Option<(LaserScan, Pose2)>,
    /// Where and when the frame was taken, for dense depth.
    pub moment: Moment,
}

/// Frames in the order in which they were taken.
pub struct Sequence {
    /// Scene and motion of the camera.
    pub name: String,
    /// Camera model of all frames.
    pub camera: CameraModel,
    /// Pose of the camera on a robot that stands on a floor; `None` for a handheld camera.
    pub mount: Option<Pose3>,
    /// The frames in the order of time.
    pub views: Vec<View>,
}

/// How a simulated camera moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// A robot drives with this policy and ground-truth depth in its map.
    Policy(PolicyKind),
    /// The robot rotates to the left on the spot, so that there is no parallax.
    Rotation,
}

impl Motion {
    /// The motions of the table.
    pub const ALL: [Self; 5] = [
        Self::Policy(PolicyKind::Forward),
        Self::Policy(PolicyKind::Heuristic),
        Self::Policy(PolicyKind::Random),
        Self::Policy(PolicyKind::Active),
        Self::Rotation,
    ];

    /// Its name in the table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Policy(PolicyKind::Heuristic) => "turning",
            Self::Policy(policy) => policy.name(),
            Self::Rotation => "rotation",
        }
    }

    /// The twist that replaces every command.
    fn instead(self, config: &Config) -> Option<Twist2> {
        let angular_radps = config.base.turn_step_deg.to_radians() / config.base.tick_s();
        (self == Self::Rotation).then_some(Twist2 { linear_mps: 0.0, angular_radps })
    }
}

/// `frames` frames of a robot with this configuration that drives through `world`.
///
/// # Errors
/// When the robot or its devices fail.
pub fn simulated(
    world: &Arc<World>,
    motion: Motion,
    frames: u64,
    seed: u64,
    config: &Config,
) -> Result<Sequence> {
    let mut config = config.clone();
    // The pose of a view is the true pose of its exposure.
    config.simulator.odometry = Odometry::Perfect;
    let options = simulation::simulated_robot(&config, seed, None);
    let simulated = SimulatedRobot::new(Arc::clone(world), options)?;
    let policy = match motion {
        Motion::Policy(policy) => policy,
        Motion::Rotation => PolicyKind::Random,
    };
    let mission = Mission { policy, depth_source: DepthSource::Truth, seed };
    let robot = Robot::new(config.robot(&mission), None)?;
    let devices = simulated.devices();
    let camera = *devices.camera.model();
    let base = MovedBase { base: devices.base, instead: motion.instead(&config) };
    let safety = SafetyLoop::new(config.simulated_safety_config(), base, devices.lidar);
    let (task, port) = safety_link(safety);
    let mut time = VirtualTime::new(devices.clock, task, config.safety_period_ns());
    time.request(Request::Arm);
    // Ground truth is mapped: the sequence must not depend on the depth that is measured on it.
    let truth = simulated.devices().truth;
    let devices = VirtualDevices::new(time, devices.camera)
        .with_ground_truth(move |depth| truth.depth(depth));
    let truth = simulated.devices().truth;
    let mut views = Views {
        views: Vec::new(),
        truth,
        mount: config.camera.t_base_camera(),
        t_base_laser: config.lidar.mount().t_base_laser(),
    };
    let mut session = Session::new(devices, robot, port, config.base.tick_ns());
    for _ in 0..frames {
        session.wait();
        session.tick(&mut views)?;
    }
    let name = format!("{}, {}", short(world.name()), motion.name());
    Ok(Sequence { name, camera, mount: Some(config.camera.t_base_camera()), views: views.views })
}

/// A base that drives another twist than the commanded one.
struct MovedBase<B> {
    base: B,
    /// The twist that it drives instead of the command; `None` to follow the command.
    instead: Option<Twist2>,
}

impl<B: ErrorType> ErrorType for MovedBase<B> {
    type Error = B::Error;
}

impl<B: Base> Base for MovedBase<B> {
    fn drive(&mut self, command: &DriveCommand) -> Result<(), B::Error> {
        let twist = self.instead.unwrap_or(command.twist);
        self.base.drive(&DriveCommand { twist, ..*command })
    }

    fn stop(&mut self) -> Result<(), B::Error> {
        self.base.stop()
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, B::Error> {
        self.base.poll_feedback()
    }
}

/// Keeps every frame with its true depth and pose.
struct Views {
    views: Vec<View>,
    truth: Truth,
    mount: Pose3,
    t_base_laser: Pose2,
}

impl StageTimer for Views {
    fn ended(&mut self, _stage: Stage) {}
}

impl Observer for Views {
    type Error = anyhow::Error;

    fn before(&mut self, _robot: &mut Robot, _input: &TickInput<'_>) -> Result<()> {
        Ok(())
    }

    fn after(
        &mut self,
        _robot: &mut Robot,
        input: &TickInput<'_>,
        _decision: &Decision,
    ) -> Result<()> {
        let Some(frame) = &input.frame else { return Ok(()) };
        let t_world_base = self.truth.pose();
        let t_world_laser =
            self.truth.t_world_odom().compose(&input.scan_odom).compose(&self.t_base_laser);
        self.views.push(View {
            rgb: frame.data().to_vec(),
            truth: input.truth.cloned(),
            t_odom_camera: t_world_base.to_pose3() * self.mount,
            scan: input.scan.map(|scan| (scan.clone(), t_world_laser)),
            moment: Moment {
                time_ns: input.wheel.time_ns,
                t_odom_base: t_world_base,
                ..Moment::HANDHELD
            },
        });
        Ok(())
    }
}

/// Every frame of a recorded sequence.
///
/// # Errors
/// When it cannot be read.
pub fn recorded(folder: &Path) -> Result<Sequence> {
    let config = Config::default();
    let dataset = Dataset::open(folder, config.camera.width, config.camera.height)?;
    let views = dataset.samples().map(|sample| {
        let sample = sample?;
        Ok(View {
            rgb: sample.rgb,
            truth: sample.truth,
            t_odom_camera: sample.t_world_camera,
            scan: None,
            moment: Moment::HANDHELD,
        })
    });
    let views = views.collect::<Result<Vec<_>>>();
    let name = folder.file_name().context("a dataset needs a name")?.to_string_lossy().into_owned();
    Ok(Sequence { name, camera: *dataset.camera(), mount: None, views: views? })
}

fn short(scene: &str) -> String {
    let file = Path::new(scene).file_stem().map_or(scene.into(), |stem| stem.to_string_lossy());
    file.trim_start_matches("builtin:").to_owned()
}
