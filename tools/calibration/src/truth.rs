//! Robots that differ from their configuration.

use firmware_host::calibrate::Parameter;
use firmware_host::config::Config;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Largest differences: what a tape measure, a protractor and a cheap camera leave.
const WHEEL_PERCENT: f64 = 5.0;
const LIDAR_DEG: f64 = 5.0;
const CAMERA_DEG: f64 = 3.0;
const PLACE_M: f64 = 0.03;
const FOCAL_PERCENT: f64 = 2.0;
/// Time stamps are late, or early where too large a latency was subtracted.
const LATE_S: [f64; 2] = [-0.02, 0.12];

/// The configuration of robot number `seed`: the default, and in `[simulator.truth]` how the robot really is. Noise is that of the
/// default; systematic errors of the wheels are the known ones only.
pub fn robot(seed: u64) -> Config {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut config = Config::default();
    let simulator = &mut config.simulator;
    simulator.odometry_radius_error = 0.0;
    simulator.odometry_track_error = 0.0;
    simulator.odometry_heading_bias = 0.0;
    simulator.camera_latency_s = 0.0;
    let truth = &mut simulator.truth;
    // Both wheels are of one make: their mean is wrong, and each differs from it a little.
    let radius_percent = within(WHEEL_PERCENT - 1.0, &mut rng);
    truth.left_wheel_percent = radius_percent + within(1.0, &mut rng);
    truth.right_wheel_percent = radius_percent + within(1.0, &mut rng);
    truth.track_percent = within(WHEEL_PERCENT, &mut rng);
    truth.lidar_yaw_deg = within(LIDAR_DEG, &mut rng);
    truth.lidar_forward_m = within(PLACE_M, &mut rng);
    truth.lidar_left_m = within(PLACE_M, &mut rng);
    truth.camera_roll_deg = within(CAMERA_DEG, &mut rng);
    truth.camera_pitch_down_deg = within(CAMERA_DEG, &mut rng);
    truth.camera_yaw_deg = within(CAMERA_DEG, &mut rng);
    truth.camera_forward_m = within(PLACE_M, &mut rng);
    truth.camera_left_m = within(PLACE_M, &mut rng);
    truth.camera_height_m = within(PLACE_M, &mut rng);
    truth.focal_percent = within(FOCAL_PERCENT, &mut rng);
    truth.lidar_late_s = rng.random_range(LATE_S[0]..LATE_S[1]);
    truth.camera_late_s = rng.random_range(LATE_S[0]..LATE_S[1]);
    config
}

fn within(largest: f64, rng: &mut Pcg64Mcg) -> f64 {
    rng.random_range(-largest..largest)
}

/// The true value of a parameter, in the unit of its findings.
pub fn value(config: &Config, parameter: Parameter) -> f64 {
    let truth = &config.simulator.truth;
    let camera = truth.camera(config.camera.mount());
    let lidar = truth.lidar(config.lidar.mount());
    match parameter {
        Parameter::LeftRadius => 1.0 + truth.left_wheel_percent / 100.0,
        Parameter::RightRadius => 1.0 + truth.right_wheel_percent / 100.0,
        Parameter::Track => config.devices.base.track_m * (1.0 + truth.track_percent / 100.0),
        Parameter::LidarForward => lidar.forward_m,
        Parameter::LidarLeft => lidar.left_m,
        Parameter::LidarYaw => lidar.yaw_deg,
        Parameter::LidarLatency => 1000.0 * truth.lidar_late_s,
        Parameter::CameraRoll => camera.roll_deg,
        Parameter::CameraPitch => camera.pitch_down_deg,
        Parameter::CameraYaw => camera.yaw_deg,
        Parameter::CameraForward => camera.forward_m,
        Parameter::CameraLeft => camera.left_m,
        Parameter::CameraHeight => camera.height_m,
        Parameter::CameraLatency => 1000.0 * truth.camera_late_s,
        Parameter::FocalLength => 1.0 + truth.focal_percent / 100.0,
    }
}
