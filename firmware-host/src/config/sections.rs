//! The sections of the configuration that belong to this program. [`hal::settings!`] explains the form of a declaration.

use hal::{CameraModel, CameraMount, LidarMount, Pose3, RobotDescription, Twist2};
use runtime::{
    model_gate::{GateLimits, TrialLimits},
    perception::{NetworkOptions, Provider},
    planning::{FollowerConfig, PlanConfig},
    safety::SafetyConfig,
};

use super::Config;

hal::settings! {
    /// The camera: size of the images that perception works on, and the camera's place on the robot.
    pub struct CameraSection {
        /// Columns of the images that perception works on.
        width: usize = 640, in 64..=4096, unit "pixels", source "paper";
        /// Rows of the images that perception works on.
        height: usize = 192, in 32..=4096, unit "pixels", source "paper";
        /// Horizontal field of view of these images.
        horizontal_fov_deg: f64 = 90.0, in 20.0..=150.0, unit "degrees", source "paper";
        /// Height of the optical centre above the floor.
        height_m: f64 = CameraMount::default().height_m, in 0.05..=3.0, unit "m", source "paper";
        /// Distance from the centre of the base forward to the camera.
        forward_m: f64 = CameraMount::default().forward_m, in -1.0..=1.0, unit "m";
        /// Distance from the centre of the base to the left to the camera.
        left_m: f64 = CameraMount::default().left_m, in -1.0..=1.0, unit "m";
        /// Angle of the optical axis below the horizon. The paper's camera is level, and sees the floor from 2.7 m on instead of 1.25 m.
        pitch_down_deg: f64 = CameraMount::default().pitch_down_deg, in -60.0..=60.0, unit "degrees";
        /// Rotation about the optical axis: positive where the right side of the camera is lower.
        roll_deg: f64 = CameraMount::default().roll_deg, in -45.0..=45.0, unit "degrees";
        /// Direction of the optical axis, counter-clockwise from forward as seen from above.
        yaw_deg: f64 = CameraMount::default().yaw_deg, in -60.0..=60.0, unit "degrees";
    }
}

impl CameraSection {
    /// Intrinsics with square pixels and the optical axis in the middle of the image.
    #[must_use]
    pub fn model(&self) -> CameraModel {
        CameraModel::pinhole(self.width, self.height, self.horizontal_fov_deg.to_radians())
    }

    /// The camera's place on the robot.
    #[must_use]
    pub fn mount(&self) -> CameraMount {
        CameraMount {
            height_m: self.height_m,
            forward_m: self.forward_m,
            left_m: self.left_m,
            pitch_down_deg: self.pitch_down_deg,
            roll_deg: self.roll_deg,
            yaw_deg: self.yaw_deg,
        }
    }

    /// Pose of the camera in the base frame.
    #[must_use]
    pub fn t_base_camera(&self) -> Pose3 {
        self.mount().t_base_camera()
    }
}

hal::settings! {
    /// The place of the safety LiDAR on the robot.
    pub struct LidarSection {
        /// Height of the scan plane above the floor: low enough for the feet of chairs.
        height_m: f64 = LidarMount::default().height_m, in 0.02..=3.0, unit "m";
        /// Distance from the centre of the base forward to the LiDAR.
        forward_m: f64 = LidarMount::default().forward_m, in -1.0..=1.0, unit "m";
        /// Distance from the centre of the base to the left to the LiDAR.
        left_m: f64 = LidarMount::default().left_m, in -1.0..=1.0, unit "m";
        /// Direction of the LiDAR's front, counter-clockwise from forward as seen from above. The front of an RPLIDAR, LD06 or LD19
        /// is where `devices.lidar.zero_deg` says that its zero points.
        yaw_deg: f64 = LidarMount::default().yaw_deg, in -45.0..=45.0, unit "degrees";
    }
}

impl LidarSection {
    /// The LiDAR's place on the robot.
    #[must_use]
    pub fn mount(&self) -> LidarMount {
        LidarMount {
            height_m: self.height_m,
            forward_m: self.forward_m,
            left_m: self.left_m,
            yaw_deg: self.yaw_deg,
        }
    }

    /// Pose of the LiDAR in the base frame.
    #[must_use]
    pub fn t_base_laser_3d(&self) -> Pose3 {
        self.mount().t_base_laser_3d()
    }
}

hal::settings! {
    /// The robot's footprint and its discrete actions. One forward action per tick is the driving speed, 0.3 m/s by default.
    pub struct BaseSection {
        /// Radius of the circle that contains the robot. The planner treats every robot as this circle.
        footprint_radius_m: f64 = RobotDescription::default().footprint_radius_m, in 0.05..=1.0, unit "m";
        /// Corners of a robot that is not round, in order, relative to the middle of the axle:
        /// `[[0.2, 0.1], [-0.1, 0.1], ...]`. Empty for a round robot.
        footprint_m: Vec<[f64; 2]> = Vec::new(), in -1.0..=1.0, unit "m";
        /// Distance of one forward action.
        forward_step_m: f64 = RobotDescription::default().forward_step_m, in 0.005..=0.5, unit "m", source "paper";
        /// Angle of one rotation action.
        turn_step_deg: f64 = RobotDescription::default().turn_step_deg, in 0.1..=30.0, unit "degrees", source "twice the paper's";
        /// Duration of one action, which is the period of the exploration plane.
        tick_ms: u64 = RobotDescription::default().tick_ms, in 5..=1000, unit "ms";
    }
}

impl BaseSection {
    /// Duration of one tick.
    #[must_use]
    pub fn tick_ns(&self) -> u64 {
        self.tick_ms * 1_000_000
    }

    /// Speed of one forward action per tick.
    #[must_use]
    pub fn speed_mps(&self) -> f64 {
        self.forward_step_m / self.tick_s()
    }

    /// Angular rate of one rotation action per tick.
    #[must_use]
    pub fn turn_radps(&self) -> f64 {
        self.turn_step_deg.to_radians() / self.tick_s()
    }

    /// The velocity of the action "forward".
    #[must_use]
    pub fn forward(&self) -> Twist2 {
        Twist2 { linear_mps: self.speed_mps(), angular_radps: 0.0 }
    }

    /// Duration of one tick.
    #[must_use]
    pub fn tick_s(&self) -> f64 {
        self.tick_ms as f64 / 1e3
    }
}

hal::settings! {
    /// How the depth network is run.
    pub struct NetworkSection {
        /// Threads of one inference.
        threads: usize = NetworkOptions::default().threads, in 1..=256, unit "threads";
        /// Whether threads that wait for work during an inference spin: faster, but it takes processor time from other
        /// programs.
        spin: bool = NetworkOptions::default().spin;
        /// Execution provider of ONNX Runtime, as far as the loaded library has it.
        provider: Provider = NetworkOptions::default().provider;
    }
}

hal::settings! {
    /// Signed models (docs/models.md): where they are stored, and what the gate and the trial demand of a new one.
    pub struct ModelsSection {
        /// Directory of signed models. If it is empty, `--model` names the model.
        store: String = String::new();
        /// File of the public keys whose models are accepted, one key per line.
        trusted_keys: String = signed_model::TRUSTED_KEYS_FILE.to_owned();
        /// Directory of this robot's runs. New models are judged by what is held out of these.
        recordings: String = String::new();
        /// The 99th percentile of the inference time must stay below this. Coarse depth and the map need the rest of a tick.
        max_p99_ms: f64 = GateLimits::default().p99_ms, in 1.0..=10000.0, unit "ms";
        /// Whether a model is refused that is shown to be worse than dense depth, which needs no network.
        must_reach_dense: bool = GateLimits::default().must_reach_dense;
        /// Address space of the process that examines a model.
        gate_memory_mib: u64 = 4096, in 256..=1048576, unit "MiB";
        /// Time limit of the process that examines a model. Its limit of processor time is twice this.
        gate_timeout_s: u64 = 600, in 1..=86400, unit "s";
        /// Ticks of the trial of a new model: only those in which a plan moved the robot count. 600 ticks are one minute.
        trial_ticks: u64 = TrialLimits::default().ticks, in 10..=1000000, unit "ticks", was "trial_turns";
        /// Distance that plans drive during a trial. A robot that stands ends no trial.
        trial_m: f64 = TrialLimits::default().metres, in 0.1..=1000.0, unit "m";
    }
}

impl ModelsSection {
    /// What a trial demands of a new model.
    #[must_use]
    pub fn trial_limits(&self) -> TrialLimits {
        TrialLimits { ticks: self.trial_ticks, metres: self.trial_m, ..TrialLimits::default() }
    }
}

hal::settings! {
    /// Who this robot is, for everybody who gets its recordings (docs/recording.md).
    pub struct IdentitySection {
        /// File of the robot's secret key, with which it signs what it records. It is made at the first start. If this is empty,
        /// recordings are not signed.
        key_file: String = String::new();
        /// Name of the robot, without spaces. Recordings hold it.
        name: String = String::new();
        /// Home or site in which the robot works. Recordings hold it.
        site: String = String::new();
    }
}

hal::settings! {
    /// The MCAP recording of a run (docs/recording.md).
    pub struct RecordingSection {
        /// A new segment begins after this much recorded time.
        segment_s: f64 = 60.0, in 1.0..=3600.0, unit "s";
        /// A new segment begins when the current one has reached this size.
        segment_mib: u64 = 256, in 1..=4096, unit "MiB";
        /// Ticks between two recorded depth images. They are for viewers; a replay recomputes them.
        depth_every_ticks: u64 = 10, in 1..=1000000, unit "ticks";
        /// Ticks between two recorded maps. They are for viewers; a replay recomputes them.
        map_every_ticks: u64 = 20, in 1..=1000000, unit "ticks";
        /// Whether images are recorded. Without them, for privacy, there is no depth and no snapshot in the recording, and it
        /// can be used neither for a replay nor for training.
        images: bool = true, was "pictures";
        /// Largest size of all segments beside the run's directory; the oldest are removed first. 0 sets no limit. Only on a
        /// robot.
        quota_gib: f64 = 0.0, in 0.0..=1000000.0, unit "GiB";
        /// Disk space that stays free, or a tenth of a small disk; the oldest segments are removed first. Only on a robot.
        free_gib: f64 = 2.0, in 0.0..=1000000.0, unit "GiB";
        /// Share of `quota_gib`, or of a smaller disk, for the segments around contacts and stops that need a person. Within it
        /// they are not removed; beyond it, the oldest lose this protection. Only on a robot.
        kept_percent: u64 = 50, in 0..=100, unit "%";
        /// Segments that are older are removed before a new one begins, also kept ones and those that no workstation has pulled.
        /// 0 sets no limit. Only on a robot.
        max_age_days: u64 = 0, in 0..=36500, unit "days";
    }
}

impl Config {
    /// The dimensions of the robot, from `[camera]`, `[lidar]` and `[base]`.
    #[must_use]
    pub fn robot_description(&self) -> RobotDescription {
        RobotDescription {
            footprint_radius_m: self.base.footprint_radius_m,
            footprint_m: self.base.footprint_m.clone(),
            camera: self.camera.mount(),
            lidar: self.lidar.mount(),
            forward_step_m: self.base.forward_step_m,
            turn_step_deg: self.base.turn_step_deg,
            tick_ms: self.base.tick_ms,
        }
    }

    /// The safety plane's configuration for a simulated base, which responds immediately, and a safety plane that runs once
    /// per tick.
    #[must_use]
    pub fn safety_config(&self) -> SafetyConfig {
        self.safety.safety_config(&self.robot_description())
    }

    #[must_use]
    pub fn plan_config(&self) -> PlanConfig {
        self.planning.plan_config(&self.robot_description())
    }

    #[must_use]
    pub fn follower_config(&self) -> FollowerConfig {
        self.planning.follower_config(&self.robot_description())
    }
}
