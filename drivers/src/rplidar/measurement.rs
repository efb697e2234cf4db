//! One measurement of a standard scan (kind 0x81).
//!
//! ```text
//! byte  0     quality in the upper six bits, inverse start bit, start bit of a revolution
//! byte  1     lower seven bits of the angle, check bit (always 1)
//! byte  2     upper eight bits of the angle, 1/64 degree, clockwise
//! bytes 3, 4  distance, 1/4 millimetre
//! ```
//!
//! Two check bits are all that protects five bytes: a changed distance is not noticed. The express
//! scan has checksums.

use super::AnswerError;

/// Length of a measurement, bytes.
pub const MEASUREMENT_BYTES: usize = 5;
/// A full revolution, 1/64 degree.
pub(super) const FULL_CIRCLE_Q6: u16 = 360 * 64;

/// A measurement that passed its checks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measurement {
    /// Strength of the echo, 0 to 63.
    pub quality: u8,
    /// Whether it is the first of a revolution.
    pub starts_revolution: bool,
    /// Clockwise angle, 1/64 degree.
    pub angle_q6: u16,
    /// Distance, 1/4 mm; 0 if nothing was measured.
    pub distance_q2: u16,
}

/// Whether these bytes may be the beginning of a measurement.
#[must_use]
pub fn may_begin(bytes: &[u8]) -> bool {
    let start_bits = bytes.first().is_some_and(|byte| matches!(byte & 3, 1 | 2));
    start_bits && bytes.get(1).is_none_or(|byte| byte & 1 == 1)
}

impl Measurement {
    /// Reads a measurement.
    ///
    /// # Errors
    /// Wrong check bits, or an angle beyond a full revolution.
    pub fn read(bytes: &[u8; MEASUREMENT_BYTES]) -> Result<Self, AnswerError> {
        if !may_begin(bytes) {
            return Err(AnswerError::CheckBits { bytes: *bytes });
        }
        let angle_q6 = u16::from_le_bytes([bytes[1], bytes[2]]) >> 1;
        if angle_q6 > FULL_CIRCLE_Q6 {
            return Err(AnswerError::Angle { q6: angle_q6 });
        }
        Ok(Self {
            quality: bytes[0] >> 2,
            starts_revolution: bytes[0] & 1 == 1,
            angle_q6,
            distance_q2: u16::from_le_bytes([bytes[3], bytes[4]]),
        })
    }

    /// Writes the measurement as the scanner sends it.
    #[must_use]
    pub fn write(&self) -> [u8; MEASUREMENT_BYTES] {
        let start = if self.starts_revolution { 1 } else { 2 };
        let [low, high] = ((self.angle_q6 << 1) | 1).to_le_bytes();
        let [near, far] = self.distance_q2.to_le_bytes();
        [(self.quality << 2) | start, low, high, near, far]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_measurement_is_read_as_the_makers_notes_define_it() {
        // Quality 15, first of a revolution, 90.5 degrees (5792 / 64), 1234.25 mm (4937 / 4).
        let bytes = [0x3d, 0x41, 0x2d, 0x49, 0x13];
        let measurement = Measurement::read(&bytes).unwrap();
        assert_eq!(
            measurement,
            Measurement { quality: 15, starts_revolution: true, angle_q6: 5792, distance_q2: 4937 }
        );
        assert_eq!(measurement.write(), bytes);
    }

    #[test]
    fn wrong_check_bits_and_angles_beyond_a_revolution_are_refused() {
        for bytes in [[0x3c, 0x41, 0, 0, 0], [0x3f, 0x41, 0, 0, 0], [0x3d, 0x40, 0, 0, 0]] {
            assert_eq!(Measurement::read(&bytes), Err(AnswerError::CheckBits { bytes }));
        }
        let beyond =
            Measurement { quality: 1, starts_revolution: false, angle_q6: 23_041, distance_q2: 4 };
        assert_eq!(Measurement::read(&beyond.write()), Err(AnswerError::Angle { q6: 23_041 }));
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_again(
            quality in 0..64_u8,
            starts_revolution: bool,
            angle_q6 in 0..=FULL_CIRCLE_Q6,
            distance_q2: u16,
        ) {
            let measurement = Measurement { quality, starts_revolution, angle_q6, distance_q2 };
            prop_assert_eq!(Measurement::read(&measurement.write()), Ok(measurement));
        }
    }
}
