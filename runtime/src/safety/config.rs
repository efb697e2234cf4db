//! Sizes, speeds and time limits of the safety plane.

use serde::{Deserialize, Serialize};

/// Beams that meet the robot's own body: between two directions, up to a distance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodySector {
    /// First direction in the `laser` frame, degrees, counter-clockwise.
    pub from_deg: f64,
    /// Last direction, degrees, not before `from_deg`.
    pub to_deg: f64,
    /// Returns up to this distance are the robot itself, metres.
    pub up_to_m: f64,
}

/// Sizes, speeds and time limits of the safety plane.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SafetyConfig {
    /// Radius of the round footprint, metres. Of a footprint with corners it is ignored.
    pub footprint_radius_m: f64,
    /// Corners of the footprint in `base_link`, in order, metres; empty: it is round.
    pub footprint_m: Vec<[f64; 2]>,
    /// Beams that meet the robot's own body. They are blind, not free.
    pub body: Vec<BodySector>,
    /// Where the laser sits in front of `base_link`'s origin, metres.
    pub laser_forward_m: f64,
    /// Free way that is left in front of the footprint when the robot has stopped, metres (0.1 in the paper).
    pub stop_distance_m: f64,
    /// Time from a beam to the wheels' first answer, seconds. A simulated base answers at once.
    pub reaction_s: f64,
    /// How hard the base brakes, m/s2. A simulated base stops within a step.
    pub brake_mps2: f64,
    /// How far it backs off, metres by wheel odometry.
    pub back_off_m: f64,
    /// Of these, so much over ground that nobody has looked at, metres.
    pub blind_back_off_m: f64,
    /// What was seen of the ground behind counts for so long, seconds.
    pub rear_memory_s: f64,
    /// Backing-off speed, m/s.
    pub back_off_mps: f64,
    /// Turn rate while escaping, rad/s.
    pub escape_radps: f64,
    /// Backing off ends after this time, whatever the wheels say, seconds.
    pub back_off_timeout_s: f64,
    /// So long after the end of a scan it is no longer driven by, seconds: two periods of the scanner.
    pub scan_timeout_s: f64,
    /// Scans in a row that must be good before the robot drives by them.
    pub good_scans: u32,
    /// Wheel feedback older than this stops the robot, seconds.
    pub feedback_timeout_s: f64,
    /// A plan older than this is no longer driven by, seconds.
    pub plan_timeout_s: f64,
    /// Time between two calls, seconds. A call that is later than two of them stops the robot.
    pub period_s: f64,
}

impl Default for SafetyConfig {
    /// For the simulated robot, which turns the safety plane once a step.
    fn default() -> Self {
        Self {
            footprint_radius_m: 0.16,
            footprint_m: Vec::new(),
            body: Vec::new(),
            laser_forward_m: 0.0,
            stop_distance_m: 0.1,
            reaction_s: 0.0,
            brake_mps2: 100.0,
            back_off_m: 0.2,
            blind_back_off_m: 0.05,
            rear_memory_s: 30.0,
            back_off_mps: 0.3,
            escape_radps: 20f64.to_radians(),
            back_off_timeout_s: 5.0,
            scan_timeout_s: 0.2,
            good_scans: 1,
            feedback_timeout_s: 0.2,
            plan_timeout_s: 0.3,
            period_s: 0.1,
        }
    }
}
