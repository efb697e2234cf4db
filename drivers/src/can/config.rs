//! Configuration of a base with two driven wheels on a CAN bus.

use hal::settings::OutOfRange;
use serde::{Deserialize, Serialize};

use super::error::{CanError, Side};
use super::protocol::MotorProtocol;
use super::protocol::cia402::{Cia402, Cia402Node};
use super::protocol::odrive::{Odrive, OdriveNode};
use super::protocol::vesc::{Vesc, VescNode};

/// The protocol of the motor controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// ODrive controllers, with the protocol CANSimple.
    Odrive,
    /// VESC controllers, with extended CAN frames.
    Vesc,
    /// CANopen drives, CiA 402.
    Cia402,
}

hal::choices!(Protocol: "odrive", "vesc", "cia402");

impl Protocol {
    /// The name as its makers write it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Odrive => "ODrive",
            Self::Vesc => "VESC",
            Self::Cia402 => "CiA 402",
        }
    }
}

hal::settings! {
    /// The base: two driven wheels on a CAN bus.
    pub struct BaseConfig {
        /// Interface name, or `unix:PATH` for simulated motors.
        bus: String = "can0".to_owned();
        /// Protocol of the motor controllers.
        protocol: Protocol = Protocol::Odrive;
        /// Node of the left wheel's controller. ODrive allows 0 to 62, VESC 0 to 250, CiA 402 1 to 126.
        left_node: u8 = 1, in 0..=250;
        /// Node of the right wheel's controller.
        right_node: u8 = 2, in 0..=250;
        /// Whether the two controllers are mounted on the opposite sides.
        swap_wheels: bool = false;
        /// Whether the left motor rotates backwards at a positive velocity.
        invert_left: bool = false;
        /// Whether the right motor rotates backwards at a positive velocity.
        invert_right: bool = false;
        /// Radius of the driven wheels.
        wheel_radius_m: f64 = 0.05, in 0.005..=1.0, unit "m";
        /// Radius of the left wheel by `wheel_radius_m`. `firmware-host calibrate` measures it.
        left_radius_scale: f64 = 1.0, in 0.5..=2.0;
        /// Radius of the right wheel by `wheel_radius_m`. `firmware-host calibrate` measures it.
        right_radius_scale: f64 = 1.0, in 0.5..=2.0;
        /// Distance between the contact points of the two wheels.
        track_m: f64 = 0.24, in 0.03..=3.0, unit "m";
        /// Revolutions of the motor per revolution of the wheel.
        gear_ratio: f64 = 1.0, in 0.01..=1000.0;
        /// The controllers stop the motors after this long without a command. The driver reads the value back before arming.
        watchdog_ms: u32 = 100, in 20..=100, unit "ms";
        /// Wheel feedback is not used when it is older than this.
        feedback_timeout_ms: u32 = 100, in 20..=100, unit "ms";
        /// The wheels do not follow a plan that is older than this.
        plan_age_limit_ms: u32 = 500, in 20..=5000, unit "ms";
        /// Whether a board on the bus sends emergency stop and bumper. Its silence is an emergency stop.
        safety_board: bool = false;
        /// Odometry: variance of one wheel's travel per metre.
        slip_m: f64 = 1e-4, in 0.0..=0.1, unit "m";
        limits: LimitConfig;
        odrive: OdriveConfig;
        vesc: VescConfig;
        cia402: Cia402Config;
    }
}

hal::settings! {
    /// The largest speeds and accelerations. A faster command becomes a slower one on the same arc. The defaults are those of
    /// the paper's robot: 0.3 m/s and 1 rad/s, from which it stops within 5 cm.
    #[derive(Copy)]
    pub struct LimitConfig {
        /// Largest speed.
        linear_mps: f64 = 0.3, in 0.01..=5.0, unit "m/s", source "paper";
        /// Largest angular rate.
        angular_radps: f64 = 1.0, in 0.01..=20.0, unit "rad/s", source "paper";
        /// Largest increase of the speed.
        acceleration_mps2: f64 = 0.5, in 0.01..=20.0, unit "m/s2";
        /// Largest decrease of the speed; not below the acceleration.
        deceleration_mps2: f64 = 1.0, in 0.01..=50.0, unit "m/s2";
        /// Largest increase of the angular rate.
        angular_acceleration_radps2: f64 = 2.0, in 0.01..=100.0, unit "rad/s2";
        /// Largest decrease of the angular rate; not below the acceleration.
        angular_deceleration_radps2: f64 = 4.0, in 0.01..=200.0, unit "rad/s2";
        /// Time until the full acceleration is reached: the jerk limit is the acceleration over this time. 0 sets no limit.
        /// Deceleration is never delayed.
        jerk_time_s: f64 = 0.1, in 0.0..=2.0, unit "s";
    }
}

hal::settings! {
    /// Used only with `protocol = "odrive"`.
    #[derive(Copy)]
    pub struct OdriveConfig {
        /// Firmware that the endpoints belong to: major, minor, revision.
        firmware: [u8; 3] = [0, 6, 10];
        /// Number of `axis0.config.enable_watchdog` in that firmware's `flat_endpoints.json`; 0 is not set.
        enable_watchdog_endpoint: u16 = 0, in 0..=65535;
        /// Number of `axis0.config.watchdog_timeout` in the same file; 0 is not set.
        watchdog_timeout_endpoint: u16 = 0, in 0..=65535;
    }
}

hal::settings! {
    /// Used only with `protocol = "vesc"`.
    #[derive(Copy)]
    pub struct VescConfig {
        /// Pole pairs of the motors.
        pole_pairs: u8 = 7, in 1..=100;
        /// Brake current at zero velocity.
        brake_a: f64 = 5.0, in 0.1..=200.0, unit "A";
        /// The id to which the left VESC sends its status; the right one sends it to the next id. Above both nodes.
        host_id: u8 = 252, in 1..=253;
    }
}

hal::settings! {
    /// Used only with `protocol = "cia402"`.
    #[derive(Copy)]
    pub struct Cia402Config {
        /// Node of this computer.
        host_node: u8 = 127, in 1..=127;
        /// Drive velocity units at one motor revolution per second: 60 for rpm, counts per revolution for counts/s.
        velocity_units: f64 = 4096.0, in 1.0..=10000000.0;
        /// Drive position units per motor revolution.
        position_units: f64 = 4096.0, in 1.0..=10000000.0;
    }
}

impl From<OutOfRange> for CanError {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        Self::Config { field: key, value: value.to_string(), allowed: allowed.to_owned() }
    }
}

fn within(field: &'static str, value: f64, low: f64, high: f64) -> Result<(), CanError> {
    // No range contains NaN.
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(CanError::Config { field, value: value.to_string(), allowed: format!("{low} to {high}") })
}

fn at_least_the_acceleration(
    field: &'static str,
    value: f64,
    acceleration: f64,
) -> Result<(), CanError> {
    if value >= acceleration {
        return Ok(());
    }
    let allowed = format!("at least the acceleration, {acceleration}");
    Err(CanError::Config { field, value: value.to_string(), allowed })
}

impl OdriveConfig {
    /// Without both endpoints the driver cannot set and confirm the watchdog.
    fn require_endpoints(&self) -> Result<(), CanError> {
        let endpoints = [
            (
                "odrive.enable_watchdog_endpoint",
                self.enable_watchdog_endpoint,
                "axis0.config.enable_watchdog",
            ),
            (
                "odrive.watchdog_timeout_endpoint",
                self.watchdog_timeout_endpoint,
                "axis0.config.watchdog_timeout",
            ),
        ];
        match endpoints.into_iter().find(|(_, number, _)| *number == 0) {
            None => Ok(()),
            Some((field, number, property)) => Err(CanError::Config {
                field,
                value: number.to_string(),
                allowed: format!(
                    "1 to 65535, the number of {property} in flat_endpoints.json of your firmware"
                ),
            }),
        }
    }
}

impl BaseConfig {
    /// Radius of one wheel, metres.
    #[must_use]
    pub fn radius_m(&self, side: Side) -> f64 {
        let scale = match side {
            Side::Left => self.left_radius_scale,
            Side::Right => self.right_radius_scale,
        };
        scale * self.wheel_radius_m
    }

    /// Checks every value, and the values together.
    ///
    /// # Errors
    /// [`CanError::Config`] with the first field that is not allowed.
    pub fn validate(&self) -> Result<(), CanError> {
        if self.bus.is_empty() || self.bus == "unix:" {
            let allowed = "an interface such as can0, or unix:PATH".to_owned();
            return Err(CanError::Config { field: "bus", value: self.bus.clone(), allowed });
        }
        self.check_ranges()?;
        let limits = &self.limits;
        at_least_the_acceleration(
            "limits.deceleration_mps2",
            limits.deceleration_mps2,
            limits.acceleration_mps2,
        )?;
        at_least_the_acceleration(
            "limits.angular_deceleration_radps2",
            limits.angular_deceleration_radps2,
            limits.angular_acceleration_radps2,
        )?;
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
            Protocol::Odrive => self.odrive.require_endpoints(),
            Protocol::Vesc => {
                let nodes = self.left_node.max(self.right_node);
                within("vesc.host_id", f64::from(self.vesc.host_id), f64::from(nodes) + 1.0, 253.0)
            }
            Protocol::Cia402 => {
                if [self.left_node, self.right_node].contains(&self.cia402.host_node) {
                    return Err(CanError::Config {
                        field: "cia402.host_node",
                        value: self.cia402.host_node.to_string(),
                        allowed: "a node that no motor has".to_owned(),
                    });
                }
                Ok(())
            }
        }
    }

    /// The drivers of the left and the right motor.
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

    fn valid() -> BaseConfig {
        let odrive = OdriveConfig {
            enable_watchdog_endpoint: 195,
            watchdog_timeout_endpoint: 196,
            ..Default::default()
        };
        BaseConfig { odrive, ..BaseConfig::default() }
    }

    #[test]
    fn an_error_names_the_field_the_value_and_the_range() {
        let error = BaseConfig { watchdog_ms: 250, ..valid() }.validate().expect_err("too long");
        assert_eq!(error.to_string(), "base: watchdog_ms is 250, allowed: 20 to 100 ms");
        let error = BaseConfig { track_m: f64::NAN, ..valid() }.validate().expect_err("no number");
        assert_eq!(error.to_string(), "base: track_m is NaN, allowed: 0.03 to 3.0 m");
    }

    #[test]
    fn odrive_needs_endpoints_and_every_protocol_needs_two_nodes() {
        assert!(valid().validate().is_ok());
        assert!(BaseConfig::default().validate().is_err());
        assert!(BaseConfig { right_node: 1, ..valid() }.validate().is_err());
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
