//! The sections of the configuration. What each key means, its range and its source stand in `robot.default.toml`.

use hal::{CameraModel, Pose3, Twist2, camera_mount};
use runtime::safety::BumperConfig;
use serde::{Deserialize, Serialize};

use super::Config;

/// `[camera]`: size of the pictures that perception works on, and where the camera sits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
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
        Self { width: 640, height: 192, horizontal_fov_deg: 90.0, height_m: 0.8, forward_m: 0.0, pitch_down_deg: 0.0 }
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
#[serde(default)]
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
#[serde(default)]
pub struct BaseSection {
    /// Radius of the round footprint, metres.
    pub footprint_radius_m: f64,
    /// One step forward, metres.
    pub forward_step_m: f64,
    /// One turn on the spot, degrees.
    pub turn_step_deg: f64,
    /// Time for one action, milliseconds.
    pub tick_ms: u64,
}

impl Default for BaseSection {
    fn default() -> Self {
        Self { footprint_radius_m: 0.16, forward_step_m: 0.03, turn_step_deg: 2.0, tick_ms: 100 }
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

/// `[bumper]`: the safety stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BumperSection {
    /// Free way in front of the footprint below which the robot stops, metres.
    pub stop_distance_m: f64,
    /// How far it then backs off, metres.
    pub back_off_m: f64,
    /// Backing off ends after this time, seconds.
    pub back_off_timeout_s: f64,
    /// A scan older than this is not driven by, seconds.
    pub scan_timeout_s: f64,
}

impl Default for BumperSection {
    fn default() -> Self {
        Self { stop_distance_m: 0.1, back_off_m: 0.2, back_off_timeout_s: 5.0, scan_timeout_s: 0.2 }
    }
}

/// `[exploration]`: how goals are chosen and given up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ExplorationSection {
    /// Frames that the active policy spends on frontiers before it looks for inconsistencies.
    pub frontier_frames: u64,
    /// Frames that the active policy spends on inconsistencies before it goes back to frontiers.
    pub inconsistency_frames: u64,
    /// A goal without progress for this long is given up, seconds.
    pub progress_timeout_s: f64,
    /// How long a goal that was given up is left alone, seconds.
    pub blacklist_expiry_s: f64,
}

impl Default for ExplorationSection {
    fn default() -> Self {
        Self { frontier_frames: 800, inconsistency_frames: 400, progress_timeout_s: 30.0, blacklist_expiry_s: 120.0 }
    }
}

/// `[network]`: the depth network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct NetworkSection {
    /// Threads for inference.
    pub threads: usize,
}

impl Default for NetworkSection {
    fn default() -> Self {
        Self { threads: 1 }
    }
}

/// `[recording]`: the MCAP recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RecordingSection {
    /// A new segment begins after this much recorded time, seconds.
    pub segment_s: f64,
    /// A new segment begins when the current one has grown to this size, MiB.
    pub segment_mib: u64,
    /// Depth is recorded every this many ticks, for viewers; replay does not need it.
    pub depth_every_ticks: u64,
    /// The map is recorded every this many ticks, for viewers; replay does not need it.
    pub map_every_ticks: u64,
}

impl Default for RecordingSection {
    fn default() -> Self {
        Self { segment_s: 60.0, segment_mib: 256, depth_every_ticks: 10, map_every_ticks: 20 }
    }
}

/// `[simulator]`: the simulated robot and home. Zero is off everywhere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SimulatorSection {
    /// Whether the robot slides along an obstacle that it touches (Habitat's default) or stops there.
    pub sliding: bool,
    /// Standard deviation of measured distance, share of the distance.
    pub odometry_distance_noise: f64,
    /// Standard deviation of measured turn, share of the turn.
    pub odometry_turn_noise: f64,
    /// Standard deviation of a LiDAR range, metres.
    pub lidar_noise_m: f64,
    /// Share of LiDAR beams without an answer.
    pub lidar_dropout: f64,
    /// Slow change of exposure, share of the brightness.
    pub exposure_drift: f64,
    /// Flicker from frame to frame, share of the brightness.
    pub flicker: f64,
    /// Patches of sunlight on the floor.
    pub sun_patches: bool,
    /// Standard deviation of pixel noise, share of full scale.
    pub sensor_noise: f64,
    /// Exposure time, share of a tick.
    pub motion_blur: f64,
    /// People who walk about.
    pub people: u32,
    /// Furniture has moved since the home was built.
    pub moved_furniture: bool,
}

impl Default for SimulatorSection {
    fn default() -> Self {
        Self {
            sliding: false,
            odometry_distance_noise: 0.0,
            odometry_turn_noise: 0.0,
            lidar_noise_m: 0.01,
            lidar_dropout: 0.0,
            exposure_drift: 0.0,
            flicker: 0.0,
            sun_patches: false,
            sensor_noise: 0.006,
            motion_blur: 0.0,
            people: 0,
            moved_furniture: false,
        }
    }
}

impl Config {
    /// The bumper's own configuration, put together from `[bumper]`, `[base]` and `[lidar]`.
    #[must_use]
    pub fn bumper_config(&self) -> BumperConfig {
        BumperConfig {
            footprint_radius_m: self.base.footprint_radius_m,
            stop_distance_m: self.bumper.stop_distance_m,
            back_off_m: self.bumper.back_off_m,
            back_off_mps: self.base.speed_mps(),
            escape_radps: self.base.turn_radps(),
            back_off_timeout_s: self.bumper.back_off_timeout_s,
            scan_timeout_s: self.bumper.scan_timeout_s,
            laser_forward_m: self.lidar.forward_m,
            period_s: self.base.tick_s(),
        }
    }
}
