//! The robot's configuration: one TOML file in which every key is optional.
//!
//! Each key is declared once, by [`hal::settings!`], with its default, range, unit and description. The structs, the checks of a
//! file, `robot.default.toml` and `docs/configuration.md` follow from the declarations. An unknown key is refused with a
//! suggestion and a value out of range with its range, so that a typing error never becomes a silent default.

pub mod calibration;
mod check;
mod commissioning;
mod devices;
mod error;
mod live;
mod odometry;
#[cfg(test)]
mod reference;
mod sections;
#[cfg(feature = "simulator")]
mod simulated;
#[cfg(not(feature = "simulator"))]
mod without_simulator;

use std::path::Path;

use runtime::{
    exploration::ExplorationConfig,
    localization::LocalizationConfig,
    mapping::MapConfig,
    perception::{CoarseConfig, DenseConfig},
    planning::PlanningSection,
    safety::SafetySection,
};

pub use commissioning::Commissioning;
pub use devices::{DevicesSection, LensSection, RunSection};
pub use error::{ConfigError, Problem};
pub use live::LiveSection;
pub use odometry::Odometry;
pub use sections::{
    BaseSection, CameraSection, IdentitySection, LidarSection, ModelsSection, NetworkSection,
    RecordingSection,
};
#[cfg(feature = "simulator")]
pub use simulated::{SimulatorSection, TruthSection};
#[cfg(not(feature = "simulator"))]
pub use without_simulator::SimulatorSection;

/// The commented default configuration, which `firmware-host check` prints as a template.
pub const DEFAULT_FILE: &str = include_str!("../../robot.default.toml");

hal::settings! {
    /// The whole configuration.
    pub struct Config {
        camera: CameraSection;
        lidar: LidarSection;
        base: BaseSection;
        safety: SafetySection, was "bumper";
        coarse: CoarseConfig;
        dense: DenseConfig;
        localization: LocalizationConfig;
        map: MapConfig;
        planning: PlanningSection;
        exploration: ExplorationConfig;
        network: NetworkSection;
        models: ModelsSection;
        identity: IdentitySection;
        recording: RecordingSection;
        simulator: SimulatorSection;
        run: RunSection;
        live: LiveSection;
        devices: DevicesSection;
    }
}

impl Config {
    /// Reads a file, and the file of measured values that it names ([`calibration`]). Keys that are absent from both keep their
    /// defaults.
    ///
    /// # Errors
    /// When a file cannot be read, is not TOML, has an unknown key, or has a value that is not allowed.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.to_path_buf(), source })?;
        let mut document =
            toml::de::DeTable::parse(&text).map_err(|error| ConfigError::not_toml(path, &error))?;
        let Some(measured) = calibration::take(document.get_mut(), path, &text)? else {
            return Self::parse(&text, path);
        };
        refuse_if_any(check::file(document.get_ref(), &text), path)?;
        let mut table: toml::Table =
            text.parse().map_err(|error| ConfigError::not_toml(path, &error))?;
        table.remove(calibration::KEY);
        calibration::overlay(&mut table, calibration::read(&measured, path)?);
        let config: Self = table.try_into().map_err(|error| ConfigError::not_toml(path, &error))?;
        refuse_if_any(check::together(&config), path)?;
        Ok(config)
    }

    /// Parses the text of a file. `path` only names it in errors.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let document =
            toml::de::DeTable::parse(text).map_err(|error| ConfigError::not_toml(path, &error))?;
        refuse_if_any(check::file(document.get_ref(), text), path)?;
        let config: Self =
            toml::from_str(text).map_err(|error| ConfigError::not_toml(path, &error))?;
        refuse_if_any(check::together(&config), path)?;
        Ok(config)
    }

    /// Checks `[devices]` as the drivers do. Only a real robot needs it.
    ///
    /// # Errors
    /// What the drivers refuse; `path` names the file in the messages.
    pub fn check_devices(&self, path: &Path) -> Result<(), ConfigError> {
        refuse_if_any(check::devices(self), path)
    }

    /// Every key with its effective value, as TOML.
    ///
    /// # Errors
    /// Never for a configuration that was loaded.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }
}

fn refuse_if_any(problems: Vec<Problem>, path: &Path) -> Result<(), ConfigError> {
    if problems.is_empty() {
        return Ok(());
    }
    Err(ConfigError::Refused { path: path.to_path_buf(), problems })
}

#[cfg(test)]
mod tests;
