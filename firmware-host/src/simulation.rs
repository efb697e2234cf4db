//! From configuration and arguments to a simulated robot.

use hal::Pose2;
use runtime::safety::SafetyConfig;
use simulator::floor::Footprint;
use simulator::load::{LoadOptions, UpAxis};
use simulator::{OpenOptions, RobotOptions};

use crate::cli::{SceneFileArgs, UpArg};
use crate::config::Config;
use crate::setup::laser_mount;

impl Config {
    /// The safety plane's configuration in simulation: the simulated base answers at once and stops within a step.
    #[must_use]
    pub fn simulated_safety_config(&self) -> SafetyConfig {
        SafetyConfig {
            good_scans: self.run.good_scans,
            feedback_timeout_s: self.run.feedback_timeout_s,
            plan_timeout_s: self.run.plan_timeout_s,
            period_s: 1.0 / self.run.safety_hz,
            ..self.safety_config()
        }
    }
}

/// The simulated robot that the configuration describes.
#[must_use]
pub fn simulated_robot(config: &Config, seed: u64, start: Option<Pose2>) -> RobotOptions {
    let simulator = &config.simulator;
    RobotOptions {
        camera: config.camera.model(),
        t_base_camera: config.camera.mount(),
        t_base_laser: laser_mount(config),
        sliding: simulator.sliding,
        odometry: simulator.odometry_noise(),
        laser: simulator.laser_model(),
        nuisances: simulator.nuisances.clone(),
        camera_latency_s: simulator.latency_s(),
        rolling_shutter_s: simulator.rolling_shutter_s,
        floor_tilt_rad: simulator.floor_tilt_deg.to_radians(),
        seed,
        start,
        ..RobotOptions::default()
    }
}

/// How to open the scene that the arguments speak of.
#[must_use]
pub fn open_options(file: &SceneFileArgs, config: &Config) -> OpenOptions {
    let up_axis = match file.scene_up {
        None => UpAxis::Auto,
        Some(UpArg::Y) => UpAxis::Y,
        Some(UpArg::Z) => UpAxis::Z,
    };
    let footprint = Footprint { radius_m: config.base.footprint_radius_m, ..Footprint::default() };
    OpenOptions { load: LoadOptions { up_axis, scale: file.scene_scale }, footprint }
}
