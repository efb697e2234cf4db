//! From configuration and arguments to a robot.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use hal::CameraModel;
use runtime::exploration::PolicyKind;
use runtime::lidar_agreement::LidarAgreement;
use runtime::model_gate::LidarView;
use runtime::perception::{DenseConfig, DepthNetwork, GivenDepth, NetworkOptions};
use runtime::recording::RunHeader;
use runtime::robot::{DepthSource, RobotConfig, ticks_of_silence};

use crate::config::{Config, NetworkSection};
use crate::faults::FaultPlan;
use crate::onnx_runtime;

/// What the command line adds to the configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mission {
    /// How goals are chosen.
    pub policy: PolicyKind,
    /// Which depth goes into the map.
    pub depth_source: DepthSource,
    /// Seed of everything random that the robot decides.
    pub seed: u64,
}

impl Config {
    /// Time from step to step of the safety loop.
    #[must_use]
    pub fn safety_period_ns(&self) -> u64 {
        (1e9 / self.run.safety_hz) as u64
    }

    /// Everything that shapes the robot's decisions.
    #[must_use]
    pub fn robot(&self, mission: &Mission) -> RobotConfig {
        RobotConfig {
            camera: self.camera.model(),
            t_base_camera: self.camera.t_base_camera(),
            t_base_laser: self.lidar.mount().t_base_laser(),
            forward_step_m: self.base.forward_step_m,
            rotation_step_rad: self.base.turn_step_deg.to_radians(),
            tick_s: self.base.tick_s(),
            localization: self.localization.clone(),
            command_delay_s: self.safety_period_ns() as f64 * 1e-9,
            policy: mission.policy,
            seed: mission.seed,
            depth_source: mission.depth_source,
            coarse: self.coarse.clone(),
            dense: self.dense.clone(),
            map: self.map.clone(),
            plan: self.plan_config(),
            follower: self.follower_config(),
            exploration: self.exploration,
            footprint_radius_m: self.base.footprint_radius_m,
            stop_without_frames: Some(ticks_of_silence(
                self.run.frame_timeout_s,
                self.base.tick_s(),
            )),
        }
    }
}

/// Compares depth with the LiDAR while the robot drives.
#[must_use]
pub fn lidar_agreement(config: &Config) -> LidarAgreement {
    LidarAgreement::new(lidar_view(config))
}

/// The safety LiDAR as the camera sees it.
#[must_use]
pub fn lidar_view(config: &Config) -> LidarView {
    LidarView {
        camera: config.camera.model(),
        t_base_camera: config.camera.t_base_camera(),
        t_base_laser: config.lidar.t_base_laser_3d(),
    }
}

/// What a recording says of its run.
///
/// # Errors
/// When the configuration holds a number that JSON cannot hold.
pub fn run_header(
    config: &Config,
    mission: &Mission,
    model: Option<&str>,
    faults: &FaultPlan,
) -> Result<RunHeader> {
    Ok(RunHeader {
        images: config.recording.images,
        seed: mission.seed,
        policy: mission.policy.name().to_owned(),
        depth_source: mission.depth_source.name().to_owned(),
        model_digest: model.map(ToOwned::to_owned),
        faults: faults.texts(),
        fault_seed: faults.seed(),
        t_base_camera: config.camera.t_base_camera(),
        t_base_laser: config.lidar.t_base_laser_3d(),
        config: serde_json::to_value(config)?,
        ..RunHeader::new(
            concat!("firmware-host ", env!("CARGO_PKG_VERSION")),
            config.camera.model(),
        )
    })
}

/// The network that a study hands over after `round`, counted from 0.
#[must_use]
pub fn handed_over_model(dir: &Path, round: u64) -> PathBuf {
    dir.join(format!("model_{round:04}.onnx"))
}

/// Loads ONNX Runtime and a depth network.
///
/// # Errors
/// A missing file or library, or a model that is not what it says; each says what to do.
pub fn load_network(path: &Path, camera: &CameraModel, config: &Config) -> Result<DepthNetwork> {
    let model =
        std::fs::read(path).with_context(|| format!("cannot read the model {}", path.display()))?;
    network_of(&model, camera, config).with_context(|| format!("model {}", path.display()))
}

/// As [`load_network`], from the bytes of its file.
///
/// # Errors
/// As [`load_network`].
pub fn network_of(model: &[u8], camera: &CameraModel, config: &Config) -> Result<DepthNetwork> {
    let (environment, library) = onnx_runtime::init()?;
    tracing::info!(library = %library.display(), "ONNX Runtime");
    let NetworkSection { threads, spin, provider } = config.network;
    let options = NetworkOptions { threads, spin, provider };
    let network = DepthNetwork::load(&environment, model, camera, options)?;
    check_given(&network, config)?;
    Ok(network)
}

/// Whether this robot computes the depth that the network is given.
///
/// # Errors
/// When it does not.
pub fn check_given(network: &DepthNetwork, config: &Config) -> Result<()> {
    if network.spec().given == GivenDepth::Dense && !config.dense.enabled {
        bail!(
            "it needs dense depth, and `dense.enabled` is false; set it to true, or take a model that is given coarse depth"
        );
    }
    Ok(())
}

/// The depth source that was asked for, or the one that the presence of a model suggests.
///
/// # Errors
/// `network` without a model, or `dense` where dense depth is off.
pub fn depth_source(
    asked: Option<DepthSource>,
    has_model: bool,
    dense: &DenseConfig,
) -> Result<DepthSource> {
    match asked {
        Some(DepthSource::Dense) if !dense.enabled => {
            bail!("--depth dense needs `dense.enabled = true`; without it, use --depth coarse")
        }
        Some(DepthSource::Network) if !has_model => {
            bail!("--depth network needs --model FILE; without a model, leave out --depth")
        }
        Some(source) => Ok(source),
        None if has_model => Ok(DepthSource::Network),
        None => Ok(DepthSource::without_network(dense)),
    }
}

#[cfg(test)]
mod tests {
    use hal::RobotDescription;

    use super::*;

    #[test]
    fn a_robot_without_a_configuration_file_is_the_robot_of_the_scenarios() {
        let config = Config::default();
        let mission =
            Mission { policy: PolicyKind::Active, depth_source: DepthSource::Dense, seed: 3 };
        let camera = config.camera.model();
        let of_scenarios =
            RobotConfig::of(&RobotDescription::default(), camera, mission.policy, mission.seed);
        assert_eq!(config.robot(&mission), of_scenarios);
    }

    #[test]
    fn without_a_model_the_map_uses_dense_depth_and_coarse_depth_if_that_is_off() {
        let on = DenseConfig::default();
        let off = DenseConfig { enabled: false, ..DenseConfig::default() };
        assert_eq!(depth_source(None, false, &on).unwrap(), DepthSource::Dense);
        assert_eq!(depth_source(None, false, &off).unwrap(), DepthSource::Coarse);
        assert_eq!(depth_source(None, true, &on).unwrap(), DepthSource::Network);
        let coarse = Some(DepthSource::Coarse);
        assert_eq!(depth_source(coarse, true, &on).unwrap(), DepthSource::Coarse);
    }

    #[test]
    fn dense_depth_that_is_off_and_a_network_that_is_missing_are_refused_with_the_way_out() {
        let off = DenseConfig { enabled: false, ..DenseConfig::default() };
        let dense = depth_source(Some(DepthSource::Dense), false, &off).unwrap_err();
        assert!(dense.to_string().contains("`dense.enabled = true`"), "{dense}");
        let network = depth_source(Some(DepthSource::Network), false, &off).unwrap_err();
        assert!(network.to_string().contains("--model FILE"), "{network}");
    }
}
