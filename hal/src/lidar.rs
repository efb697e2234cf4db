//! The planar safety LiDAR: its geometry, its scans and its trait.

use alloc::vec::Vec;

use crate::ErrorType;

/// The result of one beam. `NoReturn` does not mean "free space", and neither does `Error`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Range {
    /// An object at this distance along the beam, metres.
    Hit(f32),
    /// No echo within the sensor's range: there is nothing, or something black, shiny or
    /// transparent.
    #[default]
    NoReturn,
    /// An object nearer than the sensor can measure.
    TooNear,
    /// The sensor could not measure this beam.
    Error,
}

impl Range {
    /// The distance in metres if the beam hit something.
    #[must_use]
    pub fn hit_m(self) -> Option<f32> {
        match self {
            Self::Hit(distance_m) => Some(distance_m),
            _ => None,
        }
    }
}

/// Directions, limits and times of the beams of a scan. Angles are counter-clockwise from the x axis of
/// the `laser` frame.
///
/// A revolution begins and ends straight behind, at an angle of pi, so that the beam straight ahead is measured in its middle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanGeometry {
    /// Direction of the first beam, -pi or more. That of the last beam is pi or less.
    pub angle_min_rad: f64,
    /// Angle between neighbouring beams; positive.
    pub angle_increment_rad: f64,
    pub beams: usize,
    /// Shortest distance that the sensor measures.
    pub range_min_m: f32,
    /// Longest distance that the sensor measures.
    pub range_max_m: f32,
    /// Time from the start of one scan to the start of the next: of one revolution.
    pub period_ns: u64,
    /// The scanner rotates clockwise, seen against the z axis of the `laser` frame: the last beam is measured first.
    pub clockwise: bool,
}

impl ScanGeometry {
    /// The Hokuyo UTM-30LX according to its data sheet: 270 degrees in 1081 beams, 0.1 to 30 m, 25
    /// ms.
    pub const UTM_30LX: Self = Self {
        angle_min_rad: -0.75 * core::f64::consts::PI,
        angle_increment_rad: 1.5 * core::f64::consts::PI / 1080.0,
        beams: 1081,
        range_min_m: 0.1,
        range_max_m: 30.0,
        period_ns: 25_000_000,
        clockwise: false,
    };

    /// The LDROBOT LD06 at its usual rate, as its driver reports it: a whole circle in 400 beams, 0.02 to 12 m, 100 ms, clockwise.
    pub const LD06: Self = Self {
        angle_min_rad: -core::f64::consts::PI,
        angle_increment_rad: core::f64::consts::TAU / 400.0,
        beams: 400,
        range_min_m: 0.02,
        range_max_m: 12.0,
        period_ns: 100_000_000,
        clockwise: true,
    };

    #[must_use]
    pub fn angle_rad(&self, beam: usize) -> f64 {
        self.angle_min_rad + self.angle_increment_rad * beam as f64
    }

    /// Time from the middle of a scan to a beam, seconds; negative for beams that are measured before.
    #[must_use]
    pub fn after_middle_s(&self, beam: usize) -> f64 {
        let rotated_rad = if self.clockwise { -self.angle_rad(beam) } else { self.angle_rad(beam) };
        rotated_rad / core::f64::consts::TAU * (self.period_ns as f64 * 1e-9)
    }
}

/// The ranges of one revolution of the scanner. It owns its memory and is meant to be reused.
#[derive(Debug, PartialEq)]
pub struct LaserScan {
    /// Start of the scan on the monotonic clock.
    pub time_ns: u64,
    pub geometry: ScanGeometry,
    /// One entry per beam, in the order of [`ScanGeometry::angle_rad`].
    pub ranges: Vec<Range>,
}

impl LaserScan {
    /// A scan without ranges, with capacity for all beams, to pass to [`Lidar::poll_scan`].
    #[must_use]
    pub fn empty(geometry: ScanGeometry) -> Self {
        Self { time_ns: 0, geometry, ranges: Vec::with_capacity(geometry.beams) }
    }

    /// The time halfway through the scan, monotonic nanoseconds.
    #[must_use]
    pub fn middle_ns(&self) -> u64 {
        self.time_ns.saturating_add(self.geometry.period_ns / 2)
    }

    /// The angle in radians and the distance in metres of every beam that hit something.
    pub fn hits(&self) -> impl Iterator<Item = (f64, f32)> + '_ {
        self.ranges
            .iter()
            .enumerate()
            .filter_map(|(beam, range)| Some((self.geometry.angle_rad(beam), range.hit_m()?)))
    }
}

/// `clone_from` reuses the buffer of the scan that it overwrites, so that a real-time thread can
/// copy scans without allocating.
impl Clone for LaserScan {
    fn clone(&self) -> Self {
        Self { ranges: self.ranges.clone(), ..*self }
    }

    fn clone_from(&mut self, source: &Self) {
        self.time_ns = source.time_ns;
        self.geometry = source.geometry;
        self.ranges.clone_from(&source.ranges);
    }
}

/// A planar laser scanner, mounted level, in the `laser` frame.
///
/// * *Blocking*: no method blocks.
/// * *Freshness*: returns the newest complete scan once. When no scan has arrived for more than two
///   periods, it returns [`Timeout`](crate::ErrorKind::Timeout), not an old scan.
/// * *Unplug*: returns [`Disconnected`](crate::ErrorKind::Disconnected) until the driver has
///   reopened the device and received several good scans in a row.
/// * *Retries*: the driver retries; the caller only polls.
pub trait Lidar: ErrorType {
    /// Directions and limits of this scanner's beams.
    fn geometry(&self) -> ScanGeometry;

    /// Copies the newest scan into `scan` and returns true. Returns false when there is no scan
    /// that was not returned before.
    ///
    /// # Errors
    /// As described for the trait. A scan with a wrong checksum is dropped and reported as
    /// [`Corrupt`](crate::ErrorKind::Corrupt).
    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_utm_30lx_covers_270_degrees_with_its_middle_beam_straight_ahead() {
        let geometry = ScanGeometry::UTM_30LX;
        assert!((geometry.angle_rad(0) + 0.75 * core::f64::consts::PI).abs() < 1e-12);
        assert!(geometry.angle_rad(540).abs() < 1e-12);
        assert!((geometry.angle_rad(1080) - 0.75 * core::f64::consts::PI).abs() < 1e-12);
    }

    #[test]
    fn the_beam_ahead_is_measured_in_the_middle_and_those_to_the_right_before_or_after_it() {
        let hokuyo = ScanGeometry::UTM_30LX;
        let others = ScanGeometry { clockwise: true, ..hokuyo };
        for geometry in [hokuyo, others] {
            assert!(geometry.after_middle_s(540).abs() < 1e-12);
        }
        // Three eighths of 25 ms to the right, where the angle is negative.
        assert!((hokuyo.after_middle_s(0) + 0.009_375).abs() < 1e-12);
        assert!((others.after_middle_s(0) - 0.009_375).abs() < 1e-12);
    }

    #[test]
    fn beams_without_a_distance_are_not_among_the_hits() {
        let mut scan = LaserScan::empty(ScanGeometry::UTM_30LX);
        scan.ranges.extend([Range::NoReturn, Range::Hit(1.0), Range::TooNear, Range::Error]);
        assert_eq!(scan.hits().count(), 1);
    }
}
