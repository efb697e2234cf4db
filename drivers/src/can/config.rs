//! Configuration of the base.

use serde::{Deserialize, Serialize};

use super::error::CanError;
use super::limits::LimitConfig;
use super::protocol::MotorProtocol;
use super::protocol::cia402::{Cia402, Cia402Node};
use super::protocol::odrive::{Odrive, OdriveNode};
use super::protocol::vesc::{Vesc, VescNode};

/// What the motor controllers speak.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// ODrive CANSimple.
    Odrive,
    /// VESC.
    Vesc,
    /// CANopen drives, CiA 402.
    Cia402,
}

/// A base with two driven wheels on a CAN bus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BaseConfig {
    /// Interface name (`can0`), or `unix:PATH` for simulated devices.
    pub bus: String,
    /// What the controllers speak.
    pub protocol: Protocol,
    /// Node of the left wheel.
    pub left_node: u8,
    /// Node of the right wheel.
    pub right_node: u8,
    /// The two nodes are mounted the other way round.
    pub swap_wheels: bool,
    /// The left wheel's motor turns backwards at a positive velocity.
    pub invert_left: bool,
    /// The right wheel's motor turns backwards at a positive velocity.
    pub invert_right: bool,
    /// Wheel radius, metres.
    pub wheel_radius_m: f64,
    /// Distance between the wheels' contact points, metres.
    pub track_m: f64,
    /// Turns of the motor per turn of the wheel.
    pub gear_ratio: f64,
    /// The controllers' own watchdog, ms: at most 100.
    pub watchdog_ms: u32,
    /// Feedback older than this is none, ms.
    pub feedback_timeout_ms: u32,
    /// A plan older than this moves nothing, ms.
    pub plan_age_limit_ms: u32,
    /// A safety board sends emergency stop and bumper; its silence is an emergency stop.
    pub safety_board: bool,
    /// Odometry: variance per metre of one wheel's travel, metres.
    pub slip_m: f64,
    /// Velocities and accelerations.
    pub limits: LimitConfig,
    /// What only ODrive needs.
    pub odrive: OdriveConfig,
    /// What only VESC needs.
    pub vesc: VescConfig,
    /// What only CiA 402 needs.
    pub cia402: Cia402Config,
}

/// What only ODrive needs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdriveConfig {
    /// Firmware that the endpoints belong to: major, minor, revision.
    pub firmware: [u8; 3],
    /// `axis0.config.enable_watchdog` in that firmware's `flat_endpoints.json`; 0 is not set.
    pub enable_watchdog_endpoint: u16,
    /// `axis0.config.watchdog_timeout` there; 0 is not set.
    pub watchdog_timeout_endpoint: u16,
}

/// What only VESC needs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VescConfig {
    /// Pole pairs of the motors.
    pub pole_pairs: u8,
    /// Brake current at zero velocity, A.
    pub brake_a: f64,
    /// The id that the left VESC answers to; the right one answers to the next.
    pub host_id: u8,
}

/// What only CiA 402 needs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Cia402Config {
    /// Our node id.
    pub host_node: u8,
    /// Units of the drive's velocities at one turn of the motor per second: 60 for rpm, counts per turn for counts/s.
    pub velocity_units: f64,
    /// Units of the drive's positions per turn of the motor.
    pub position_units: f64,
}

impl Default for BaseConfig {
    fn default() -> Self {
        Self {
            bus: "can0".to_owned(),
            protocol: Protocol::Odrive,
            left_node: 1,
            right_node: 2,
            swap_wheels: false,
            invert_left: false,
            invert_right: false,
            wheel_radius_m: 0.05,
            track_m: 0.24,
            gear_ratio: 1.0,
            watchdog_ms: 100,
            feedback_timeout_ms: 100,
            plan_age_limit_ms: 500,
            safety_board: false,
            slip_m: 1e-4,
            limits: LimitConfig::default(),
            odrive: OdriveConfig::default(),
            vesc: VescConfig::default(),
            cia402: Cia402Config::default(),
        }
    }
}

impl Default for OdriveConfig {
    fn default() -> Self {
        Self { firmware: [0, 6, 10], enable_watchdog_endpoint: 0, watchdog_timeout_endpoint: 0 }
    }
}

impl Default for VescConfig {
    fn default() -> Self {
        Self { pole_pairs: 7, brake_a: 5.0, host_id: 252 }
    }
}

impl Default for Cia402Config {
    fn default() -> Self {
        Self { host_node: 127, velocity_units: 4096.0, position_units: 4096.0 }
    }
}

fn within(field: &'static str, value: f64, low: f64, high: f64) -> Result<(), CanError> {
    // A NaN lies in no range.
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(CanError::Config { field, value: value.to_string(), allowed: format!("{low} to {high}") })
}

impl BaseConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`CanError::Config`] with the first field that is out of its range.
    pub fn validate(&self) -> Result<(), CanError> {
        let limits = &self.limits;
        if self.bus.is_empty() || self.bus == "unix:" {
            let allowed = "an interface such as can0, or unix:PATH".to_owned();
            return Err(CanError::Config { field: "bus", value: self.bus.clone(), allowed });
        }
        within("wheel_radius_m", self.wheel_radius_m, 0.005, 1.0)?;
        within("track_m", self.track_m, 0.03, 3.0)?;
        within("gear_ratio", self.gear_ratio, 0.01, 1000.0)?;
        within("watchdog_ms", f64::from(self.watchdog_ms), 20.0, 100.0)?;
        within("feedback_timeout_ms", f64::from(self.feedback_timeout_ms), 20.0, 100.0)?;
        within("plan_age_limit_ms", f64::from(self.plan_age_limit_ms), 20.0, 5000.0)?;
        within("slip_m", self.slip_m, 0.0, 0.1)?;
        within("limits.linear_mps", limits.linear_mps, 0.01, 5.0)?;
        within("limits.angular_radps", limits.angular_radps, 0.01, 20.0)?;
        within("limits.acceleration_mps2", limits.acceleration_mps2, 0.01, 20.0)?;
        within(
            "limits.deceleration_mps2",
            limits.deceleration_mps2,
            limits.acceleration_mps2,
            50.0,
        )?;
        within(
            "limits.angular_acceleration_radps2",
            limits.angular_acceleration_radps2,
            0.01,
            100.0,
        )?;
        let (low, value) = (limits.angular_acceleration_radps2, limits.angular_deceleration_radps2);
        within("limits.angular_deceleration_radps2", value, low, 200.0)?;
        within("limits.jerk_time_s", limits.jerk_time_s, 0.0, 2.0)?;
        self.validate_nodes()
    }

    fn validate_nodes(&self) -> Result<(), CanError> {
        let (low, high) = match self.protocol {
            Protocol::Odrive => (0, 62),
            Protocol::Vesc => (0, 250),
            Protocol::Cia402 => (1, 126),
        };
        within("left_node", f64::from(self.left_node), f64::from(low), f64::from(high))?;
        within("right_node", f64::from(self.right_node), f64::from(low), f64::from(high))?;
        if self.left_node == self.right_node {
            let allowed = "another node than left_node".to_owned();
            return Err(CanError::Config {
                field: "right_node",
                value: self.right_node.to_string(),
                allowed,
            });
        }
        match self.protocol {
            Protocol::Odrive => {
                let odrive = &self.odrive;
                within(
                    "odrive.enable_watchdog_endpoint",
                    f64::from(odrive.enable_watchdog_endpoint),
                    1.0,
                    65535.0,
                )?;
                within(
                    "odrive.watchdog_timeout_endpoint",
                    f64::from(odrive.watchdog_timeout_endpoint),
                    1.0,
                    65535.0,
                )
            }
            Protocol::Vesc => {
                within("vesc.pole_pairs", f64::from(self.vesc.pole_pairs), 1.0, 100.0)?;
                within("vesc.brake_a", self.vesc.brake_a, 0.1, 200.0)?;
                let nodes = self.left_node.max(self.right_node);
                within("vesc.host_id", f64::from(self.vesc.host_id), f64::from(nodes) + 1.0, 253.0)
            }
            Protocol::Cia402 => {
                within("cia402.host_node", f64::from(self.cia402.host_node), 1.0, 127.0)?;
                if [self.left_node, self.right_node].contains(&self.cia402.host_node) {
                    let (value, allowed) =
                        (self.cia402.host_node.to_string(), "a node that no motor has".to_owned());
                    return Err(CanError::Config { field: "cia402.host_node", value, allowed });
                }
                within("cia402.velocity_units", self.cia402.velocity_units, 1.0, 1e7)?;
                within("cia402.position_units", self.cia402.position_units, 1.0, 1e7)
            }
        }
    }

    /// The motors, left and right.
    #[must_use]
    pub(super) fn motors(&self) -> [Box<dyn MotorProtocol>; 2] {
        let nodes = if self.swap_wheels {
            [self.right_node, self.left_node]
        } else {
            [self.left_node, self.right_node]
        };
        let [left, right] = nodes;
        [self.motor(left, true), self.motor(right, false)]
    }

    fn motor(&self, node: u8, is_first: bool) -> Box<dyn MotorProtocol> {
        match self.protocol {
            Protocol::Odrive => Box::new(Odrive::new(OdriveNode {
                node,
                firmware: self.odrive.firmware,
                enable_watchdog_endpoint: self.odrive.enable_watchdog_endpoint,
                watchdog_timeout_endpoint: self.odrive.watchdog_timeout_endpoint,
                watchdog_ms: self.watchdog_ms,
            })),
            Protocol::Vesc => Box::new(Vesc::new(VescNode {
                node,
                host: self.vesc.host_id.saturating_add(u8::from(!is_first)),
                pole_pairs: f64::from(self.vesc.pole_pairs),
                brake_a: self.vesc.brake_a,
                watchdog_ms: self.watchdog_ms,
            })),
            Protocol::Cia402 => Box::new(Cia402::new(Cia402Node {
                node,
                host: self.cia402.host_node,
                leads: is_first,
                watchdog_ms: self.watchdog_ms as u16,
                velocity_units: self.cia402.velocity_units,
                position_units: self.cia402.position_units,
            })),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sound() -> BaseConfig {
        let odrive = OdriveConfig {
            enable_watchdog_endpoint: 195,
            watchdog_timeout_endpoint: 196,
            ..Default::default()
        };
        BaseConfig { odrive, ..BaseConfig::default() }
    }

    #[test]
    fn an_error_names_the_field_the_value_and_the_range() {
        let error = BaseConfig { watchdog_ms: 250, ..sound() }.validate().expect_err("too long");
        assert_eq!(error.to_string(), "base: watchdog_ms is 250, allowed: 20 to 100");
        let error = BaseConfig { track_m: f64::NAN, ..sound() }.validate().expect_err("no number");
        assert_eq!(error.to_string(), "base: track_m is NaN, allowed: 0.03 to 3");
    }

    #[test]
    fn odrive_needs_endpoints_and_all_need_two_nodes() {
        assert!(sound().validate().is_ok());
        assert!(BaseConfig::default().validate().is_err());
        assert!(BaseConfig { right_node: 1, ..sound() }.validate().is_err());
        assert!(
            BaseConfig { protocol: Protocol::Vesc, ..BaseConfig::default() }.validate().is_ok()
        );
        assert!(
            BaseConfig { protocol: Protocol::Cia402, left_node: 127, ..BaseConfig::default() }
                .validate()
                .is_err()
        );
    }
}
