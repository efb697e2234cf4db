//! What shapes a robot's decisions.

use hal::{CameraModel, Pose2, Pose3, RobotDescription};

use super::DepthSource;
use crate::exploration::{ExplorationConfig, PolicyKind};
use crate::localization::LocalizationConfig;
use crate::mapping::MapConfig;
use crate::perception::{CoarseConfig, DenseConfig};
use crate::planning::{FollowerConfig, PlanConfig, PlanningSection};

/// A robot stops when it has not received a frame for this long, unless its configuration says otherwise.
pub const FRAME_TIMEOUT_S: f64 = 1.0;
/// The rate of the safety plane, unless the configuration says otherwise.
pub const SAFETY_HZ: f64 = 100.0;

/// The number of ticks without a frame that last for `timeout_s`.
#[must_use]
pub fn ticks_of_silence(timeout_s: f64, tick_s: f64) -> u64 {
    (timeout_s / tick_s).ceil() as u64
}

/// Everything that shapes a decision, besides the inputs and the model.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotConfig {
    /// Intrinsics of the frames.
    pub camera: CameraModel,
    /// Pose of `camera_optical` in `base_link`.
    pub t_base_camera: Pose3,
    /// Pose of `laser` in `base_link`, in the scan plane.
    pub t_base_laser: Pose2,
    /// Length of the forward primitive, metres.
    pub forward_step_m: f64,
    /// Angle of the rotation primitives, radians.
    pub rotation_step_rad: f64,
    /// Duration of one tick, seconds.
    pub tick_s: f64,
    /// Section `[localization]`: scan matching, loop closure and search in the map.
    pub localization: LocalizationConfig,
    /// Time from a decision to the motion that it causes, seconds. The path is followed from the pose at which the robot will be
    /// by then.
    pub command_delay_s: f64,
    /// How goals are chosen.
    pub policy: PolicyKind,
    /// Seed of the policy's random numbers.
    pub seed: u64,
    /// Where the map's depth comes from.
    pub depth_source: DepthSource,
    /// Section `[coarse]`: coarse depth.
    pub coarse: CoarseConfig,
    /// Section `[dense]`: dense depth.
    pub dense: DenseConfig,
    /// Section `[map]`: size and update of the occupancy grid.
    pub map: MapConfig,
    /// Section `[planning]`: costs and search.
    pub plan: PlanConfig,
    /// How paths become motion primitives.
    pub follower: FollowerConfig,
    /// Section `[exploration]`: choice of goals.
    pub exploration: ExplorationConfig,
    /// The robot stops after this many ticks in a row without a frame, until a frame arrives. `None`: it goes on by its map.
    pub stop_without_frames: Option<u64>,
    /// Radius of the robot's footprint, metres. The floor under the footprint is mapped as free.
    pub footprint_radius_m: f64,
}

impl RobotConfig {
    /// Coarse depth and the defaults of all sections, for a robot of these dimensions. Tests drive it; it equals the robot of the
    /// default configuration, which a test of `firmware-host` checks.
    #[must_use]
    pub fn of(
        robot: &RobotDescription,
        camera: CameraModel,
        policy: PolicyKind,
        seed: u64,
    ) -> Self {
        let planning = PlanningSection::default();
        let dense = DenseConfig::default();
        Self {
            camera,
            t_base_camera: robot.camera.t_base_camera(),
            t_base_laser: robot.lidar.t_base_laser(),
            forward_step_m: robot.forward_step_m,
            rotation_step_rad: robot.turn_step_deg.to_radians(),
            tick_s: robot.tick_s(),
            localization: LocalizationConfig::default(),
            // The next step of the safety plane sends it.
            command_delay_s: 1.0 / SAFETY_HZ,
            policy,
            seed,
            depth_source: DepthSource::without_network(&dense),
            coarse: CoarseConfig::default(),
            dense,
            map: MapConfig::default(),
            plan: planning.plan_config(robot),
            follower: planning.follower_config(robot),
            exploration: ExplorationConfig::default(),
            stop_without_frames: Some(ticks_of_silence(FRAME_TIMEOUT_S, robot.tick_s())),
            footprint_radius_m: robot.footprint_radius_m,
        }
    }
}
