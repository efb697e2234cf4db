//! Pictures with true depth and true poses, in memory.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use firmware_host::config::Config;
use firmware_host::dataset::Dataset;
use firmware_host::setup::{self, Mission};
use hal::{
    Base, Camera, CameraModel, Clock, DepthMap, DriveCommand, Frame, LaserScan, Lidar, Pose3,
    Twist2, WheelFeedback,
};
use runtime::exploration::PolicyKind;
use runtime::robot::{DepthSource, Robot};
use runtime::tick::TickInput;
use simulator::{Devices, SimulatedRobot, World};

/// One picture.
pub struct View {
    /// RGB8, row-major.
    pub rgb: Vec<u8>,
    /// True z-depth, metres; 0 where unknown.
    pub truth: Option<DepthMap>,
    /// True `t_odom_camera`.
    pub t_odom_camera: Pose3,
}

/// Pictures in the order in which they were taken.
pub struct Sequence {
    /// Where, and how the camera moved.
    pub name: String,
    /// The camera of all pictures.
    pub camera: CameraModel,
    /// The pictures.
    pub views: Vec<View>,
}

/// How a simulated camera moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// As this policy drives, with true depth in its map.
    Policy(PolicyKind),
    /// Left, and left again: no parallax at all.
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
}

/// `frames` pictures of a robot that drives through `world`.
///
/// # Errors
/// When the robot or its devices fail.
pub fn simulated(
    world: &Arc<World>,
    motion: Motion,
    frames: u64,
    seed: u64,
    people: usize,
) -> Result<Sequence> {
    let mut config = Config::default();
    config.simulator.nuisances.people = people;
    let simulated =
        SimulatedRobot::new(Arc::clone(world), setup::simulated_robot(&config, seed, None))?;
    let policy = if let Motion::Policy(policy) = motion { policy } else { PolicyKind::Random };
    let mission = Mission { policy, depth_source: DepthSource::Truth, seed };
    let mut robot = Robot::new(config.robot(&mission), None)?;
    let mut devices = simulated.devices();
    let camera = *devices.camera.model();
    let mut views = Vec::new();
    for tick in 0..frames {
        let (view, twist) = turn(&config, &mut devices, &mut robot, tick)?;
        let twist = match motion {
            Motion::Policy(_) => twist,
            Motion::Rotation => Twist2 {
                linear_mps: 0.0,
                angular_radps: config.base.turn_step_deg.to_radians() / config.base.tick_s(),
            },
        };
        devices.base.drive(&DriveCommand { twist, counter: tick as u32, plan_age_ns: 0 })?;
        views.extend(view);
    }
    Ok(Sequence { name: format!("{}, {}", short(world.name()), motion.name()), camera, views })
}

fn turn(
    config: &Config,
    devices: &mut Devices,
    robot: &mut Robot,
    tick: u64,
) -> Result<(Option<View>, Twist2)> {
    let time_ns = tick * config.base.tick_ns();
    let model = *devices.camera.model();
    let mut frame = Frame::empty();
    let mut scan = LaserScan::empty(devices.lidar.geometry());
    let mut truth = DepthMap::none(model.width, model.height);
    devices.clock.sleep_until_ns(time_ns);
    let has_frame = devices.camera.poll_frame(&mut frame)?;
    let has_scan = devices.lidar.poll_scan(&mut scan)?;
    let wheel = devices.base.poll_feedback()?.unwrap_or(WheelFeedback::default());
    devices.truth.depth(&mut truth);
    let input = TickInput {
        tick,
        time_ns,
        wheel,
        scan: has_scan.then_some(&scan),
        frame: if has_frame { Some(frame.view()?) } else { None },
        truth: Some(&truth),
        safety: None,
    };
    let decision = robot.tick(&input, &mut ());
    let t_odom_camera = devices.truth.pose().to_pose3() * config.camera.mount();
    let view = input.frame.map(|frame| View {
        rgb: frame.data().to_vec(),
        truth: Some(truth.clone()),
        t_odom_camera,
    });
    Ok((view, decision.command.into()))
}

/// Every picture of a recorded sequence.
///
/// # Errors
/// When it cannot be read.
pub fn recorded(folder: &Path) -> Result<Sequence> {
    let config = Config::default();
    let dataset = Dataset::open(folder, config.camera.width, config.camera.height)?;
    let view = |sample: firmware_host::dataset::Sample| View {
        rgb: sample.rgb,
        truth: sample.truth,
        t_odom_camera: sample.t_world_camera,
    };
    let views = dataset.samples().map(|sample| Ok(view(sample?))).collect::<Result<Vec<_>>>();
    let name = folder.file_name().context("a dataset needs a name")?.to_string_lossy().into_owned();
    Ok(Sequence { name, camera: *dataset.camera(), views: views? })
}

fn short(scene: &str) -> String {
    let file = Path::new(scene).file_stem().map_or(scene.into(), |stem| stem.to_string_lossy());
    file.trim_start_matches("builtin:").to_owned()
}
