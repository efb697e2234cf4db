//! Configuration of an LD06 or LD19.

use hal::ScanGeometry;

use super::RANGE_M;
use crate::rotary::{RotaryError, circle};

/// Measurements per second (data sheets).
const RATE_HZ: f64 = 4500.0;

hal::settings! {
    /// What only an LD06 or LD19 has.
    pub struct Ld06Config {
        /// Revolutions per second: 10 without a signal at the scanner's PWM input. A slower scanner is a fault, and the robot drives slower by it.
        rotation_hz: f64 = 10.0, in 5.0..=13.0, unit "Hz", source "data sheet";
        /// A point whose echo is weaker is an error.
        min_confidence: u8 = 15, in 0..=255, source "the filter of LDROBOT's software";
    }
}

impl Ld06Config {
    /// The geometry of the scans.
    #[must_use]
    pub fn geometry(&self) -> ScanGeometry {
        let period_ns = (1e9 / self.rotation_hz).round() as u64;
        circle(RATE_HZ / self.rotation_hz, RANGE_M, period_ns)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`RotaryError::Config`] with the value and its range.
    pub fn validate(&self) -> Result<(), RotaryError> {
        Ok(self.check_ranges()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_has_400_beams_at_ten_revolutions_a_second_and_fewer_at_more() {
        let config = Ld06Config::default();
        assert_eq!(config.geometry(), ScanGeometry::LD06);
        assert_eq!(Ld06Config { rotation_hz: 13.0, ..config }.geometry().beams, 300);
    }

    #[test]
    fn values_out_of_range_are_refused_with_the_range() {
        let slow = Ld06Config { rotation_hz: 1.0, ..Ld06Config::default() };
        assert!(slow.validate().unwrap_err().to_string().contains("5.0 to 13.0 Hz"));
        let nan = Ld06Config { rotation_hz: f64::NAN, ..Ld06Config::default() };
        assert!(nan.validate().is_err());
    }
}
