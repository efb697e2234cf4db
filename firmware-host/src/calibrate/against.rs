//! Findings in the words of a configuration: a drive was recorded with one, and the robot has another one now.

use crate::config::Config;

use super::finding::{Finding, Parameter};

/// A finding against the configuration `config`, for a drive that was recorded with `recorded`. The scales of the radii and the
/// latencies were found in addition to what was configured then.
pub(super) fn against(
    finding: &Finding,
    recorded: &Config,
    config: &Config,
    is_simulated: bool,
) -> Finding {
    let [then, now] = [&recorded.devices.base, &config.devices.base];
    let radius = then.wheel_radius_m / now.wheel_radius_m;
    let camera = &config.camera;
    let old = match finding.parameter {
        Parameter::LeftRadius => {
            return scaled(finding, radius * then.left_radius_scale, now.left_radius_scale);
        }
        Parameter::RightRadius => {
            return scaled(finding, radius * then.right_radius_scale, now.right_radius_scale);
        }
        // The simulated devices of `explore` do not use these settings.
        Parameter::CameraLatency if !is_simulated => {
            let [then, now] = [recorded, config].map(|config| config.devices.camera.latency_ms);
            return Finding { old: now, new: then + finding.new, ..*finding };
        }
        Parameter::LidarLatency if !is_simulated => {
            let [then, now] = [recorded, config].map(|config| config.devices.lidar.latency_ms);
            return Finding { old: now, new: then + finding.new, ..*finding };
        }
        Parameter::Track => now.track_m,
        Parameter::LidarForward => config.lidar.forward_m,
        Parameter::LidarLeft => config.lidar.left_m,
        Parameter::LidarYaw => config.lidar.yaw_deg,
        Parameter::CameraRoll => camera.roll_deg,
        Parameter::CameraPitch => camera.pitch_down_deg,
        Parameter::CameraYaw => camera.yaw_deg,
        Parameter::CameraForward => camera.forward_m,
        Parameter::CameraLeft => camera.left_m,
        Parameter::CameraHeight => camera.height_m,
        Parameter::LidarLatency | Parameter::CameraLatency | Parameter::FocalLength => finding.old,
    };
    Finding { old, ..*finding }
}

fn scaled(finding: &Finding, by: f64, old: f64) -> Finding {
    Finding { old, new: by * finding.new, sigma: by * finding.sigma, ..*finding }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_is_that_of_the_radius_which_is_configured_now() {
        let mut recorded = Config::default();
        recorded.devices.base.wheel_radius_m = 0.05;
        recorded.devices.base.left_radius_scale = 1.02;
        let mut now = Config::default();
        now.devices.base.wheel_radius_m = 0.051;
        let parameter = Parameter::LeftRadius;
        let finding = Finding { parameter, old: 1.0, new: 1.01, sigma: 0.001 };
        let found = against(&finding, &recorded, &now, false);
        let true_radius_m = 0.05 * 1.02 * 1.01;
        assert!((found.new * 0.051 - true_radius_m).abs() < 1e-12);
        assert!((found.old - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_latency_of_a_real_device_is_found_in_addition_to_the_configured_one() {
        let mut recorded = Config::default();
        recorded.devices.camera.latency_ms = 30.0;
        recorded.devices.lidar.latency_ms = 30.0;
        let mut now = recorded.clone();
        now.devices.camera.latency_ms = 50.0;
        now.devices.lidar.latency_ms = 50.0;
        for parameter in [Parameter::CameraLatency, Parameter::LidarLatency] {
            let finding = Finding { parameter, old: 0.0, new: 12.0, sigma: 1.0 };
            let real = against(&finding, &recorded, &now, false);
            assert_eq!((real.old, real.new), (50.0, 42.0));
            assert_eq!(against(&finding, &recorded, &now, true), finding);
        }
    }
}
