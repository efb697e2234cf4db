//! The drive base.

use crate::{ErrorType, pose::Pose2};

/// Velocity in the plane, in `base_link`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Twist2 {
    /// Forward speed, m/s; negative is backwards.
    pub linear_mps: f64,
    /// Turn rate, rad/s; positive is counter-clockwise (left).
    pub angular_radps: f64,
}

impl Twist2 {
    /// Standing still.
    pub const ZERO: Self = Self { linear_mps: 0.0, angular_radps: 0.0 };

    /// Whether both numbers are finite. A command that is not must be refused, never clamped.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.linear_mps.is_finite() && self.angular_radps.is_finite()
    }

    /// The motion after `seconds` at this constant velocity: `t_before_after`, exact on the arc.
    #[must_use]
    pub fn integrate(&self, seconds: f64) -> Pose2 {
        let turn = self.angular_radps * seconds;
        let length = self.linear_mps * seconds;
        // Chord of the arc. Below 1e-6 rad the series is exact in f64.
        let (along, across) = if turn.abs() < 1e-6 {
            (1.0 - turn * turn / 6.0, turn / 2.0)
        } else {
            let (sin, cos) = nalgebra::ComplexField::sin_cos(turn);
            (sin / turn, (1.0 - cos) / turn)
        };
        Pose2::new(length * along, length * across, turn)
    }
}

/// One motion command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveCommand {
    /// Wanted velocity.
    pub twist: Twist2,
    /// Counts up by one with every command, so that the base can tell a live sender from a repeated frame.
    pub counter: u32,
    /// How old the plan behind this command is. A base or a gate refuses commands whose plan is too old.
    pub plan_age_ns: u64,
}

/// What the base measured of its own motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WheelFeedback {
    /// When it was measured, monotonic.
    pub time_ns: u64,
    /// `t_odom_base`: dead reckoning since power-up. Smooth, drifts without bound.
    pub odom: Pose2,
    /// Measured velocity.
    pub twist: Twist2,
    /// The base feels an obstacle: a bumper switch is pressed or the wheels are stalled.
    pub contact: bool,
}

/// A base with two driven wheels, or anything that follows a planar twist.
///
/// * *Blocking*: none; `drive` hands the command to the driver's queue of length one (a newer command replaces it).
/// * *Command freshness*: the base stops by itself when it gets no new command for its watchdog time (at most 100 ms on the
///   wheels' own controller). A caller that wants to keep moving keeps calling.
/// * *Unplug*: `drive` and `feedback` return [`Disconnected`](crate::ErrorKind::Disconnected) until the driver has
///   reopened it; the base is then at a stand and its odometry may have restarted.
/// * *Who retries*: the driver reopens; nobody repeats a command that was refused, because it is old by then.
pub trait Base: ErrorType {
    /// Asks that commands move the wheels, and tells whether they do now. Powering motors takes a while: call it again until it
    /// is true. A base that needs no arming always says so.
    ///
    /// # Errors
    /// What stands in the way, such as a controller that has not confirmed its own watchdog. Nothing moves then.
    fn arm(&mut self) -> Result<bool, Self::Error> {
        Ok(true)
    }

    /// Brakes and lets the motors go. Nothing moves until [`arm`](Self::arm).
    fn disarm(&mut self) {}

    /// Sets the wanted velocity.
    ///
    /// # Errors
    /// [`Rejected`](crate::ErrorKind::Rejected) for a twist that is not finite or a base that is not armed.
    fn drive(&mut self, command: &DriveCommand) -> Result<(), Self::Error>;

    /// Stops as fast as the base can. Always accepted while the base is connected.
    ///
    /// # Errors
    /// Only when the base cannot be reached; its own watchdog then stops it.
    fn stop(&mut self) -> Result<(), Self::Error>;

    /// The newest measurement that was not handed out before; `None` when there is no newer one.
    ///
    /// # Errors
    /// [`Timeout`](crate::ErrorKind::Timeout) when the base has been silent for longer than its feedback period allows.
    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Self::Error>;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_quarter_circle_ends_beside_where_it_began() {
        let twist = Twist2 { linear_mps: 1.0, angular_radps: core::f64::consts::FRAC_PI_2 };
        let radius = 2.0 / core::f64::consts::PI;
        let end = twist.integrate(1.0);
        assert!((end.x_m - radius).abs() < 1e-12 && (end.y_m - radius).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn two_half_steps_are_one_step(v in -1.0..1.0, w in -3.0..3.0) {
            let twist = Twist2 { linear_mps: v, angular_radps: w };
            let half = twist.integrate(0.5);
            let whole = twist.integrate(1.0);
            let two = half.compose(&half);
            prop_assert!(two.distance_m(&whole) < 1e-9);
        }
    }
}
