//! The key `calibration` at the top of a configuration: the name of a file with measured values.
//!
//! `firmware-host calibrate` writes that file. Its values replace those of the configuration, so that a file written by a person
//! and one written by a program stay apart. The key is no part of [`Config`](super::Config): what counts, and what recordings
//! hold, are the values in effect.

use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::{ConfigError, check, refuse_if_any};

/// Name of the key.
pub const KEY: &str = "calibration";

/// Takes the key out of a configuration, and returns the file that it names, relative to the folder of the configuration.
pub(super) fn take(
    document: &mut DeTable<'_>,
    path: &Path,
    text: &str,
) -> Result<Option<PathBuf>, ConfigError> {
    let Some((name, value)) = document.remove_entry(KEY) else { return Ok(None) };
    match value.get_ref() {
        DeValue::String(file) => {
            let folder = path.parent().unwrap_or(Path::new(""));
            Ok(Some(folder.join(file.as_ref())))
        }
        _ => {
            let before = &text.as_bytes()[..name.span().start];
            let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
            Err(ConfigError::CalibrationKey { path: path.to_path_buf(), line })
        }
    }
}

/// Reads a calibration file as a table of the configuration's keys.
pub(super) fn read(path: &Path, named_by: &Path) -> Result<Table, ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|source| ConfigError::NoCalibration {
        path: path.to_path_buf(),
        named_by: named_by.to_path_buf(),
        source,
    })?;
    let document = DeTable::parse(&text).map_err(|error| ConfigError::not_toml(path, &error))?;
    refuse_if_any(check::file(document.get_ref(), &text), path)?;
    text.parse().map_err(|error| ConfigError::not_toml(path, &error))
}

/// Replaces the values in `config` by those of the same keys in `measured`.
pub(super) fn overlay(config: &mut Table, measured: Table) {
    for (name, value) in measured {
        match (config.get_mut(&name), value) {
            (Some(Value::Table(inner)), Value::Table(measured)) => overlay(inner, measured),
            (_, value) => {
                config.insert(name, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::super::Config;
    use super::*;

    /// What is loaded from a folder with both files.
    fn loaded(robot: &str, calibration: &str) -> Result<Config, ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot.toml");
        fs::write(&path, robot).unwrap();
        fs::write(folder.path().join("calibration.toml"), calibration).unwrap();
        Config::load(&path)
    }

    const ROBOT: &str =
        "calibration = \"calibration.toml\"\n[camera]\nheight_m = 0.7\nwidth = 320\n";

    #[test]
    fn measured_values_replace_configured_ones_and_the_others_stay() {
        let config = loaded(ROBOT, "[camera]\nheight_m = 0.71\n[lidar]\nleft_m = 0.01\n").unwrap();
        assert_eq!((config.camera.height_m, config.camera.width), (0.71, 320));
        assert_eq!(config.lidar.left_m, 0.01);
    }

    #[test]
    fn a_missing_file_is_refused_with_its_name_and_the_file_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot.toml");
        fs::write(&path, ROBOT).unwrap();
        let error = Config::load(&path).unwrap_err().to_string();
        assert!(error.contains("calibration.toml") && error.contains("robot.toml"), "{error}");
    }

    #[test]
    fn a_wrong_value_is_refused_with_the_line_of_its_own_file() {
        let error = loaded(ROBOT, "[camera]\nheight_m = 30.0\n").unwrap_err().to_string();
        assert!(error.contains("calibration.toml line 2"), "{error}");
        let error = loaded(ROBOT, "[camera]\nheigth_m = 0.7\n").unwrap_err().to_string();
        assert!(error.contains("calibration.toml line 2"), "{error}");
    }

    #[test]
    fn a_name_that_is_no_text_is_refused() {
        let error = loaded("\ncalibration = 5\n", "").unwrap_err().to_string();
        assert!(error.contains("line 2") && error.contains("calibration"), "{error}");
    }
}
