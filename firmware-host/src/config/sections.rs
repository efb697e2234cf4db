//! The sections of the configuration. What each key means, its range and its source stand in `robot.default.toml`.

use hal::{CameraModel, Pose3, Twist2, camera_mount};
use runtime::{
    model_gate::{GateLimits, TrialLimits},
    perception::{NetworkOptions, Provider},
    planning::{FollowerConfig, PlanConfig},
    safety::{BodySector, SafetyConfig},
};
use serde::{Deserialize, Serialize};
use simulator::{laser::LaserModel, nuisance::Nuisances};

use super::Config;

/// `[camera]`: size of the pictures that perception works on, and where the camera sits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSection {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Horizontal field of view, degrees.
    pub horizontal_fov_deg: f64,
    /// Height of the optical centre above the floor, metres.
    pub height_m: f64,
    /// How far it sits in front of `base_link`, metres.
    pub forward_m: f64,
    /// How far it looks below the horizon, degrees.
    pub pitch_down_deg: f64,
}

impl Default for CameraSection {
    fn default() -> Self {
        Self {
            width: 640,
            height: 192,
            horizontal_fov_deg: 90.0,
            height_m: 0.8,
            forward_m: 0.0,
            pitch_down_deg: 0.0,
        }
    }
}

impl CameraSection {
    /// Intrinsics: square pixels, the optical axis in the middle.
    #[must_use]
    pub fn model(&self) -> CameraModel {
        CameraModel::pinhole(self.width, self.height, self.horizontal_fov_deg.to_radians())
    }

    /// `t_base_camera`.
    #[must_use]
    pub fn mount(&self) -> Pose3 {
        camera_mount(self.forward_m, self.height_m, self.pitch_down_deg.to_radians())
    }
}

/// `[lidar]`: where the safety LiDAR sits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarSection {
    /// Height of the scan plane above the floor, metres.
    pub height_m: f64,
    /// How far it sits in front of `base_link`, metres.
    pub forward_m: f64,
}

impl Default for LidarSection {
    fn default() -> Self {
        Self { height_m: 0.18, forward_m: 0.0 }
    }
}

/// `[base]`: the drive base and its discrete actions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BaseSection {
    /// Radius of the round footprint, metres; the planner takes every robot for round.
    pub footprint_radius_m: f64,
    /// Corners of a footprint that is not round, in `base_link`, metres; empty: it is round.
    pub footprint_m: Vec<[f64; 2]>,
    /// One step forward, metres.
    pub forward_step_m: f64,
    /// One turn on the spot, degrees.
    pub turn_step_deg: f64,
    /// Time for one action, milliseconds.
    pub tick_ms: u64,
}

impl Default for BaseSection {
    fn default() -> Self {
        Self {
            footprint_radius_m: 0.16,
            footprint_m: Vec::new(),
            forward_step_m: 0.03,
            turn_step_deg: 2.0,
            tick_ms: 100,
        }
    }
}

impl BaseSection {
    /// Duration of one tick, nanoseconds.
    #[must_use]
    pub fn tick_ns(&self) -> u64 {
        self.tick_ms * 1_000_000
    }

    /// Speed of one step forward per tick, m/s.
    #[must_use]
    pub fn speed_mps(&self) -> f64 {
        self.forward_step_m / self.tick_s()
    }

    /// Rate of one turn per tick, rad/s.
    #[must_use]
    pub fn turn_radps(&self) -> f64 {
        self.turn_step_deg.to_radians() / self.tick_s()
    }

    /// The action "forward".
    #[must_use]
    pub fn forward(&self) -> Twist2 {
        Twist2 { linear_mps: self.speed_mps(), angular_radps: 0.0 }
    }

    /// Duration of one tick, seconds.
    #[must_use]
    pub fn tick_s(&self) -> f64 {
        self.tick_ms as f64 / 1e3
    }
}

/// `[safety]`: what stands between every wish and the wheels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SafetySection {
    /// Free way in front of the footprint below which the robot stops, metres.
    pub stop_distance_m: f64,
    /// How far it then backs off, metres.
    pub back_off_m: f64,
    /// Of that, so much over ground that nobody has looked at, metres.
    pub blind_back_off_m: f64,
    /// What was seen of the ground behind counts for so long, seconds.
    pub rear_memory_s: f64,
    /// Backing off ends after this time, seconds.
    pub back_off_timeout_s: f64,
    /// A scan older than this is not driven by, seconds.
    pub scan_timeout_s: f64,
    /// Beams that meet the robot's own body.
    pub body: Vec<BodySector>,
}

impl Default for SafetySection {
    fn default() -> Self {
        Self {
            stop_distance_m: 0.1,
            back_off_m: 0.2,
            blind_back_off_m: 0.05,
            rear_memory_s: 30.0,
            back_off_timeout_s: 5.0,
            scan_timeout_s: 0.2,
            body: Vec::new(),
        }
    }
}

/// `[planning]`: where the robot likes to drive, and how a path becomes motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanningSection {
    /// Cells this much further from an obstacle than the footprint's radius are still never entered, metres.
    pub margin_m: f64,
    /// Up to this distance from an obstacle driving costs more, metres.
    pub inflation_radius_m: f64,
    /// Extra cost of a metre right at the hard limit, in metres of free floor.
    pub inflation_cost: f64,
    /// Cost of a metre through the unknown, in metres of free floor.
    pub unknown_cost: f64,
    /// Plans may leave the known part of the map by this much, metres.
    pub padding_m: f64,
    /// A search gives up after this many cells.
    pub max_expanded: usize,
    /// The robot steers for the point of the path this far ahead, metres.
    pub lookahead_m: f64,
    /// With more heading error than this it turns on the spot first, degrees.
    pub turn_in_place_deg: f64,
    /// Turning on the spot ends below this heading error, degrees.
    pub aligned_deg: f64,
    /// While driving, heading errors below this are not corrected, degrees.
    pub correct_deg: f64,
    /// Whether larger ones are corrected on an arc, not on the spot. `run` always does.
    pub arcs: bool,
    /// The end of a path is reached within this distance, metres.
    pub goal_tolerance_m: f64,
    /// Further from the path than this is off the path, metres.
    pub off_path_m: f64,
}

impl Default for PlanningSection {
    fn default() -> Self {
        Self {
            margin_m: 0.02,
            inflation_radius_m: 0.24,
            inflation_cost: 4.0,
            unknown_cost: 4.0,
            padding_m: 0.6,
            max_expanded: 4_000_000,
            lookahead_m: 0.3,
            turn_in_place_deg: 20.0,
            aligned_deg: 2.0,
            correct_deg: 4.0,
            arcs: false,
            goal_tolerance_m: 0.06,
            off_path_m: 0.3,
        }
    }
}

/// `[network]`: the depth network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkSection {
    /// Threads for inference.
    pub threads: usize,
    /// Whether waiting threads spin during an inference: faster, at the expense of whatever else runs at that moment.
    pub spin: bool,
    /// Whose kernels compute: `cpu`, `xnnpack`, `cuda`, `tensorrt`.
    pub provider: Provider,
}

impl Default for NetworkSection {
    fn default() -> Self {
        let NetworkOptions { threads, spin, provider } = NetworkOptions::default();
        Self { threads, spin, provider }
    }
}

/// `[models]`: signed models.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelsSection {
    /// Folder; empty: none.
    pub store: String,
    /// File of public keys.
    pub trusted_keys: String,
    /// Folder of recorded runs; empty: none.
    pub recordings: String,
    /// 99th percentile of one inference, milliseconds.
    pub max_p99_ms: f64,
    /// Address space of the examining process, MiB.
    pub gate_memory_mib: u64,
    /// Time of the examining process, seconds.
    pub gate_timeout_s: u64,
    /// Turns of a trial.
    pub trial_turns: u64,
    /// Way of a trial, metres.
    pub trial_m: f64,
}

impl Default for ModelsSection {
    fn default() -> Self {
        Self {
            store: String::new(),
            trusted_keys: signed_model::TRUSTED_KEYS_FILE.to_owned(),
            recordings: String::new(),
            max_p99_ms: GateLimits::default().p99_ms,
            gate_memory_mib: 4096,
            gate_timeout_s: 600,
            trial_turns: TrialLimits::default().turns,
            trial_m: TrialLimits::default().metres,
        }
    }
}

impl ModelsSection {
    /// What a trial asks for.
    #[must_use]
    pub fn trial_limits(&self) -> TrialLimits {
        TrialLimits { turns: self.trial_turns, metres: self.trial_m, ..TrialLimits::default() }
    }
}

/// `[recording]`: the MCAP recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSection {
    /// A new segment begins after this much recorded time, seconds.
    pub segment_s: f64,
    /// A new segment begins when the current one has grown to this size, MiB.
    pub segment_mib: u64,
    /// Depth is recorded every this many ticks, for viewers; replay does not need it.
    pub depth_every_ticks: u64,
    /// The map is recorded every this many ticks, for viewers; replay does not need it.
    pub map_every_ticks: u64,
    /// Whether pictures are recorded. Without them nothing can be recomputed or trained on.
    pub pictures: bool,
    /// All segments beside the run's folder together, GiB; 0: as much as there is. Only on a robot.
    pub quota_gib: f64,
    /// So much of the disk stays free, GiB. Only on a robot.
    pub free_gib: f64,
}

impl Default for RecordingSection {
    fn default() -> Self {
        Self {
            segment_s: 60.0,
            segment_mib: 256,
            depth_every_ticks: 10,
            map_every_ticks: 20,
            pictures: true,
            quota_gib: 0.0,
            free_gib: 2.0,
        }
    }
}

/// `[simulator]`: the simulated robot, and what makes its pictures hard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatorSection {
    /// Whether the robot slides along an obstacle that it touches (Habitat's default) or stops there.
    pub sliding: bool,
    /// Standard deviation of measured distance, share of the distance.
    pub odometry_distance_noise: f64,
    /// Standard deviation of measured turn, share of the turn.
    pub odometry_turn_noise: f64,
    /// Standard deviation of a LiDAR range up to 10 m, metres; three times that beyond.
    pub lidar_noise_m: f64,
    /// Share of LiDAR beams that meet something and return nothing.
    pub lidar_dropout: f64,
    /// What makes the pictures hard.
    pub nuisances: Nuisances,
}

impl Default for SimulatorSection {
    fn default() -> Self {
        Self {
            sliding: false,
            odometry_distance_noise: 0.0,
            odometry_turn_noise: 0.0,
            lidar_noise_m: LaserModel::UTM_30LX.noise_near_m,
            lidar_dropout: LaserModel::UTM_30LX.dropout,
            nuisances: Nuisances::default(),
        }
    }
}

impl SimulatorSection {
    /// The simulated scanner: a UTM-30LX with the configured noise.
    #[must_use]
    pub fn laser_model(&self) -> LaserModel {
        LaserModel {
            noise_near_m: self.lidar_noise_m,
            noise_far_m: 3.0 * self.lidar_noise_m,
            dropout: self.lidar_dropout,
            ..LaserModel::UTM_30LX
        }
    }
}

impl Config {
    /// The safety plane's own configuration, put together from `[safety]`, `[base]` and `[lidar]`, for a simulated base that
    /// obeys at once and a safety plane that is turned once a tick.
    #[must_use]
    pub fn safety_config(&self) -> SafetyConfig {
        SafetyConfig {
            footprint_radius_m: self.base.footprint_radius_m,
            footprint_m: self.base.footprint_m.clone(),
            body: self.safety.body.clone(),
            stop_distance_m: self.safety.stop_distance_m,
            back_off_m: self.safety.back_off_m,
            blind_back_off_m: self.safety.blind_back_off_m,
            rear_memory_s: self.safety.rear_memory_s,
            back_off_mps: self.base.speed_mps(),
            escape_radps: self.base.turn_radps(),
            back_off_timeout_s: self.safety.back_off_timeout_s,
            scan_timeout_s: self.safety.scan_timeout_s,
            laser_forward_m: self.lidar.forward_m,
            period_s: self.base.tick_s(),
            ..SafetyConfig::default()
        }
    }

    /// The planner's own configuration, put together from `[planning]` and `[base]`.
    #[must_use]
    pub fn plan_config(&self) -> PlanConfig {
        PlanConfig {
            footprint_radius_m: self.base.footprint_radius_m,
            margin_m: self.planning.margin_m,
            inflation_radius_m: self.planning.inflation_radius_m,
            inflation_cost: self.planning.inflation_cost,
            unknown_cost: self.planning.unknown_cost,
            padding_m: self.planning.padding_m,
            max_expanded: self.planning.max_expanded,
        }
    }

    /// The follower's own configuration, put together from `[planning]` and `[base]`.
    #[must_use]
    pub fn follower_config(&self) -> FollowerConfig {
        FollowerConfig {
            forward_m: self.base.forward_step_m,
            turn_rad: self.base.turn_step_deg.to_radians(),
            lookahead_m: self.planning.lookahead_m,
            turn_in_place_rad: self.planning.turn_in_place_deg.to_radians(),
            aligned_rad: self.planning.aligned_deg.to_radians(),
            correct_rad: self.planning.correct_deg.to_radians(),
            arcs: self.planning.arcs,
            goal_tolerance_m: self.planning.goal_tolerance_m,
            off_path_m: self.planning.off_path_m,
        }
    }
}
