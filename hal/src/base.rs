//! The drive base: commands to it, and the motion that it measured.

use crate::{ErrorType, pose::Pose2};

/// A planar velocity, expressed in `base_link`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Twist2 {
    /// Forward speed, m/s; negative is backwards.
    pub linear_mps: f64,
    /// Yaw rate, rad/s; positive is counter-clockwise (to the left).
    pub angular_radps: f64,
}

impl Twist2 {
    pub const ZERO: Self = Self { linear_mps: 0.0, angular_radps: 0.0 };

    /// Whether both components are finite. A command that is not finite must be refused, never
    /// clamped.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.linear_mps.is_finite() && self.angular_radps.is_finite()
    }

    /// The fastest twist within these limits, m/s and rad/s, that leads along the same arc.
    #[must_use]
    pub fn within(&self, most_mps: f64, most_radps: f64) -> Self {
        let over_v = self.linear_mps.abs() / most_mps;
        let over_w = self.angular_radps.abs() / most_radps;
        let scale = over_v.max(over_w).max(1.0).recip();
        Self { linear_mps: self.linear_mps * scale, angular_radps: self.angular_radps * scale }
    }

    /// The displacement after moving for `seconds` at this constant velocity, as `t_before_after`.
    /// Exact along the arc, not an Euler step.
    #[must_use]
    pub fn integrate(&self, seconds: f64) -> Pose2 {
        let yaw_rad = self.angular_radps * seconds;
        let length_m = self.linear_mps * seconds;
        // The chord of the arc, as shares of its length. Below 1e-6 rad the Taylor series is exact
        // in f64.
        let (along, across) = if yaw_rad.abs() < 1e-6 {
            (1.0 - yaw_rad * yaw_rad / 6.0, yaw_rad / 2.0)
        } else {
            let (sin, cos) = nalgebra::ComplexField::sin_cos(yaw_rad);
            (sin / yaw_rad, (1.0 - cos) / yaw_rad)
        };
        Pose2::new(length_m * along, length_m * across, yaw_rad)
    }
}

/// A velocity command with the data that lets a base refuse stale or repeated ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveCommand {
    /// The desired velocity.
    pub twist: Twist2,
    /// Increases by one with every command, so that the base can distinguish a live sender from a
    /// repeated frame.
    pub counter: u32,
    /// Age of the plan from which this command was computed. A base or a gate refuses commands
    /// whose plan is too old.
    pub plan_age_ns: u64,
}

/// The base's measurement of its own motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WheelFeedback {
    /// Time of the measurement on the monotonic clock.
    pub time_ns: u64,
    /// `t_odom_base`: dead reckoning since power-up. It has no jumps, but its drift is unbounded.
    pub odom: Pose2,
    pub twist: Twist2,
    /// The base touches an obstacle: a bumper switch is pressed, or the wheels are stalled.
    pub contact: bool,
    /// A cliff sensor in front of the wheels sees no floor.
    pub cliff: bool,
}

/// The supply and the temperature of a base, as its motor controllers report them. A value that
/// they do not report, or have not reported lately, is absent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PowerReport {
    /// Supply voltage; the lowest that a controller measures.
    pub voltage_v: Option<f64>,
    /// Current from the supply, all controllers together; negative while they feed it back.
    pub current_a: Option<f64>,
    /// The hottest motor or inverter, degrees Celsius.
    pub temperature_c: Option<f64>,
}

/// A stop that the base itself demands, beyond an error of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum StopCause {
    /// An emergency stop that the base reads is pressed.
    EmergencyStop,
    /// A board that reads the emergency stop is configured and sends nothing.
    SafetyBoardSilent,
    /// Motors that have been present since the start send nothing any more: they lost their power, or
    /// their cable.
    MotorsLost,
    /// The caller called the base later than its watchdog time allows, but nothing else is wrong.
    /// The base has to be armed again.
    LoopStalled,
}

/// A drive base that follows a planar twist, such as one with two driven wheels.
///
/// * *Blocking*: no method blocks. `drive` puts the command into a queue of length one, where a
///   newer command replaces it.
/// * *Command freshness*: the base stops when it receives no new command within its watchdog time
///   (at most 100 ms in the wheels' own controller). To keep moving, the caller must keep sending
///   commands.
/// * *Unplug*: `drive` and `poll_feedback` return [`Disconnected`](crate::ErrorKind::Disconnected)
///   until the driver has reopened the device. The base then does not move, and its odometry may
///   have restarted.
/// * *Retries*: the driver reopens the device. Neither the driver nor the caller repeats a refused
///   command, which would be stale by then.
pub trait Base: ErrorType {
    /// Requests that commands move the wheels. Returns true once they do. Powering the motors takes
    /// a while, so call this again until it returns true. A base that needs no arming returns true
    /// at once.
    ///
    /// # Errors
    /// The reason why the base cannot be armed, such as a controller that has not confirmed its own
    /// watchdog. Nothing moves then.
    fn arm(&mut self) -> Result<bool, Self::Error> {
        Ok(true)
    }

    /// Brakes, then removes power from the motors. Nothing moves until the next [`arm`](Self::arm).
    fn disarm(&mut self) {}

    /// Sets the desired velocity.
    ///
    /// # Errors
    /// [`Rejected`](crate::ErrorKind::Rejected) for a twist that is not finite or a base that is
    /// not armed.
    fn drive(&mut self, command: &DriveCommand) -> Result<(), Self::Error>;

    /// The stop that the base demands, as of its last call. While it is
    /// [`EmergencyStop`](StopCause::EmergencyStop) or
    /// [`SafetyBoardSilent`](StopCause::SafetyBoardSilent), the base moves on no command and cannot
    /// be armed.
    fn stop_cause(&self) -> Option<StopCause> {
        None
    }

    /// The supply and the temperature of the base, as of its last call; all absent for a base that
    /// does not measure them.
    fn power(&self) -> PowerReport {
        PowerReport::default()
    }

    /// Stops as fast as the base can. Accepted whenever the base is connected, armed or not.
    ///
    /// # Errors
    /// Only when the base cannot be reached. The base's own watchdog stops it in that case.
    fn stop(&mut self) -> Result<(), Self::Error>;

    /// The last call before the base is left alone: lets unpowered controllers stop waiting for
    /// commands, so that they do not report an expired watchdog.
    fn finish(&mut self) {}

    /// Returns the newest measurement, or `None` when it was returned before.
    ///
    /// # Errors
    /// [`Timeout`](crate::ErrorKind::Timeout) when the base has sent no measurement for longer than
    /// its feedback period allows.
    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Self::Error>;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_limited_twist_keeps_its_arc_and_its_directions(v in -3.0..3.0f64, w in -3.0..3.0f64) {
            let twist = Twist2 { linear_mps: v, angular_radps: w };
            let limited = twist.within(0.5, 1.0);
            prop_assert!(limited.linear_mps.abs() <= 0.5 + 1e-12);
            prop_assert!(limited.angular_radps.abs() <= 1.0 + 1e-12);
            prop_assert!((limited.linear_mps * w - limited.angular_radps * v).abs() < 1e-12);
            prop_assert!(limited.linear_mps * v >= 0.0 && limited.angular_radps * w >= 0.0);
            if v.abs() <= 0.5 && w.abs() <= 1.0 {
                prop_assert_eq!(limited, twist);
            }
        }
    }

    #[test]
    fn a_quarter_circle_to_the_left_ends_one_radius_ahead_and_one_radius_left() {
        let twist = Twist2 { linear_mps: 1.0, angular_radps: core::f64::consts::FRAC_PI_2 };
        let radius = 2.0 / core::f64::consts::PI;
        let end = twist.integrate(1.0);
        assert!((end.x_m - radius).abs() < 1e-12 && (end.y_m - radius).abs() < 1e-12);
        assert!((end.yaw_rad - core::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn two_half_steps_equal_one_whole_step(v in -1.0..1.0, w in -3.0..3.0) {
            let twist = Twist2 { linear_mps: v, angular_radps: w };
            let half = twist.integrate(0.5);
            let whole = twist.integrate(1.0);
            let both = half.compose(&half);
            prop_assert!(both.distance_m(&whole) < 1e-9);
            let yaw_error_rad = crate::wrap_angle(both.yaw_rad - whole.yaw_rad);
            prop_assert!(yaw_error_rad.abs() < 1e-9);
        }
    }
}
