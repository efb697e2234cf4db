//! What the safety plane assumes of the robot.

use drivers::can::Protocol;
use runtime::safety::SafetyConfig;

use crate::config::Config;

/// Highest speed of the course, m/s: from it, a base that brakes with 1 m/s2 stops within 2 cm.
const COURSE_MPS: f64 = 0.2;

/// The numbers that the safety plane works with.
#[derive(Debug, Clone, PartialEq)]
pub struct Assumed {
    pub safety: SafetyConfig,
    /// Speed of the course and of ordinary driving, m/s.
    pub course_mps: f64,
    pub top_mps: f64,
    /// Part of the reaction time until the scanner has seen an obstacle, seconds.
    pub sight_s: f64,
    pub coasts: bool,
    /// Yaw of the LiDAR as configured in `lidar.yaw_deg`, degrees.
    pub lidar_yaw_deg: f64,
}

impl Assumed {
    /// The assumptions that follow from a configuration.
    pub fn new(config: &Config) -> Self {
        let top_mps = config.base.speed_mps().min(config.devices.base.limits.linear_mps);
        Self {
            safety: config.live_safety_config(),
            course_mps: top_mps.min(COURSE_MPS),
            top_mps,
            sight_s: config.sight_s(),
            coasts: config.devices.base.protocol == Protocol::Odrive,
            lidar_yaw_deg: config.lidar.yaw_deg,
        }
    }
}
