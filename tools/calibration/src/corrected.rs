//! Configurations of a robot before and after its calibration, in which depth can be compared.

use std::path::Path;

use anyhow::{Context, Result};
use firmware_host::calibrate::{Finding, Parameter};
use firmware_host::config::{Config, TruthSection};

use crate::truth;

/// Writes three configurations of robot number `seed`: as it was configured, as calibration found it, and a robot that is as the default
/// configuration says. The focal length is right in all of them, because calibration only checks it.
///
/// # Errors
/// When a file cannot be written.
pub fn write(dir: &Path, seed: u64, config: &Config, findings: &[Finding]) -> Result<()> {
    let mut nominal = config.clone();
    nominal.simulator.truth = TruthSection::default();
    let robots =
        [("before", config), ("after", &corrected(config, findings)), ("nominal", &nominal)];
    for (name, robot) in robots {
        let mut robot = robot.clone();
        robot.simulator.truth.focal_percent = 0.0;
        let file = dir.join(format!("{seed}-{name}.toml"));
        std::fs::write(&file, robot.to_toml()?).with_context(|| file.display().to_string())?;
    }
    Ok(())
}

/// The same robot with the measured values in its configuration. What is left of `[simulator.truth]` are the errors of the measurement.
fn corrected(config: &Config, findings: &[Finding]) -> Config {
    let mut corrected = config.clone();
    for finding in findings {
        if finding.is_written() {
            let truth = truth::value(config, finding.parameter);
            correct(&mut corrected, finding.parameter, finding.new, truth);
        }
    }
    corrected
}

fn correct(config: &mut Config, parameter: Parameter, new: f64, value: f64) {
    let Config { camera, lidar, simulator, .. } = config;
    let truth = &mut simulator.truth;
    let percent = 100.0 * (value / new - 1.0);
    let rest = value - new;
    // The simulated wheels and devices are configured by the defaults: their rests count alone.
    match parameter {
        Parameter::LeftRadius => truth.left_wheel_percent = percent,
        Parameter::RightRadius => truth.right_wheel_percent = percent,
        Parameter::Track => truth.track_percent = percent,
        Parameter::LidarLatency => truth.lidar_late_s = 1e-3 * rest,
        Parameter::CameraLatency => truth.camera_late_s = 1e-3 * rest,
        Parameter::LidarForward => {
            lidar.forward_m = new;
            truth.lidar_forward_m = rest;
        }
        Parameter::LidarLeft => {
            lidar.left_m = new;
            truth.lidar_left_m = rest;
        }
        Parameter::LidarYaw => {
            lidar.yaw_deg = new;
            truth.lidar_yaw_deg = rest;
        }
        Parameter::CameraRoll => {
            camera.roll_deg = new;
            truth.camera_roll_deg = rest;
        }
        Parameter::CameraPitch => {
            camera.pitch_down_deg = new;
            truth.camera_pitch_down_deg = rest;
        }
        Parameter::CameraYaw => {
            camera.yaw_deg = new;
            truth.camera_yaw_deg = rest;
        }
        Parameter::CameraForward => {
            camera.forward_m = new;
            truth.camera_forward_m = rest;
        }
        Parameter::CameraLeft => {
            camera.left_m = new;
            truth.camera_left_m = rest;
        }
        Parameter::CameraHeight => {
            camera.height_m = new;
            truth.camera_height_m = rest;
        }
        Parameter::FocalLength => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corrected_robot_is_the_same_robot_with_the_errors_of_its_measurement() {
        let config = truth::robot(4);
        let of = |parameter, error| {
            let value = truth::value(&config, parameter);
            Finding { parameter, old: 0.0, new: value + error, sigma: 0.01 }
        };
        let found = [of(Parameter::LidarYaw, 0.2), of(Parameter::CameraLatency, -3.0)];
        let robot = corrected(&config, &found);
        let [was, is] = [&config, &robot].map(|robot| truth::value(robot, Parameter::LidarYaw));
        assert!((was - is).abs() < 1e-12);
        assert!((robot.simulator.truth.lidar_yaw_deg + 0.2).abs() < 1e-12);
        assert!((robot.simulator.truth.camera_late_s - 0.003).abs() < 1e-12);
        let track = |robot: &Config| robot.simulator.truth.track_percent;
        assert!((track(&robot) - track(&config)).abs() < 1e-12, "it was not measured");
    }
}
