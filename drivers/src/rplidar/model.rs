//! The supported models and their differences.

use hal::ScanGeometry;
use serde::{Deserialize, Serialize};

use super::Request;
use crate::rotary::circle;

/// A family of scanners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Its motor is switched by the port's DTR line, and rotates about 5.5 times a second.
    #[default]
    A1,
    A2,
    A3,
    S2,
}

/// How measurements are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScanMode {
    /// Capsules with a checksum.
    #[default]
    Express,
    /// Single measurements with two check bits, for old firmware.
    Standard,
}

/// How the motor is started and stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotorControl {
    /// It rotates while DTR is clear.
    Dtr,
    /// By a duty cycle.
    Pwm,
    /// By a rate.
    Speed,
}

/// The properties of one family, from its data sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelSpec {
    pub name: &'static str,
    /// The upper half of the model number that the scanner reports.
    pub series: u8,
    pub baud: u32,
    /// Revolutions per second.
    pub rotation_hz: f64,
    pub motor: MotorControl,
    /// Shortest and longest distance.
    pub range_m: (f32, f32),
    /// Largest error of a distance of up to 1 m, metres.
    pub accuracy_m: f64,
    /// Measurements per second in an express scan and in a standard scan. A scanner that sends more
    /// is read as well.
    pub rate_hz: (f64, f64),
    /// The number of the express scan that this driver reads.
    pub working_mode: u8,
}

/// Duty cycle of the maker's software, of 1023.
const DEFAULT_PWM: u16 = 660;

/// Data sheet of the A1 and the A2: 1 % of distances of up to 3 m.
const A1: ModelSpec = ModelSpec {
    name: "RPLIDAR A1",
    series: 1,
    baud: 115_200,
    rotation_hz: 5.5,
    motor: MotorControl::Dtr,
    range_m: (0.15, 12.0),
    accuracy_m: 0.01,
    rate_hz: (4000.0, 2000.0),
    working_mode: 0,
};

const A2: ModelSpec = ModelSpec {
    name: "RPLIDAR A2",
    series: 2,
    rotation_hz: 10.0,
    motor: MotorControl::Pwm,
    range_m: (0.2, 16.0),
    ..A1
};

const A3: ModelSpec =
    ModelSpec { name: "RPLIDAR A3", series: 3, baud: 256_000, range_m: (0.2, 25.0), ..A2 };

/// Its dense express scan is number 1. Data sheet: 30 mm.
const S2: ModelSpec = ModelSpec {
    name: "RPLIDAR S2",
    series: 7,
    baud: 1_000_000,
    motor: MotorControl::Speed,
    range_m: (0.05, 30.0),
    accuracy_m: 0.03,
    rate_hz: (32_000.0, 8000.0),
    working_mode: 1,
    ..A2
};

impl Model {
    pub const ALL: [Self; 4] = [Self::A1, Self::A2, Self::A3, Self::S2];

    #[must_use]
    pub fn spec(self) -> &'static ModelSpec {
        match self {
            Self::A1 => &A1,
            Self::A2 => &A2,
            Self::A3 => &A3,
            Self::S2 => &S2,
        }
    }

    /// The geometry of the scans at this rotation.
    #[must_use]
    pub fn geometry(self, mode: ScanMode, rotation_hz: f64) -> ScanGeometry {
        let spec = self.spec();
        let rate_hz = match mode {
            ScanMode::Express => spec.rate_hz.0,
            ScanMode::Standard => spec.rate_hz.1,
        };
        circle(rate_hz / rotation_hz, spec.range_m, (1e9 / rotation_hz).round() as u64)
    }

    /// The request that starts a scan.
    #[must_use]
    pub fn scan_request(self, mode: ScanMode) -> Request {
        match mode {
            ScanMode::Express => Request::ExpressScan { working_mode: self.spec().working_mode },
            ScanMode::Standard => Request::Scan,
        }
    }

    /// The request that lets the motor rotate; `None` where a line of the port does.
    #[must_use]
    pub fn motor_request(self, rotation_hz: f64) -> Option<Request> {
        match self.spec().motor {
            MotorControl::Dtr => None,
            MotorControl::Pwm => Some(Request::MotorPwm(DEFAULT_PWM)),
            MotorControl::Speed => Some(Request::MotorSpeed((60.0 * rotation_hz).round() as u16)),
        }
    }

    /// The request that stops the motor; `None` where a line of the port does.
    #[must_use]
    pub fn motor_stop_request(self) -> Option<Request> {
        match self.spec().motor {
            MotorControl::Dtr => None,
            MotorControl::Pwm => Some(Request::MotorPwm(0)),
            MotorControl::Speed => Some(Request::MotorSpeed(0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_model_has_the_beams_that_its_rate_fills() {
        assert_eq!(Model::ALL.map(|model| beams(model, ScanMode::Express)), [600, 360, 360, 1440]);
        assert_eq!(Model::ALL.map(|model| beams(model, ScanMode::Standard)), [300, 180, 180, 720]);
    }

    fn beams(model: Model, mode: ScanMode) -> usize {
        model.geometry(mode, model.spec().rotation_hz).beams
    }

    #[test]
    fn the_motor_of_each_model_is_started_in_its_own_way() {
        assert_eq!(Model::A1.motor_request(5.5), None);
        assert_eq!(Model::A2.motor_request(10.0), Some(Request::MotorPwm(660)));
        assert_eq!(Model::S2.motor_request(10.0), Some(Request::MotorSpeed(600)));
        assert_eq!(Model::S2.motor_stop_request(), Some(Request::MotorSpeed(0)));
    }
}
