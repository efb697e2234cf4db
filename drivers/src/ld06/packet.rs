//! One packet of 12 points.
//!
//! ```text
//! byte   0     0x54, the header
//! byte   1     0x2c, version and number of points (12 in the lower five bits)
//! bytes  2, 3  rotation, degrees per second
//! bytes  4, 5  angle of the first point, hundredths of a degree, clockwise
//! bytes  6..42 12 points: distance in millimetres (2 bytes), confidence (1 byte)
//! bytes 42, 43 angle of the last point
//! bytes 44, 45 time, milliseconds from 0 to 30000
//! byte  46     CRC-8 of all bytes before it
//! ```
//!
//! All numbers begin with their low byte.

use super::crc::crc8;
use super::error::PacketError;

/// Length of a packet, bytes.
pub const PACKET_BYTES: usize = 47;
/// Points of a packet.
pub const POINTS: usize = 12;

const HEADER: u8 = 0x54;
const VERSION_AND_LENGTH: u8 = 0x2c;
const FIRST_POINT: usize = 6;
const POINT_BYTES: usize = 3;
/// A full revolution, hundredths of a degree.
const FULL_CIRCLE: u16 = 36_000;
/// At 13 Hz, the fastest rotation of the data sheet, 11 steps at 4500 points a second are 11.5
/// degrees.
const LONGEST_SPAN: u16 = 2_000;

/// One measurement of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Point {
    /// Distance, millimetres; 0 if there was no echo.
    pub distance_mm: u16,
    /// Strength of the echo: about 200 for a white wall within 6 m (development manual).
    pub confidence: u8,
}

/// A packet that passed its checks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet {
    /// Rotation, degrees per second.
    pub rotation_dps: u16,
    /// Clockwise angle of the first point, hundredths of a degree.
    pub start_centidegrees: u16,
    pub points: [Point; POINTS],
    /// Clockwise angle of the last point, hundredths of a degree.
    pub end_centidegrees: u16,
    /// Time of the packet on the scanner's clock, which counts milliseconds from 0 to 30000.
    pub time_ms: u16,
}

/// Whether these bytes may be the beginning of a packet.
#[must_use]
pub fn may_begin(bytes: &[u8]) -> bool {
    let second = bytes.get(1).is_none_or(|byte| *byte == VERSION_AND_LENGTH);
    bytes.first() == Some(&HEADER) && second
}

impl Packet {
    /// Reads a packet.
    ///
    /// # Errors
    /// A wrong checksum, or angles that the scanner cannot have sent.
    pub fn read(bytes: &[u8; PACKET_BYTES]) -> Result<Self, PacketError> {
        let [content @ .., found] = bytes;
        let computed = crc8(content);
        if *found != computed {
            return Err(PacketError::Checksum { found: *found, computed });
        }
        let packet = Self {
            rotation_dps: number(bytes, 2),
            start_centidegrees: number(bytes, 4),
            points: std::array::from_fn(|index| {
                let at = FIRST_POINT + index * POINT_BYTES;
                Point { distance_mm: number(bytes, at), confidence: bytes[at + 2] }
            }),
            end_centidegrees: number(bytes, 42),
            time_ms: number(bytes, 44),
        };
        packet.check_angles()?;
        Ok(packet)
    }

    /// Writes the packet as the scanner sends it.
    #[must_use]
    pub fn write(&self) -> [u8; PACKET_BYTES] {
        let mut bytes = [0; PACKET_BYTES];
        bytes[0] = HEADER;
        bytes[1] = VERSION_AND_LENGTH;
        bytes[2..4].copy_from_slice(&self.rotation_dps.to_le_bytes());
        bytes[4..6].copy_from_slice(&self.start_centidegrees.to_le_bytes());
        for (point, out) in self.points.iter().zip(bytes[FIRST_POINT..].chunks_mut(POINT_BYTES)) {
            out[..2].copy_from_slice(&point.distance_mm.to_le_bytes());
            out[2] = point.confidence;
        }
        bytes[42..44].copy_from_slice(&self.end_centidegrees.to_le_bytes());
        bytes[44..46].copy_from_slice(&self.time_ms.to_le_bytes());
        bytes[46] = crc8(&bytes[..46]);
        bytes
    }

    /// Clockwise angle from the first point to the last, hundredths of a degree.
    #[must_use]
    pub fn span_centidegrees(&self) -> u16 {
        let end = self.end_centidegrees % FULL_CIRCLE;
        let start = self.start_centidegrees % FULL_CIRCLE;
        if end >= start { end - start } else { FULL_CIRCLE - start + end }
    }

    /// Clockwise angle of a point, radians from 0 to 2 pi. The points are spread evenly.
    #[must_use]
    pub fn angle_rad(&self, point: usize) -> f64 {
        let step = f64::from(self.span_centidegrees()) / (POINTS - 1) as f64;
        let centidegrees = f64::from(self.start_centidegrees) + step * point as f64;
        (centidegrees % f64::from(FULL_CIRCLE) / 100.0).to_radians()
    }

    fn check_angles(&self) -> Result<(), PacketError> {
        for centidegrees in [self.start_centidegrees, self.end_centidegrees] {
            if centidegrees > FULL_CIRCLE {
                return Err(PacketError::Angle { centidegrees });
            }
        }
        let centidegrees = self.span_centidegrees();
        if centidegrees > LONGEST_SPAN {
            return Err(PacketError::Span { centidegrees, limit: LONGEST_SPAN });
        }
        Ok(())
    }
}

/// The number of two bytes at this place.
fn number(bytes: &[u8; PACKET_BYTES], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The example of the LD06 development manual.
    const EXAMPLE: [u8; PACKET_BYTES] = [
        0x54, 0x2c, 0x68, 0x08, 0xab, 0x7e, 0xe0, 0x00, 0xe4, 0xdc, 0x00, 0xe2, 0xd9, 0x00, 0xe5,
        0xd5, 0x00, 0xe3, 0xd3, 0x00, 0xe4, 0xd0, 0x00, 0xe9, 0xcd, 0x00, 0xe4, 0xca, 0x00, 0xe2,
        0xc7, 0x00, 0xe9, 0xc5, 0x00, 0xe5, 0xc2, 0x00, 0xe5, 0xc0, 0x00, 0xe5, 0xbe, 0x82, 0x3a,
        0x1a, 0x50,
    ];

    #[test]
    fn the_makers_example_is_read_as_the_maker_reads_it() {
        let packet = Packet::read(&EXAMPLE).unwrap();
        assert_eq!((packet.rotation_dps, packet.time_ms), (2152, 6714));
        assert_eq!((packet.start_centidegrees, packet.end_centidegrees), (32427, 33470));
        assert_eq!(packet.points[0], Point { distance_mm: 224, confidence: 228 });
        assert_eq!(packet.points[11], Point { distance_mm: 192, confidence: 229 });
        assert!((packet.angle_rad(0).to_degrees() - 324.27).abs() < 1e-9);
        assert!((packet.angle_rad(11).to_degrees() - 334.70).abs() < 1e-9);
        assert_eq!(packet.write(), EXAMPLE);
    }

    #[test]
    fn points_across_the_zero_have_angles_on_both_sides() {
        let packet = Packet { start_centidegrees: 35_500, end_centidegrees: 600, ..any_packet() };
        assert_eq!(packet.span_centidegrees(), 1100);
        assert!((packet.angle_rad(4).to_degrees() - 359.0).abs() < 1e-9);
        assert!((packet.angle_rad(6).to_degrees() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn angles_that_no_scanner_sends_are_refused_with_the_limit() {
        let beyond = Packet { start_centidegrees: 36_001, ..any_packet() };
        assert_eq!(Packet::read(&beyond.write()), Err(PacketError::Angle { centidegrees: 36_001 }));
        let wide = Packet { start_centidegrees: 0, end_centidegrees: 2001, ..any_packet() };
        let error = Packet::read(&wide.write()).unwrap_err().to_string();
        assert!(error.contains("2001") && error.contains("0 to 2000"), "{error}");
    }

    #[test]
    fn points_that_run_backwards_are_refused() {
        let backwards =
            Packet { start_centidegrees: 35_000, end_centidegrees: 34_000, ..any_packet() };
        let refused = Packet::read(&backwards.write());
        assert_eq!(refused, Err(PacketError::Span { centidegrees: 35_000, limit: 2000 }));
    }

    fn any_packet() -> Packet {
        Packet::read(&EXAMPLE).unwrap()
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_again(
            rotation_dps in any::<u16>(),
            start_centidegrees in 0..=36_000_u16,
            span in 0..=2_000_u16,
            points in any::<[(u16, u8); POINTS]>(),
            time_ms in any::<u16>(),
        ) {
            let packet = Packet {
                rotation_dps,
                start_centidegrees,
                points: points.map(|(distance_mm, confidence)| Point { distance_mm, confidence }),
                end_centidegrees: (start_centidegrees + span) % 36_000,
                time_ms,
            };
            prop_assert_eq!(Packet::read(&packet.write()), Ok(packet));
        }

        #[test]
        fn a_flipped_bit_is_always_refused(bit in 0..PACKET_BYTES * 8) {
            let mut flipped = EXAMPLE;
            flipped[bit / 8] ^= 1 << (bit % 8);
            prop_assert!(Packet::read(&flipped).is_err());
        }
    }
}
