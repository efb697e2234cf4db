//! Dimensions, speeds and time limits of the safety plane.

use hal::settings::{ConfigValue, Kind};
use hal::{Pose2, RobotDescription};
use serde::{Deserialize, Serialize};

/// Beams that hit the robot's own body: between two directions, up to a distance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodySector {
    /// First direction in the `laser` frame, counter-clockwise.
    pub from_deg: f64,
    /// Last direction, not before `from_deg`.
    pub to_deg: f64,
    /// Returns up to this distance are the robot itself.
    pub up_to_m: f64,
}

impl ConfigValue for BodySector {
    const KIND: Kind = Kind::Other("{ from_deg = 120, to_deg = 135, up_to_m = 0.2 }");
}

/// Accuracy of the simulated scanner, a UTM-30LX, up to 10 m (data sheet: 30 mm). A real robot has that of its own scanner.
const LATERAL_MARGIN_M: f64 = 0.03;
/// The robot escapes slowly, because it does not know what it touches: 20 degrees per second.
const ESCAPE_RADPS: f64 = 20f64.to_radians();

hal::settings! {
    /// The safety plane, which checks every command before it reaches the wheels.
    pub struct SafetySection {
        /// The robot stops with this much free space left ahead of the footprint.
        stop_distance_m: f64 = 0.1, in 0.02..=2.0, unit "m", source "paper";
        /// Distance that the robot then backs off, by wheel odometry.
        back_off_m: f64 = 0.2, in 0.0..=2.0, unit "m";
        /// Part of that distance that it may drive over ground that the LiDAR has not observed. With 0 the robot then stands and
        /// rotates instead.
        blind_back_off_m: f64 = 0.0, in 0.0..=0.5, unit "m";
        /// Ground behind the robot is known to be free for this long after the LiDAR saw it, or after the robot left it. A person
        /// or an animal may have stepped onto it since then.
        rear_memory_s: f64 = 5.0, in 0.0..=300.0, unit "s",
            source "a person walks up from the edge of an ordinary room, 5 m away at 1 m/s";
        /// Backing off ends after this time, whatever the wheels report.
        back_off_timeout_s: f64 = 5.0, in 0.1..=60.0, unit "s";
        /// The robot does not drive by a scan that ended longer ago.
        scan_timeout_s: f64 = 0.2, in 0.02..=2.0, unit "s";
        /// Beams that hit the robot's own body. They count as blind, not as free.
        body: Vec<BodySector> = Vec::new();
        /// The robot stops, and a person has to arm it again, when the motor controllers report less than this for 5 s; 0 never
        /// stops it. For a lead battery of 24 V: 22, for lithium-ion cells: 3.3 for each in series.
        low_battery_v: f64 = 0.0, in 0.0..=100.0, unit "V";
        /// From this temperature of a motor or an inverter on the robot drives slower, down to a third at 15 degrees more; 0 never
        /// slows it.
        hot_c: f64 = 80.0, in 0.0..=150.0, unit "degrees Celsius",
            source "below the 85 degrees at which a VESC limits its current by default";
    }
}

/// The safety plane's configuration. [`SafetySection`] describes the values that it has in common with it.
#[derive(Debug, Clone, PartialEq)]
pub struct SafetyConfig {
    /// Radius of the round footprint; ignored if `footprint_m` has corners.
    pub footprint_radius_m: f64,
    /// Corners of the footprint in `base_link`, in order; empty for a round robot.
    pub footprint_m: Vec<[f64; 2]>,
    pub body: Vec<BodySector>,
    /// Pose of `laser` in `base_link`, in the scan plane.
    pub t_base_laser: Pose2,
    pub stop_distance_m: f64,
    /// An obstacle that passes the outline at less than this distance may touch it, because of the
    /// scanner's noise. The robot passes it slowly.
    pub lateral_margin_m: f64,
    /// Time from a beam to the first response of the wheels. A simulated base responds immediately.
    pub reaction_s: f64,
    /// Deceleration of the braking base. A simulated base stops within a step.
    pub brake_mps2: f64,
    pub back_off_m: f64,
    pub blind_back_off_m: f64,
    pub rear_memory_s: f64,
    /// Speed while backing off.
    pub back_off_mps: f64,
    /// Angular rate while escaping.
    pub escape_radps: f64,
    pub back_off_timeout_s: f64,
    /// The robot does not drive by a scan that ended longer ago: two periods of the scanner.
    pub scan_timeout_s: f64,
    /// Time by which scans are known later than their time stamps say. It is part of the time-out and of the reaction time.
    pub scan_late_s: f64,
    /// Consecutive valid scans that are needed before the robot drives.
    pub good_scans: u32,
    /// The robot stops when the wheel feedback is older than this.
    pub feedback_timeout_s: f64,
    /// The robot does not follow a plan that is older than this.
    pub plan_timeout_s: f64,
    /// The robot stops while the base reports a lower voltage; 0: never.
    pub low_battery_v: f64,
    /// Temperature from which the robot drives slower, degrees Celsius; 0: never.
    pub hot_c: f64,
    /// Time between two ticks of the safety plane. A tick that is later than two periods stops the robot.
    pub period_s: f64,
}

impl SafetySection {
    /// The configuration for a simulated base, which responds immediately, and a safety plane that runs once per action.
    #[must_use]
    pub fn safety_config(&self, robot: &RobotDescription) -> SafetyConfig {
        SafetyConfig {
            footprint_radius_m: robot.footprint_radius_m,
            footprint_m: robot.footprint_m.clone(),
            body: self.body.clone(),
            t_base_laser: robot.lidar.t_base_laser(),
            stop_distance_m: self.stop_distance_m,
            lateral_margin_m: LATERAL_MARGIN_M,
            reaction_s: 0.0,
            brake_mps2: 100.0,
            back_off_m: self.back_off_m,
            blind_back_off_m: self.blind_back_off_m,
            rear_memory_s: self.rear_memory_s,
            back_off_mps: robot.speed_mps(),
            escape_radps: robot.turn_radps().min(ESCAPE_RADPS),
            back_off_timeout_s: self.back_off_timeout_s,
            scan_timeout_s: self.scan_timeout_s,
            scan_late_s: 0.0,
            good_scans: 1,
            feedback_timeout_s: 0.2,
            plan_timeout_s: 0.3,
            low_battery_v: self.low_battery_v,
            hot_c: self.hot_c,
            period_s: robot.tick_s(),
        }
    }
}

impl Default for SafetyConfig {
    /// The configuration for the default simulated robot.
    fn default() -> Self {
        Self {
            // The speeds of the default robot, without the rounding error of dividing a step by a tick: recorded decisions
            // depend on every bit.
            back_off_mps: 0.3,
            escape_radps: ESCAPE_RADPS,
            ..SafetySection::default().safety_config(&RobotDescription::default())
        }
    }
}
