//! The robot's configuration: one TOML file, every key optional.
//!
//! `robot.default.toml` beside this crate's manifest documents every key with its unit, range and source, and is tested to
//! equal [`Config::default`]. A key that does not exist is refused with a suggestion, a value out of its range with that
//! range, so that a typing error never becomes a silent default.

mod check;
mod devices;
mod error;
mod limits;
mod sections;

use std::path::Path;

use runtime::{exploration::ExplorationConfig, mapping::MapConfig, perception::CoarseConfig};
use serde::{Deserialize, Serialize};

pub use devices::{DevicesSection, LensSection, RunSection};
pub use error::{ConfigError, Problem};
pub use sections::{
    BaseSection, CameraSection, LidarSection, ModelsSection, NetworkSection, PlanningSection,
    RecordingSection, SafetySection, SimulatorSection,
};

/// The default configuration with its documentation, to print for a user who wants to start from it.
pub const DEFAULT_FILE: &str = include_str!("../../robot.default.toml");

/// Everything that can be configured.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The camera and its place on the robot.
    pub camera: CameraSection,
    /// The safety LiDAR's place on the robot.
    pub lidar: LidarSection,
    /// The drive base.
    pub base: BaseSection,
    /// What stands between every wish and the wheels.
    #[serde(alias = "bumper")]
    pub safety: SafetySection,
    /// Depth from ego-motion.
    pub coarse: CoarseConfig,
    /// The map.
    pub map: MapConfig,
    /// Paths and how they become motion.
    pub planning: PlanningSection,
    /// How goals are chosen and given up.
    pub exploration: ExplorationConfig,
    /// The depth network.
    pub network: NetworkSection,
    /// Signed models: where they are, what the gate and the trial ask for.
    pub models: ModelsSection,
    /// The recording.
    pub recording: RecordingSection,
    /// The simulated robot and home.
    pub simulator: SimulatorSection,
    /// The loops of a real robot.
    pub run: RunSection,
    /// What is connected to a real robot.
    pub devices: DevicesSection,
}

impl Config {
    /// Reads a file; keys that it does not set keep their defaults.
    ///
    /// # Errors
    /// When the file cannot be read, is not TOML, has a key that does not exist or a value that cannot be.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.to_path_buf(), source })?;
        Self::parse(&text, path)
    }

    /// Parses the text of a file; `path` only names it in errors.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let not_toml = |error: toml::de::Error| ConfigError::NotToml {
            path: path.to_path_buf(),
            message: error.to_string(),
        };
        let document = toml::de::DeTable::parse(text).map_err(not_toml)?;
        let problems = check::file(document.get_ref(), text);
        if !problems.is_empty() {
            return Err(ConfigError::Refused { path: path.to_path_buf(), problems });
        }
        let config: Self = toml::from_str(text).map_err(not_toml)?;
        let problems = check::together(&config);
        if problems.is_empty() {
            Ok(config)
        } else {
            Err(ConfigError::Refused { path: path.to_path_buf(), problems })
        }
    }

    /// Asks the drivers whether `[devices]` can be. A simulated robot has none.
    ///
    /// # Errors
    /// What they refuse; `path` names the file.
    pub fn check_devices(&self, path: &Path) -> Result<(), ConfigError> {
        let problems = check::devices(self);
        if problems.is_empty() {
            Ok(())
        } else {
            Err(ConfigError::Refused { path: path.to_path_buf(), problems })
        }
    }

    /// Every key with its effective value, as TOML.
    ///
    /// # Errors
    /// Never for a configuration that was loaded; the serializer's signature asks for it.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }
}

#[cfg(test)]
mod tests;
