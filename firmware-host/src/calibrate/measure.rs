//! All measurements of one drive.

use anyhow::Result;

use super::base_path::BasePath;
use super::camera::{CameraError, CameraFit};
use super::camera_parameters::{self, CameraParameters};
use super::drive::{CameraDrive, Drive};
use super::finding::{Finding, Parameter};
use super::floor;
use super::laser::{self, Residuals};
use super::laser_parameters::LaserParameters;

/// What a drive says about the robot.
#[derive(Debug)]
pub struct Measured {
    /// One finding for each parameter that was estimated; old values are those with which the drive was recorded.
    pub findings: Vec<Finding>,
    /// How much wheels and scans disagree with the configuration, and with the result.
    pub before: Residuals,
    pub after: Residuals,
    /// Compared spans: of the yaw, and of the translation.
    pub spans: [usize; 2],
    /// Robust deviation of a followed point before and after, pixels; `None` without a measured camera.
    pub points_px: Option<[f64; 2]>,
    /// Why the camera was not measured.
    pub no_camera: Option<String>,
}

/// Measures everything that a drive shows.
///
/// # Errors
/// Wheels and scans that cannot be compared. A camera that cannot be measured is reported in the result.
pub fn measure(drive: &Drive, camera: Option<&CameraDrive>) -> Result<Measured> {
    let result = laser::estimate(drive)?;
    let mut measured = Measured {
        findings: laser_findings(drive, &result.estimate),
        before: result.before,
        after: result.after,
        spans: result.spans,
        points_px: None,
        no_camera: None,
    };
    let Some(camera) = camera else { return Ok(measured) };
    let base = BasePath::new(&drive.wheels, &result.path, &result.parameters);
    let quiet = laser::quiet(&result.path, &result.parameters);
    let quiet = BasePath::new(&quiet, &result.path, &result.parameters);
    let late_s = result.estimate.sigma(laser::LATENCY);
    if let Err(error) = measure_camera(camera, [&base, &quiet], late_s, &mut measured) {
        measured.no_camera = Some(error.to_string());
    }
    Ok(measured)
}

/// `late_s` is the standard deviation of the scanner's latency, by which the whole path may be late.
fn measure_camera(
    camera: &CameraDrive,
    base: [&BasePath<'_>; 2],
    late_s: f64,
    measured: &mut Measured,
) -> Result<(), CameraError> {
    let configured = CameraParameters::configured(&camera.t_base_camera);
    let height_m = camera.t_base_camera.translation.z;
    let mut fit = CameraFit::new(camera.model, height_m, base, &camera.pairs);
    let before_px = fit.spread_px(&configured);
    let estimate = fit.estimate(&configured)?;
    let at = CameraParameters::from_vector(&estimate.parameters);
    measured.points_px = Some([before_px, fit.spread_px(&at)]);
    let old = configured.to_vector();
    for (index, (parameter, unit)) in CAMERA.into_iter().enumerate() {
        let sigma = match parameter {
            Parameter::CameraLatency => estimate.sigma(index).hypot(late_s),
            _ => estimate.sigma(index),
        };
        measured.findings.push(Finding {
            parameter,
            old: unit * old[index],
            new: unit * estimate.parameters[index],
            sigma: unit * sigma,
        });
    }
    // A drive that shows no floor leaves the height as it is.
    let [new, sigma] =
        floor::height(&fit.low_points(&at), height_m).unwrap_or([height_m, f64::INFINITY]);
    measured.findings.push(Finding {
        parameter: Parameter::CameraHeight,
        old: height_m,
        new,
        sigma,
    });
    Ok(())
}

const DEGREES: f64 = 180.0 / std::f64::consts::PI;
const MILLISECONDS: f64 = 1000.0;

/// The parameters of the fits in their order, with their units.
const LASER: [(Parameter, f64); laser::PARAMETERS] = [
    (Parameter::LeftRadius, 1.0),
    (Parameter::RightRadius, 1.0),
    (Parameter::Track, 1.0),
    (Parameter::LidarForward, 1.0),
    (Parameter::LidarLeft, 1.0),
    (Parameter::LidarYaw, DEGREES),
    (Parameter::LidarLatency, MILLISECONDS),
];
const CAMERA: [(Parameter, f64); camera_parameters::PARAMETERS] = [
    (Parameter::CameraRoll, DEGREES),
    (Parameter::CameraPitch, DEGREES),
    (Parameter::CameraYaw, DEGREES),
    (Parameter::CameraForward, 1.0),
    (Parameter::CameraLeft, 1.0),
    (Parameter::FocalLength, 1.0),
    (Parameter::CameraLatency, MILLISECONDS),
];

fn laser_findings(drive: &Drive, estimate: &super::least_squares::Estimate) -> Vec<Finding> {
    let old = LaserParameters::configured(&drive.configured).to_vector();
    let mut findings = Vec::new();
    for (index, (parameter, unit)) in LASER.into_iter().enumerate() {
        findings.push(Finding {
            parameter,
            old: unit * old[index],
            new: unit * estimate.parameters[index],
            sigma: unit * estimate.sigma(index),
        });
    }
    findings
}
