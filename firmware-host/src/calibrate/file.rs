//! `calibration.toml`: what was measured, for a robot's configuration to include.

use std::fmt::Write as _;

use super::finding::{Finding, Nature};

/// Where measured values come from.
#[derive(Debug, Clone, PartialEq)]
pub struct Provenance {
    /// Name of the recording.
    pub drive: String,
    /// Date and time of the measurement.
    pub date: String,
    /// Program and version.
    pub software: String,
}

/// The text of the file: a section for each section of the configuration, and a comment with the standard deviation and the old
/// value for each key. Parameters that the drive did not show, or that have no key, are left out.
pub fn text(findings: &[Finding], provenance: &Provenance) -> String {
    let Provenance { drive, date, software } = provenance;
    let mut text = format!(
        "# Measured by `firmware-host calibrate` ({software}) on {date}\n# from {drive}.\n\
         # The robot's configuration includes this file with a line at its top:\n\
         # calibration = \"calibration.toml\"\n"
    );
    let mut sections: Vec<&str> = Vec::new();
    for finding in findings {
        if let Some((section, _)) = place(finding)
            && !sections.contains(&section)
        {
            sections.push(section);
        }
    }
    for section in sections {
        // Writing into a String cannot fail.
        let _ = write!(text, "\n[{section}]\n");
        for finding in findings {
            if let Some((of, key)) = place(finding)
                && of == section
            {
                let Nature { unit, decimals, .. } = finding.parameter.nature();
                let Finding { old, new, sigma, .. } = finding;
                let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
                let _ = writeln!(
                    text,
                    "# +- {sigma:.decimals$}{unit} (standard deviation); was {old:.decimals$}\n{key} = {new:.decimals$}"
                );
            }
        }
    }
    text
}

/// Section and name of a finding's key, if it is to be written.
fn place(finding: &Finding) -> Option<(&'static str, &'static str)> {
    finding.parameter.nature().key.filter(|_| finding.is_written())?.rsplit_once('.')
}

#[cfg(test)]
mod tests {
    use super::super::finding::Parameter;
    use super::*;
    use crate::config::Config;
    use std::path::Path;

    fn finding(parameter: Parameter, new: f64, sigma: f64) -> Finding {
        Finding { parameter, old: 0.0, new, sigma }
    }

    fn written(findings: &[Finding]) -> String {
        let provenance = Provenance {
            drive: "runs/1".to_owned(),
            date: "2026-11-25".to_owned(),
            software: "firmware-host 1.0.0".to_owned(),
        };
        text(findings, &provenance)
    }

    #[test]
    fn the_file_is_a_configuration_that_says_what_was_measured_and_how_well() {
        let text = written(&[
            finding(Parameter::LidarYaw, 4.25, 0.05),
            finding(Parameter::CameraYaw, -1.5, 0.1),
            finding(Parameter::LidarLeft, 0.012, 0.001),
        ]);
        let config = Config::parse(&text, Path::new("calibration.toml")).unwrap();
        assert_eq!((config.lidar.yaw_deg, config.lidar.left_m), (4.25, 0.012));
        assert_eq!(config.camera.yaw_deg, -1.5);
        assert!(text.contains("runs/1") && text.contains("firmware-host 1.0.0"), "{text}");
        assert!(text.contains("# +- 0.05 deg (standard deviation); was 0.00\nyaw_deg = 4.25"));
    }

    #[test]
    fn what_the_drive_did_not_show_is_not_written() {
        let text = written(&[
            finding(Parameter::LidarForward, 0.2, 1.0),
            finding(Parameter::FocalLength, 1.0, 0.001),
            finding(Parameter::LidarLatency, -0.5, 1.0),
        ]);
        assert_eq!(toml::from_str::<toml::Table>(&text).unwrap(), toml::Table::new());
    }
}
