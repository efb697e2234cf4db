//! Smallest and largest value of every number in the configuration.

use std::fmt;

/// What a number may be, ends included.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limit {
    pub key: &'static str,
    pub min: f64,
    pub max: f64,
    pub unit: &'static str,
}

impl Limit {
    /// NaN is in no range.
    pub fn allows(&self, value: f64) -> bool {
        self.min <= value && value <= self.max
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {} {}", self.min, self.max, self.unit)
    }
}

/// The limit of a key; `None` for keys that hold no number.
pub(super) fn of(key: &str) -> Option<&'static Limit> {
    LIMITS.iter().find(|limit| limit.key == key)
}

const fn limit(key: &'static str, min: f64, max: f64, unit: &'static str) -> Limit {
    Limit { key, min, max, unit }
}

pub(super) const LIMITS: &[Limit] = &[
    limit("camera.width", 64.0, 4096.0, "pixels"),
    limit("camera.height", 32.0, 4096.0, "pixels"),
    limit("camera.horizontal_fov_deg", 20.0, 150.0, "degrees"),
    limit("camera.height_m", 0.05, 3.0, "metres"),
    limit("camera.forward_m", -1.0, 1.0, "metres"),
    limit("camera.pitch_down_deg", -60.0, 60.0, "degrees"),
    limit("lidar.height_m", 0.02, 3.0, "metres"),
    limit("lidar.forward_m", -1.0, 1.0, "metres"),
    limit("base.footprint_radius_m", 0.05, 1.0, "metres"),
    limit("base.forward_step_m", 0.005, 0.5, "metres"),
    limit("base.turn_step_deg", 0.1, 30.0, "degrees"),
    limit("base.tick_ms", 5.0, 1000.0, "milliseconds"),
    limit("bumper.stop_distance_m", 0.02, 2.0, "metres"),
    limit("bumper.back_off_m", 0.0, 2.0, "metres"),
    limit("bumper.back_off_timeout_s", 0.1, 60.0, "seconds"),
    limit("bumper.scan_timeout_s", 0.02, 2.0, "seconds"),
    limit("exploration.frontier_frames", 1.0, 1e6, "frames"),
    limit("exploration.inconsistency_frames", 1.0, 1e6, "frames"),
    limit("exploration.progress_timeout_s", 1.0, 3600.0, "seconds"),
    limit("exploration.blacklist_expiry_s", 1.0, 86400.0, "seconds"),
    limit("network.threads", 1.0, 256.0, "threads"),
    limit("recording.segment_s", 1.0, 3600.0, "seconds"),
    limit("recording.segment_mib", 1.0, 4096.0, "MiB"),
    limit("recording.depth_every_ticks", 1.0, 1e6, "ticks"),
    limit("recording.map_every_ticks", 1.0, 1e6, "ticks"),
    limit("simulator.odometry_distance_noise", 0.0, 0.2, "of the distance"),
    limit("simulator.odometry_turn_noise", 0.0, 0.2, "of the turn"),
    limit("simulator.lidar_noise_m", 0.0, 0.2, "metres"),
    limit("simulator.lidar_dropout", 0.0, 0.5, "of the beams"),
    limit("simulator.exposure_drift", 0.0, 1.0, "of the brightness"),
    limit("simulator.flicker", 0.0, 1.0, "of the brightness"),
    limit("simulator.sensor_noise", 0.0, 0.2, "of full scale"),
    limit("simulator.motion_blur", 0.0, 1.0, "of a tick"),
    limit("simulator.people", 0.0, 20.0, "people"),
];
