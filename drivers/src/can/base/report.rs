//! Status, counts and texts about the base.

use hal::Clock;

use super::{DifferentialBase, Phase, SIDES};
use crate::can::bus::{CanBus, ErrorState};
use crate::can::error::Trip;
use crate::can::kinematics::Odometry;
use crate::can::protocol::{MotorStage, MotorStatus};
use crate::{DeviceState, DeviceStatus};

/// Diagnostic counts since the driver was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BaseCounts {
    /// Frames that belong to no motor and are none of the project's messages.
    pub foreign: u64,
    /// Frames of the project's messages with a wrong checksum.
    pub corrupt: u64,
    /// Frames that could not be sent.
    pub unsent: u64,
    /// Drive commands that were refused.
    pub refused: u64,
    /// Drive commands that never arrived, as gaps in their counter show.
    pub skipped: u64,
    /// Error frames, overflows and missing acknowledges.
    pub bus_errors: u64,
    /// How often the controller was bus-off.
    pub bus_off: u64,
}

impl<B: CanBus, C: Clock> DifferentialBase<B, C> {
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        let now_ns = self.clock.now_ns();
        let stages = self.motors.each_ref().map(|motor| motor.status().stage);
        let is_faulty =
            stages.iter().any(|stage| matches!(stage, MotorStage::Faulted | MotorStage::Refused));
        let state = if self.bus_gone {
            DeviceState::Disconnected
        } else if is_faulty || !self.backoff.is_over(now_ns) || self.wrong_direction.is_some() {
            DeviceState::Faulty
        } else if self.silent_motor(now_ns).is_some() {
            if self.feedback_ns == 0 { DeviceState::Starting } else { DeviceState::Silent }
        } else if stages.contains(&MotorStage::SettingUp) {
            DeviceState::Starting
        } else {
            DeviceState::Working
        };
        let bad = self.status.bad
            + self.counts.corrupt
            + self.motors.iter().map(|motor| motor.status().bad).sum::<u64>();
        DeviceStatus { state, bad, ..self.status }
    }

    #[must_use]
    pub fn counts(&self) -> BaseCounts {
        self.counts
    }

    /// The bus controller's error state and its error counters (TEC, REC), as far as it reports
    /// them.
    #[must_use]
    pub fn bus_health(&self) -> (ErrorState, (u8, u8)) {
        (self.error_state, self.error_counters)
    }

    /// The status of the left and the right motor.
    #[must_use]
    pub fn motors(&self) -> [&MotorStatus; 2] {
        self.motors.each_ref().map(|motor| motor.status())
    }

    /// The odometry with its covariance.
    #[must_use]
    pub fn odometry(&self) -> &Odometry {
        &self.odometry
    }

    /// One line for the operator: the state of the base and, if it cannot move, the reason and the
    /// remedy.
    #[must_use]
    pub fn explain(&self) -> String {
        let now_ns = self.clock.now_ns();
        let motor = SIDES
            .iter()
            .zip(&self.motors)
            .find_map(|(side, motor)| Some((side, motor.status().problem?)));
        let state = match (self.phase, motor) {
            (Phase::Tripped(Trip::MotorFault(_)), Some((side, problem))) => {
                format!("stopped: the {side} motor: {problem}; then arm")
            }
            (Phase::Tripped(trip), _) => format!("stopped: {trip}"),
            (Phase::Disarmed, _) if self.inhibiting_trip(now_ns).is_some() => {
                match self.inhibiting_trip(now_ns) {
                    Some(trip) => format!("not armed: {trip}"),
                    None => "not armed".to_owned(),
                }
            }
            (Phase::Disarmed, Some((side, problem))) => {
                format!("not armed: the {side} motor: {problem}")
            }
            (Phase::Disarmed, None) => "not armed".to_owned(),
            (Phase::Arming, _) => "arming: the motors confirm their watchdogs".to_owned(),
            (Phase::Armed, _) => "armed".to_owned(),
            (Phase::Disarming, _) => "braking before power is removed from the motors".to_owned(),
        };
        format!("base on {}: {state}", self.name)
    }
}
