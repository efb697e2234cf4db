//! `[run]` and `[devices]`: what only a real robot has. What each key means, its range and its source stand in
//! `robot.default.toml`.

use drivers::can::BaseConfig;
use drivers::hokuyo::HokuyoConfig;
use drivers::v4l2::CameraDeviceConfig;
use hal::{CameraModel, Distortion};
use runtime::safety::SafetyConfig;
use serde::{Deserialize, Serialize};

use super::Config;

/// `[run]`: the loops of a real robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunSection {
    /// Turns of the safety loop in a second.
    pub safety_hz: f64,
    /// Real-time priority of the safety thread; 0: an ordinary thread.
    pub realtime_priority: u8,
    /// Whether the robot is armed as soon as its devices are well. Else it waits for SIGUSR1.
    pub arm_at_start: bool,
    /// Time from a beam to the wheels' first answer, seconds.
    pub reaction_s: f64,
    /// How hard the base brakes, m/s2.
    pub brake_mps2: f64,
    /// Scans in a row that must be good before the robot drives by them.
    pub good_scans: u32,
    /// Wheel feedback older than this stops the robot, seconds.
    pub feedback_timeout_s: f64,
    /// A plan older than this is no longer driven by, seconds.
    pub plan_timeout_s: f64,
    /// Without a picture for so long the robot stands, seconds.
    pub picture_timeout_s: f64,
    /// File that `health` reads.
    pub status_file: String,
}

impl Default for RunSection {
    fn default() -> Self {
        Self {
            safety_hz: 100.0,
            realtime_priority: 40,
            arm_at_start: true,
            reaction_s: 0.05,
            brake_mps2: 1.0,
            good_scans: 3,
            feedback_timeout_s: 0.1,
            plan_timeout_s: 0.5,
            picture_timeout_s: 1.0,
            status_file: "/run/embodied-depth/status.json".to_owned(),
        }
    }
}

/// `[devices]`: what is connected.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DevicesSection {
    /// The camera.
    pub camera: CameraDeviceConfig,
    /// Its lens.
    pub lens: LensSection,
    /// The scanner.
    pub lidar: HokuyoConfig,
    /// The base.
    pub base: BaseConfig,
}

/// `[devices.lens]`: the camera's intrinsics at the size of `[devices.camera]`, as a calibration gives them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LensSection {
    /// Focal lengths, pixels.
    pub fx: f64,
    /// Focal lengths, pixels.
    pub fy: f64,
    /// Optical axis, pixels.
    pub cx: f64,
    /// Optical axis, pixels.
    pub cy: f64,
    /// Distortion as OpenCV has it: none, five numbers (plumb bob) or four (fisheye).
    pub distortion: Vec<f64>,
}

impl Default for LensSection {
    fn default() -> Self {
        // A pinhole of 90 degrees at 640x480.
        Self { fx: 320.0, fy: 320.0, cx: 319.5, cy: 239.5, distortion: Vec::new() }
    }
}

impl DevicesSection {
    /// Intrinsics of the pictures that the camera hands out.
    ///
    /// # Errors
    /// Words for the user when the coefficients are neither none, five nor four.
    pub fn camera_model(&self) -> Result<CameraModel, String> {
        let lens = &self.lens;
        let distortion = match lens.distortion[..] {
            [] => Distortion::None,
            [k1, k2, k3, k4] => Distortion::Fisheye([k1, k2, k3, k4]),
            [k1, k2, p1, p2, k3] => Distortion::PlumbBob([k1, k2, p1, p2, k3]),
            _ => {
                return Err(format!(
                    "`distortion` has {} numbers: give none, four (fisheye: k1 k2 k3 k4) or five (plumb bob: k1 k2 p1 p2 k3)",
                    lens.distortion.len()
                ));
            }
        };
        Ok(CameraModel {
            width: self.camera.width as usize,
            height: self.camera.height as usize,
            fx: lens.fx,
            fy: lens.fy,
            cx: lens.cx,
            cy: lens.cy,
            distortion,
        })
    }
}

impl Config {
    /// The safety plane of a real robot: its wheels need time to stop, and its scanner is turned by itself.
    #[must_use]
    pub fn live_safety_config(&self) -> SafetyConfig {
        let run = &self.run;
        // Silence is known within two periods of the scanner, whatever else was allowed.
        let two_scans_s = 2e-9 * self.devices.lidar.model.geometry(false).period_ns as f64;
        SafetyConfig {
            reaction_s: run.reaction_s,
            brake_mps2: run.brake_mps2,
            good_scans: run.good_scans,
            feedback_timeout_s: run.feedback_timeout_s,
            plan_timeout_s: run.plan_timeout_s,
            scan_timeout_s: self.safety.scan_timeout_s.min(two_scans_s),
            period_s: 1.0 / run.safety_hz,
            ..self.safety_config()
        }
    }
}
