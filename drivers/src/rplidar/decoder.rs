//! The scanner's bytes after a request to scan, as measurements.

use std::f64::consts::TAU;

use hal::Range;

use super::capsule::{self, CAPSULE_BYTES, Capsule, Layout};
use super::descriptor::{self, DESCRIPTOR_BYTES, Descriptor};
use super::measurement::{self, MEASUREMENT_BYTES, Measurement};
use super::{AnswerError, FULL_CIRCLE_Q6};
use crate::rotary::{Event, Sample};
use crate::scanner::FixedFramer;

/// A measurement of a standard scan counts when this many measurements follow it without an error:
/// two check bits alone accept every fourth misplaced measurement.
const WITNESSES: usize = 6;
/// Two capsules in a row that cover angles in at most this ratio are neighbours. The rotation changes
/// far less from one to the next, and a lost capsule between them doubles the angle.
const SAME_STEP: f64 = 1.3;

/// Converts bytes to measurements, from the descriptor of a scan on. It does no I/O and allocates
/// nothing.
#[derive(Debug, Clone)]
pub struct Decoder {
    range_m: (f32, f32),
    kind: Kind,
}

#[derive(Debug, Clone)]
enum Kind {
    /// Waits for the descriptor.
    Head(FixedFramer<DESCRIPTOR_BYTES>),
    Measurements(Measurements),
    Capsules(Box<Capsules>),
    /// The scan is of a kind that is not read.
    Unknown,
}

impl Decoder {
    /// A decoder for a scanner that measures from the first to the second distance.
    #[must_use]
    pub fn new(range_m: (f32, f32)) -> Self {
        Self { range_m, kind: Kind::Head(FixedFramer::new(descriptor::may_begin)) }
    }

    /// Takes the next byte, and passes what it completes to `sink`.
    pub fn push(&mut self, byte: u8, mut sink: impl FnMut(Event<AnswerError>)) {
        let range_m = self.range_m;
        match &mut self.kind {
            Kind::Head(framer) => {
                let read = framer.push(byte, |bytes| Descriptor::read(bytes).ok_or(()));
                if let Some(Ok(descriptor)) = read {
                    self.begin(&descriptor, sink);
                }
            }
            Kind::Measurements(measurements) => measurements.push(byte, range_m, sink),
            Kind::Capsules(capsules) => capsules.push(byte, range_m, &mut sink),
            Kind::Unknown => {}
        }
    }

    fn begin(&mut self, descriptor: &Descriptor, mut sink: impl FnMut(Event<AnswerError>)) {
        self.kind = match *descriptor {
            Descriptor::SCAN => Kind::Measurements(Measurements::new()),
            Descriptor::CAPSULES => Kind::Capsules(Box::new(Capsules::new(Layout::Legacy))),
            Descriptor::DENSE_CAPSULES => Kind::Capsules(Box::new(Capsules::new(Layout::Dense))),
            // A late answer to another request.
            Descriptor { repeats: false, .. } => return,
            Descriptor { kind, length, .. } => {
                sink(Event::Refused(AnswerError::Kind { kind, length }));
                Kind::Unknown
            }
        };
    }
}

/// A standard scan.
#[derive(Debug, Clone)]
struct Measurements {
    framer: FixedFramer<MEASUREMENT_BYTES>,
    skipped: u64,
    /// Measurements that wait for witnesses, the oldest first.
    waiting: heapless::Deque<Measurement, WITNESSES>,
}

impl Measurements {
    fn new() -> Self {
        Self {
            framer: FixedFramer::new(measurement::may_begin),
            skipped: 0,
            waiting: heapless::Deque::new(),
        }
    }

    fn push(&mut self, byte: u8, range_m: (f32, f32), mut sink: impl FnMut(Event<AnswerError>)) {
        let read = self.framer.push(byte, Measurement::read);
        let is_after_noise = self.framer.skipped() != self.skipped;
        self.skipped = self.framer.skipped();
        if is_after_noise {
            if !self.waiting.is_empty() {
                let bytes = [0; MEASUREMENT_BYTES];
                let error = AnswerError::CheckBits { bytes };
                sink(Event::Refused(read.and_then(Result::err).unwrap_or(error)));
                sink(Event::Missing);
            }
            self.waiting.clear();
        }
        let Some(Ok(measurement)) = read else { return };
        if self.waiting.is_full()
            && let Some(oldest) = self.waiting.pop_front()
        {
            sink(Event::Sample(sample_of(&oldest, range_m)));
        }
        _ = self.waiting.push_back(measurement);
    }
}

fn sample_of(measurement: &Measurement, range_m: (f32, f32)) -> Sample {
    let distance_m = f32::from(measurement.distance_q2) / 4000.0;
    let range = match measurement {
        Measurement { distance_q2: 0, .. } => Range::NoReturn,
        Measurement { quality: 0, .. } => Range::Error,
        _ => range(distance_m, range_m),
    };
    Sample { clockwise_rad: angle_rad(f64::from(measurement.angle_q6)), range }
}

/// An express scan.
#[derive(Debug, Clone)]
struct Capsules {
    framer: FixedFramer<CAPSULE_BYTES>,
    layout: Layout,
    skipped: u64,
    before: Option<Capsule>,
    /// Angle between the starts of the last two capsules, 1/64 degree.
    step_q6: Option<f64>,
}

impl Capsules {
    fn new(layout: Layout) -> Self {
        Self {
            framer: FixedFramer::new(capsule::may_begin),
            layout,
            skipped: 0,
            before: None,
            step_q6: None,
        }
    }

    fn push(&mut self, byte: u8, range_m: (f32, f32), sink: &mut impl FnMut(Event<AnswerError>)) {
        let layout = self.layout;
        let capsule = match self.framer.push(byte, |bytes| Capsule::read(bytes, layout)) {
            None => return,
            Some(Err(error)) => {
                // Of the capsules that seem to begin inside a broken one, only the first is reported.
                if self.before.take().is_some() {
                    sink(Event::Refused(error));
                    sink(Event::Missing);
                }
                return;
            }
            Some(Ok(capsule)) => capsule,
        };
        let is_after_noise = self.framer.skipped() != self.skipped;
        self.skipped = self.framer.skipped();
        if capsule.is_new_scan() {
            self.step_q6 = None;
        }
        let before =
            self.before.replace(capsule).filter(|_| !is_after_noise && !capsule.is_new_scan());
        let Some(before) = before else { return };
        let full_circle_q6 = f64::from(FULL_CIRCLE_Q6);
        let starts = [&capsule, &before].map(|capsule| f64::from(capsule.start_angle_q6()));
        let step_q6 = (starts[0] - starts[1]).rem_euclid(full_circle_q6);
        let is_neighbour = self.step_q6.replace(step_q6).is_some_and(|known_q6| {
            step_q6 <= SAME_STEP * known_q6 && known_q6 <= SAME_STEP * step_q6
        });
        if is_neighbour {
            self.pass_on(&before, step_q6, range_m, sink);
        } else {
            sink(Event::Missing);
        }
    }

    /// Passes on the measurements of a capsule that covers this angle.
    fn pass_on(
        &mut self,
        capsule: &Capsule,
        step_q6: f64,
        range_m: (f32, f32),
        sink: &mut impl FnMut(Event<AnswerError>),
    ) {
        let full_circle_q6 = f64::from(FULL_CIRCLE_Q6);
        let count = self.layout.measurements();
        for index in 0..count {
            let raw_q6 = (f64::from(capsule.start_angle_q6())
                + step_q6 * index as f64 / count as f64)
                .rem_euclid(full_circle_q6);
            let cell = capsule.cell(index);
            let range = match cell.distance_mm {
                0 => Range::NoReturn,
                distance_mm => range(f32::from(distance_mm) / 1000.0, range_m),
            };
            let clockwise_rad = angle_rad(raw_q6 - 8.0 * f64::from(cell.correction_q3));
            sink(Event::Sample(Sample { clockwise_rad, range }));
        }
    }
}

/// An angle in 1/64 degree as radians from 0 to 2 pi.
fn angle_rad(q6: f64) -> f64 {
    let rad = (q6 / 64.0).to_radians().rem_euclid(TAU);
    if rad < TAU { rad } else { 0.0 }
}

fn range(distance_m: f32, (min_m, max_m): (f32, f32)) -> Range {
    if distance_m < min_m {
        Range::TooNear
    } else if distance_m > max_m {
        Range::NoReturn
    } else {
        Range::Hit(distance_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rplidar::Cell;
    use proptest::prelude::*;

    const RANGE_M: (f32, f32) = (0.15, 12.0);

    fn events(bytes: &[u8]) -> Vec<Event<AnswerError>> {
        let mut decoder = Decoder::new(RANGE_M);
        let mut events = Vec::new();
        bytes.iter().for_each(|byte| decoder.push(*byte, |event| events.push(event)));
        events
    }

    fn samples(events: &[Event<AnswerError>]) -> Vec<Sample> {
        let samples = events.iter().filter_map(|event| match event {
            Event::Sample(sample) => Some(*sample),
            _ => None,
        });
        samples.collect()
    }

    /// Capsules of 16 degrees at 1 m, as an A1 sends at 5.5 Hz.
    fn capsules(count: u16) -> Vec<u8> {
        let mut bytes = Descriptor::CAPSULES.write().to_vec();
        for index in 0..count {
            let cells = [Cell { distance_mm: 1000, correction_q3: 0 }; 32];
            let start_q6 = (index % 25) * 922;
            let capsule = Capsule::from_cells(Layout::Legacy, start_q6, index == 0, &cells);
            bytes.extend(capsule.bytes());
        }
        bytes
    }

    fn measurements(count: u16, skip: impl Fn(u16) -> bool) -> Vec<u8> {
        let mut bytes = Descriptor::SCAN.write().to_vec();
        for index in (0..count).filter(|index| !skip(*index)) {
            let angle_q6 = index % 360 * 64;
            let starts_revolution = angle_q6 == 0;
            bytes.extend(
                Measurement { quality: 15, starts_revolution, angle_q6, distance_q2: 4000 }.write(),
            );
        }
        bytes
    }

    #[test]
    fn the_measurements_of_a_capsule_are_spread_up_to_the_next_one_and_corrected() {
        let mut bytes = Descriptor::CAPSULES.write().to_vec();
        let cells = [Cell { distance_mm: 2000, correction_q3: 16 }; 32];
        for start_deg in [10, 26, 42, 58] {
            bytes
                .extend(Capsule::from_cells(Layout::Legacy, start_deg * 64, false, &cells).bytes());
        }
        let samples = samples(&events(&bytes));
        // The step of the first capsule is confirmed by the second; the last one is not complete.
        assert_eq!(samples.len(), 64);
        let degrees = samples.iter().map(|sample| sample.clockwise_rad.to_degrees());
        for (index, degrees) in degrees.enumerate() {
            let expected = 26.0 + 0.5 * index as f64 - 2.0;
            assert!((degrees - expected).abs() < 1e-9, "{index}: {degrees}");
        }
    }

    #[test]
    fn a_lost_capsule_leaves_a_gap_and_does_not_stretch_its_neighbours() {
        let whole = samples(&events(&capsules(60)));
        let mut bytes = capsules(60);
        let at = DESCRIPTOR_BYTES + 20 * CAPSULE_BYTES;
        bytes.drain(at..at + CAPSULE_BYTES);
        let events = events(&bytes);
        let cut = samples(&events);
        assert!(events.contains(&Event::Missing));
        assert!(whole.len() - cut.len() >= 64, "{} of {}", cut.len(), whole.len());
        assert!(cut.iter().all(|sample| {
            whole.iter().any(|other| (other.clockwise_rad - sample.clockwise_rad).abs() < 1e-9)
        }));
    }

    #[test]
    fn a_flipped_bit_costs_the_measurements_of_two_capsules_at_most() {
        let mut bytes = capsules(60);
        bytes[DESCRIPTOR_BYTES + 20 * CAPSULE_BYTES + 40] ^= 4;
        let events = events(&bytes);
        assert_eq!(events.iter().filter(|event| matches!(event, Event::Refused(_))).count(), 1);
        assert_eq!(
            samples(&events).len(),
            samples(&super::tests::events(&capsules(60))).len() - 64
        );
    }

    #[test]
    fn bytes_that_get_lost_in_a_standard_scan_cost_the_measurements_around_them() {
        let bytes = measurements(360, |_| false);
        for lost in 100..105 {
            let mut cut = bytes.clone();
            cut.remove(DESCRIPTOR_BYTES + lost);
            let samples = samples(&events(&cut));
            assert!(samples.iter().all(|sample| sample.range == Range::Hit(1.0)), "{lost}");
            assert!(samples.len() > 300, "{lost}: {}", samples.len());
        }
    }

    #[test]
    fn nothing_measured_is_no_return_and_no_quality_is_an_error() {
        for (quality, distance_q2, expected) in [
            (15, 0, Range::NoReturn),
            (0, 0, Range::NoReturn),
            (0, 4000, Range::Error),
            (15, 4000, Range::Hit(1.0)),
            (15, 596, Range::TooNear),
            (15, 48_004, Range::NoReturn),
        ] {
            let measurement =
                Measurement { quality, starts_revolution: false, angle_q6: 64, distance_q2 };
            assert_eq!(sample_of(&measurement, RANGE_M).range, expected, "{distance_q2}");
        }
    }

    #[test]
    fn a_scan_of_an_unknown_kind_is_refused_with_the_remedy() {
        let descriptor = Descriptor { length: 132, repeats: true, kind: 0x84 };
        let [Event::Refused(error)] = events(&descriptor.write())[..] else {
            panic!("not refused")
        };
        assert!(error.to_string().contains("scan_mode = \"standard\""), "{error}");
    }

    proptest! {
        #[test]
        fn any_bytes_give_finite_measurements_within_a_revolution(
            dense: bool,
            bytes in proptest::collection::vec(any::<u8>(), 0..400),
        ) {
            let head = if dense { Descriptor::DENSE_CAPSULES } else { Descriptor::SCAN };
            let mut stream = head.write().to_vec();
            stream.extend(bytes);
            for sample in samples(&events(&stream)) {
                prop_assert!((0.0..TAU).contains(&sample.clockwise_rad));
                prop_assert!(sample.range.hit_m().is_none_or(f32::is_finite));
            }
        }
    }
}
