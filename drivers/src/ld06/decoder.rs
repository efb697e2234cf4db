//! The scanner's bytes as measurements.

use hal::Range;

use super::error::PacketError;
use super::packet::{PACKET_BYTES, Packet, Point, may_begin};
use crate::rotary::{Event, Sample};
use crate::scanner::FixedFramer;

/// Distances of the data sheet (LD06 and LD19): 0.02 to 12 m.
pub const RANGE_M: (f32, f32) = (0.02, 12.0);
/// Largest error of a distance, metres (data sheet LD19: from 0.3 to 12 m; none is stated for nearer ones).
pub const ACCURACY_M: f64 = 0.045;
/// A step from one packet to the next that is this many times longer than the steps inside the
/// packets means that packets are missing.
const GAP_STEPS: f64 = 4.0;

/// Converts bytes to measurements. It does no I/O and allocates nothing.
#[derive(Debug, Clone)]
pub struct Decoder {
    framer: FixedFramer<PACKET_BYTES>,
    min_confidence: u8,
    /// Clockwise angle of the last point, radians.
    last_rad: Option<f64>,
}

impl Decoder {
    /// A decoder that takes points below this confidence for errors.
    #[must_use]
    pub fn new(min_confidence: u8) -> Self {
        Self { framer: FixedFramer::new(may_begin), min_confidence, last_rad: None }
    }

    /// Takes the next byte, and passes what it completes to `sink`.
    pub fn push(&mut self, byte: u8, mut sink: impl FnMut(Event<PacketError>)) {
        match self.framer.push(byte, Packet::read) {
            None => {}
            Some(Err(error)) => sink(Event::Refused(error)),
            Some(Ok(packet)) => {
                if self.is_after_gap(&packet) {
                    sink(Event::Missing);
                }
                for (index, point) in packet.points.iter().enumerate() {
                    let clockwise_rad = packet.angle_rad(index);
                    self.last_rad = Some(clockwise_rad);
                    let range = range(*point, self.min_confidence);
                    sink(Event::Sample(Sample { clockwise_rad, range }));
                }
            }
        }
    }

    fn is_after_gap(&self, packet: &Packet) -> bool {
        let step_rad = (f64::from(packet.span_centidegrees()) / 1100.0).to_radians();
        self.last_rad.is_some_and(|last_rad| {
            let jump_rad = (packet.angle_rad(0) - last_rad).rem_euclid(std::f64::consts::TAU);
            jump_rad > GAP_STEPS * step_rad.max(1e-3)
        })
    }
}

/// What a point measured. A point without an echo is not free space, and a doubtful one is an error.
fn range(point: Point, min_confidence: u8) -> Range {
    let distance_m = f32::from(point.distance_mm) / 1000.0;
    match point.distance_mm {
        0 => Range::NoReturn,
        _ if point.confidence < min_confidence => Range::Error,
        _ if distance_m < RANGE_M.0 => Range::TooNear,
        _ if distance_m > RANGE_M.1 => Range::NoReturn,
        _ => Range::Hit(distance_m),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ld06::POINTS;
    use proptest::prelude::*;

    /// The packet that begins at this angle, with steps of 0.8 degrees and 1 m everywhere.
    fn packet_at(start_centidegrees: u16) -> Packet {
        Packet {
            rotation_dps: 3600,
            start_centidegrees,
            points: [Point { distance_mm: 1000, confidence: 200 }; POINTS],
            end_centidegrees: (start_centidegrees + 880) % 36_000,
            time_ms: 0,
        }
    }

    fn events(bytes: &[u8]) -> Vec<Event<PacketError>> {
        let mut decoder = Decoder::new(15);
        let mut events = Vec::new();
        bytes.iter().for_each(|byte| decoder.push(*byte, |event| events.push(event)));
        events
    }

    fn revolution() -> Vec<u8> {
        (0..39).flat_map(|index| packet_at((index * 960) % 36_000).write()).collect()
    }

    #[test]
    fn a_missing_packet_is_noticed_and_its_points_are_not_made_up() {
        let mut bytes = revolution();
        bytes.drain(10 * PACKET_BYTES..11 * PACKET_BYTES);
        let events = events(&bytes);
        assert_eq!(events.iter().filter(|event| matches!(event, Event::Missing)).count(), 1);
        assert_eq!(
            events.iter().filter(|event| matches!(event, Event::Sample(_))).count(),
            38 * 12
        );
    }

    #[test]
    fn no_echo_is_no_return_and_a_doubtful_echo_is_an_error() {
        for (distance_mm, confidence, expected) in [
            (0, 0, Range::NoReturn),
            (0, 200, Range::NoReturn),
            (1500, 14, Range::Error),
            (1500, 15, Range::Hit(1.5)),
            (19, 200, Range::TooNear),
            (20, 200, Range::Hit(0.02)),
            (12_000, 200, Range::Hit(12.0)),
            (12_001, 200, Range::NoReturn),
        ] {
            assert_eq!(range(Point { distance_mm, confidence }, 15), expected, "{distance_mm}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_give_finite_measurements_within_a_revolution(
            bytes in proptest::collection::vec(any::<u8>(), 0..400),
            place in 0..400_usize,
        ) {
            let mut stream = bytes;
            let place = place.min(stream.len());
            stream.splice(place..place, packet_at(100).write());
            for event in events(&stream) {
                if let Event::Sample(sample) = event {
                    prop_assert!((0.0..std::f64::consts::TAU).contains(&sample.clockwise_rad));
                    prop_assert!(sample.range.hit_m().is_none_or(f32::is_finite));
                }
            }
        }
    }
}
