//! Collects the measurements of one revolution in the beams of a scan.

use std::f64::consts::{PI, TAU};

use hal::{Range, ScanGeometry};

use super::Sample;

/// The numbers of beams that a scan may have. One is chosen that divides the circle evenly.
const BEAMS: [usize; 12] = [180, 240, 300, 360, 400, 480, 600, 720, 900, 1080, 1200, 1440];
/// A motor that rotates faster than it should by this factor still meets every beam.
const FASTER: f64 = 1.1;
/// Directions jitter by some degrees, so that a scanner seems to pass the same direction repeatedly. A revolution has more
/// measurements than this share of its beams: those of 10 degrees with an S2, which measures each beam twice, and of 20
/// with an LD06. Our own choice.
const LEAST_SHARE: f64 = 1.0 / 16.0;

/// How a scanner is mounted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mount {
    /// Direction of the scanner's zero, counter-clockwise from the robot's forward direction, radians.
    pub zero_rad: f64,
    pub upside_down: bool,
}

impl Mount {
    /// The direction of a measurement in the `laser` frame, counter-clockwise from its x axis. The
    /// scanner counts clockwise.
    #[must_use]
    pub fn angle_rad(&self, clockwise_rad: f64) -> f64 {
        if self.upside_down { self.zero_rad + clockwise_rad } else { self.zero_rad - clockwise_rad }
    }

    /// The geometry of the scans of a scanner that is mounted so. `upright` is that of one that is not upside down.
    #[must_use]
    pub fn geometry(&self, upright: ScanGeometry) -> ScanGeometry {
        ScanGeometry { clockwise: upright.clockwise != self.upside_down, ..upright }
    }
}

/// The geometry of the scans of a scanner with this many measurements in a revolution: a whole circle
/// in beams that each hold at least one measurement, counter-clockwise from straight behind. They are measured clockwise.
#[must_use]
pub fn circle(samples_per_revolution: f64, range_m: (f32, f32), period_ns: u64) -> ScanGeometry {
    let most = samples_per_revolution / FASTER;
    let beams = BEAMS.into_iter().rfind(|beams| *beams as f64 <= most).unwrap_or(BEAMS[0]);
    ScanGeometry {
        angle_min_rad: -PI,
        angle_increment_rad: TAU / beams as f64,
        beams,
        range_min_m: range_m.0,
        range_max_m: range_m.1,
        period_ns,
        clockwise: true,
    }
}

/// The measurements of the current revolution, by beam. A beam without one is an error: it was not
/// measured, and so it is not free.
#[derive(Debug, Clone)]
pub struct Revolution {
    angle_min_rad: f64,
    angle_increment_rad: f64,
    /// The rotation is clockwise in the `laser` frame.
    clockwise: bool,
    mount: Mount,
    beams: Vec<Option<Range>>,
    /// Measurements since the revolution began.
    measured: usize,
    /// How far the scanner had rotated since straight behind at the last three measurements, radians from 0 to 2 pi. A wrong
    /// direction among them does not change their median.
    rotated_rad: heapless::HistoryBuf<f64, 3>,
    /// The two newest measurements, which tell whether the one before them was the first of a revolution.
    newest: [Option<Sample>; 2],
}

impl Revolution {
    /// A revolution without measurements. `geometry` is that of a scanner that is mounted so ([`Mount::geometry`]).
    #[must_use]
    pub fn new(geometry: &ScanGeometry, mount: Mount) -> Self {
        Self {
            angle_min_rad: geometry.angle_min_rad,
            angle_increment_rad: geometry.angle_increment_rad,
            clockwise: geometry.clockwise,
            mount,
            beams: vec![None; geometry.beams],
            measured: 0,
            rotated_rad: heapless::HistoryBuf::new(),
            newest: [None; 2],
        }
    }

    /// Takes a measurement. Returns true if it shows that a revolution has ended, whose ranges are then in `ranges`.
    /// Revolutions begin straight behind, so that what is ahead is measured in the middle of one, and not at its beginning and
    /// its end. Two of three measurements must lie in the next revolution: the direction of one may be wrong.
    pub fn push(&mut self, sample: &Sample, ranges: &mut Vec<Range>) -> bool {
        let [first, second] = self.newest;
        self.newest = [second, Some(*sample)];
        let (Some(first), Some(second)) = (first, second) else { return false };
        let has_ended = self.measured as f64 > LEAST_SHARE * self.beams.len() as f64
            && self.is_behind_seam(&first)
            && (self.is_behind_seam(&second) || self.is_behind_seam(sample));
        if has_ended {
            self.finish(ranges);
        }
        self.add(&first);
        has_ended
    }

    /// Whether the scanner had rotated further before: by more than half a revolution, because directions jitter.
    fn is_behind_seam(&self, sample: &Sample) -> bool {
        let mut last = [0.0; 3];
        if self.rotated_rad.len() < last.len() {
            return false;
        }
        last.copy_from_slice(self.rotated_rad.as_slice());
        last.sort_by(f64::total_cmp);
        last[1] - self.rotated_to_rad(sample) > PI
    }

    /// From the seam to a measurement. The seam is beside the beam that points straight behind, so that all measurements of this
    /// beam belong to the same revolution.
    fn rotated_to_rad(&self, sample: &Sample) -> f64 {
        let seam_rad = PI - 0.5 * self.angle_increment_rad;
        let from_seam_rad = self.mount.angle_rad(sample.clockwise_rad) - seam_rad;
        (if self.clockwise { -from_seam_rad } else { from_seam_rad }).rem_euclid(TAU)
    }

    /// Of several measurements in one beam the nearest counts.
    fn add(&mut self, sample: &Sample) {
        self.measured += 1;
        self.rotated_rad.write(self.rotated_to_rad(sample));
        let beam = self.beam(sample.clockwise_rad);
        if let Some(known) = self.beams.get_mut(beam) {
            *known = Some(known.map_or(finite(sample.range), |known| nearer(known, sample.range)));
        }
    }

    /// Copies the ranges of all beams, and begins the next revolution.
    fn finish(&mut self, ranges: &mut Vec<Range>) {
        self.measured = 0;
        ranges.clear();
        ranges.extend(self.beams.iter_mut().map(|beam| beam.take().unwrap_or(Range::Error)));
    }

    fn beam(&self, clockwise_rad: f64) -> usize {
        let from_first_rad =
            (self.mount.angle_rad(clockwise_rad) - self.angle_min_rad).rem_euclid(TAU);
        (from_first_rad / self.angle_increment_rad).round() as usize % self.beams.len().max(1)
    }
}

/// A distance that is not a number is an error.
fn finite(range: Range) -> Range {
    match range {
        Range::Hit(distance_m) if !distance_m.is_finite() => Range::Error,
        range => range,
    }
}

/// What two measurements of one beam say together: the nearest return, else an error, and no return
/// only if both had none.
fn nearer(known: Range, new: Range) -> Range {
    match (known, finite(new)) {
        (Range::TooNear, _) | (_, Range::TooNear) => Range::TooNear,
        (Range::Hit(a), Range::Hit(b)) => Range::Hit(a.min(b)),
        (Range::Hit(a), _) | (_, Range::Hit(a)) => Range::Hit(a),
        (Range::Error, _) | (_, Range::Error) => Range::Error,
        (Range::NoReturn, Range::NoReturn) => Range::NoReturn,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RANGE_M: (f32, f32) = (0.1, 12.0);

    fn sample(clockwise_deg: f64, range: Range) -> Sample {
        Sample { clockwise_rad: clockwise_deg.to_radians(), range }
    }

    /// The direction in degrees of every beam with a hit.
    fn hits_deg(mount: Mount, samples: &[Sample]) -> Vec<f64> {
        let geometry = circle(450.0, RANGE_M, 1);
        let mut revolution = Revolution::new(&geometry, mount);
        samples.iter().for_each(|sample| revolution.add(sample));
        let mut ranges = Vec::new();
        revolution.finish(&mut ranges);
        let hits = ranges.iter().enumerate().filter(|(_, range)| range.hit_m().is_some());
        hits.map(|(beam, _)| (geometry.angle_rad(beam).to_degrees() * 10.0).round() / 10.0)
            .collect()
    }

    #[test]
    fn clockwise_measurements_become_counter_clockwise_beams() {
        let right = [sample(90.0, Range::Hit(1.0))];
        assert_eq!(hits_deg(Mount::default(), &right), [-90.0], "clockwise of ahead is right");
        let left = [sample(270.0, Range::Hit(1.0))];
        assert_eq!(hits_deg(Mount::default(), &left), [90.0]);
        let behind = [sample(180.0, Range::Hit(1.0))];
        assert_eq!(hits_deg(Mount::default(), &behind), [-180.0]);
    }

    #[test]
    fn a_scanner_that_is_mounted_turned_or_upside_down_still_points_ahead() {
        let ahead = [sample(90.0, Range::Hit(1.0))];
        let turned = Mount { zero_rad: 90_f64.to_radians(), upside_down: false };
        assert_eq!(hits_deg(turned, &ahead), [0.0]);
        let over = Mount { zero_rad: 0.0, upside_down: true };
        assert_eq!(hits_deg(over, &ahead), [90.0]);
    }

    /// The clockwise directions, in degrees, of the measurements that begin a revolution.
    fn begins_deg(mount: Mount, clockwise_deg: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut revolution = Revolution::new(&mount.geometry(circle(450.0, RANGE_M, 1)), mount);
        let mut begins = Vec::new();
        let mut before_deg = [0.0; 2];
        for degrees in clockwise_deg.map(|degrees| degrees.rem_euclid(360.0)) {
            if revolution.push(&sample(degrees, Range::Hit(1.0)), &mut Vec::new()) {
                begins.push(before_deg[0]);
            }
            before_deg = [before_deg[1], degrees];
        }
        begins
    }

    #[test]
    fn revolutions_begin_straight_behind_however_the_scanner_is_mounted() {
        let three = || (0..1500).map(|index| 90.25 + 0.75 * f64::from(index));
        // The beam that points straight behind ends a clockwise revolution, and begins one counter-clockwise.
        assert_eq!(begins_deg(Mount::default(), three()), [181.0; 3]);
        let turned = Mount { zero_rad: 90_f64.to_radians(), upside_down: false };
        assert_eq!(begins_deg(turned, three()), [271.0; 3], "the zero points to the left");
        let over = Mount { zero_rad: 90_f64.to_radians(), upside_down: true };
        assert_eq!(begins_deg(over, three()), [90.25; 3]);
    }

    #[test]
    fn neither_jitter_nor_missing_measurements_nor_a_wrong_direction_make_a_revolution_of_their_own()
     {
        let clean = || (0..1350).map(|index| 90.2 + 0.8 * f64::from(index));
        // The directions jump back and forth by 6 degrees.
        let jitter = clean().enumerate().map(|(index, degrees)| degrees - 6.0 * (index % 2) as f64);
        assert_eq!(begins_deg(Mount::default(), jitter).len(), 3);
        // 120 degrees around straight behind are missing.
        let gap = clean().filter(|degrees| (degrees.rem_euclid(360.0) - 180.0).abs() > 60.0);
        assert_eq!(begins_deg(Mount::default(), gap).len(), 3);
        for wrong_deg in (0..360).step_by(10).map(f64::from) {
            for at in 0..500 {
                // One measurement claims to be elsewhere.
                let wrong = clean()
                    .enumerate()
                    .map(|(index, degrees)| if index == at { wrong_deg } else { degrees });
                let begins = begins_deg(Mount::default(), wrong);
                assert_eq!(begins.len(), 3, "measurement {at} at {wrong_deg} degrees");
            }
        }
    }

    #[test]
    fn a_scanner_that_is_mounted_upside_down_measures_counter_clockwise() {
        let upright = circle(450.0, RANGE_M, 1);
        let over = Mount { zero_rad: 0.0, upside_down: true };
        assert!(Mount::default().geometry(upright).clockwise);
        assert!(!over.geometry(upright).clockwise);
    }

    #[test]
    fn beams_without_a_measurement_are_errors_and_are_forgotten_with_the_revolution() {
        let geometry = circle(450.0, RANGE_M, 1);
        let mut revolution = Revolution::new(&geometry, Mount::default());
        revolution.add(&sample(0.0, Range::NoReturn));
        let mut ranges = Vec::new();
        revolution.finish(&mut ranges);
        assert_eq!(ranges.iter().filter(|range| **range == Range::Error).count(), 399);
        revolution.finish(&mut ranges);
        assert!(ranges.iter().all(|range| *range == Range::Error));
    }

    #[test]
    fn of_several_measurements_in_a_beam_the_nearest_counts_and_doubt_is_no_free_space() {
        for (a, b, expected) in [
            (Range::Hit(2.0), Range::Hit(1.0), Range::Hit(1.0)),
            (Range::NoReturn, Range::Hit(1.0), Range::Hit(1.0)),
            (Range::Hit(1.0), Range::Error, Range::Hit(1.0)),
            (Range::Hit(1.0), Range::TooNear, Range::TooNear),
            (Range::NoReturn, Range::Error, Range::Error),
            (Range::NoReturn, Range::NoReturn, Range::NoReturn),
            (Range::NoReturn, Range::Hit(f32::NAN), Range::Error),
        ] {
            assert_eq!(nearer(a, b), expected, "{a:?} {b:?}");
            assert_eq!(finite(Range::Hit(f32::NAN)), Range::Error);
        }
    }

    #[test]
    fn every_beam_of_a_revolution_is_measured_up_to_a_tenth_above_the_nominal_rate() {
        for samples_per_revolution in [450.0, 727.0, 400.0, 363.0, 3200.0, 200.0] {
            let geometry = circle(samples_per_revolution, RANGE_M, 1);
            let fast = (samples_per_revolution / FASTER).floor() as usize;
            let mut revolution = Revolution::new(&geometry, Mount::default());
            for index in 0..fast {
                revolution.add(&sample(360.0 * index as f64 / fast as f64, Range::Hit(1.0)));
            }
            let mut ranges = Vec::new();
            revolution.finish(&mut ranges);
            assert!(ranges.iter().all(|range| range.hit_m().is_some()), "{samples_per_revolution}");
        }
    }

    proptest! {
        #[test]
        fn any_direction_has_a_beam_within_half_a_step(
            clockwise_rad in 0.0..TAU,
            zero_rad in -PI..PI,
            upside_down: bool,
        ) {
            let geometry = circle(450.0, RANGE_M, 1);
            let mount = Mount { zero_rad, upside_down };
            let revolution = Revolution::new(&geometry, mount);
            let beam = revolution.beam(clockwise_rad);
            prop_assert!(beam < geometry.beams);
            let off_rad = hal::wrap_angle(geometry.angle_rad(beam) - mount.angle_rad(clockwise_rad));
            prop_assert!(off_rad.abs() <= 0.5 * geometry.angle_increment_rad + 1e-9);
        }
    }
}
