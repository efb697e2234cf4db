//! The planar safety LiDAR.

use alloc::vec::Vec;

use crate::ErrorType;

/// What one beam met. "No return" is not "free", and an error is neither.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Range {
    /// Something at this distance along the beam, metres.
    Hit(f32),
    /// Nothing came back within the sensor's range: nothing there, or something black, shiny or transparent.
    #[default]
    NoReturn,
    /// Something nearer than the sensor can measure.
    TooNear,
    /// The sensor could not measure this beam.
    Error,
}

impl Range {
    /// The distance of a hit, metres.
    #[must_use]
    pub fn hit_m(self) -> Option<f32> {
        match self {
            Self::Hit(distance_m) => Some(distance_m),
            _ => None,
        }
    }
}

/// Where the beams of a scan point and how far they reach. Angles counter-clockwise from the `laser` frame's x axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanGeometry {
    /// Direction of the first beam, radians.
    pub angle_min_rad: f64,
    /// Angle between neighbouring beams, radians, positive.
    pub angle_increment_rad: f64,
    /// Number of beams.
    pub beams: usize,
    /// Shortest distance that is measured, metres.
    pub range_min_m: f32,
    /// Longest distance that is measured, metres.
    pub range_max_m: f32,
    /// Time between two scans.
    pub period_ns: u64,
}

impl ScanGeometry {
    /// Hokuyo UTM-30LX by its data sheet: 270 degrees in 1081 beams, 0.1 to 30 m, 25 ms.
    pub const UTM_30LX: Self = Self {
        angle_min_rad: -0.75 * core::f64::consts::PI,
        angle_increment_rad: 1.5 * core::f64::consts::PI / 1080.0,
        beams: 1081,
        range_min_m: 0.1,
        range_max_m: 30.0,
        period_ns: 25_000_000,
    };

    /// Direction of a beam, radians.
    #[must_use]
    pub fn angle_rad(&self, beam: usize) -> f64 {
        self.angle_min_rad + self.angle_increment_rad * beam as f64
    }
}

/// One turn of the scanner. Owns its memory and is made to be reused.
#[derive(Debug, PartialEq)]
pub struct LaserScan {
    /// Start of the scan, monotonic.
    pub time_ns: u64,
    /// Beams and limits.
    pub geometry: ScanGeometry,
    /// One entry a beam, in the order of [`ScanGeometry::angle_rad`].
    pub ranges: Vec<Range>,
}

impl LaserScan {
    /// A scan without beams, to hand to [`Lidar::poll_scan`].
    #[must_use]
    pub fn empty(geometry: ScanGeometry) -> Self {
        Self { time_ns: 0, geometry, ranges: Vec::with_capacity(geometry.beams) }
    }

    /// The time halfway through the scan, monotonic nanoseconds.
    #[must_use]
    pub fn middle_ns(&self) -> u64 {
        self.time_ns + self.geometry.period_ns / 2
    }

    /// Angle (radians) and distance (metres) of every beam that hit something.
    pub fn hits(&self) -> impl Iterator<Item = (f64, f32)> + '_ {
        self.ranges
            .iter()
            .enumerate()
            .filter_map(|(beam, range)| Some((self.geometry.angle_rad(beam), range.hit_m()?)))
    }
}

/// `clone_from` reuses the room of the scan that it overwrites: a real-time thread hands scans on without allocating.
impl Clone for LaserScan {
    fn clone(&self) -> Self {
        Self { ranges: self.ranges.clone(), ..*self }
    }

    fn clone_from(&mut self, source: &Self) {
        (self.time_ns, self.geometry) = (source.time_ns, source.geometry);
        self.ranges.clone_from(&source.ranges);
    }
}

/// A planar scanner, level, in the `laser` frame.
///
/// * *Blocking*: none.
/// * *Freshness*: hands out the newest complete scan once. Silence for more than two periods is
///   [`Timeout`](crate::ErrorKind::Timeout), not an old scan.
/// * *Unplug*: [`Disconnected`](crate::ErrorKind::Disconnected) until the driver has reopened it and several good scans
///   in a row have come.
/// * *Who retries*: the driver.
pub trait Lidar: ErrorType {
    /// Beams and limits of this scanner.
    fn geometry(&self) -> ScanGeometry;

    /// Copies the newest scan that was not handed out before into `scan` and returns true; false when there is none.
    ///
    /// # Errors
    /// See the trait's own notes; a scan with a wrong checksum is [`Corrupt`](crate::ErrorKind::Corrupt) and dropped.
    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_utm_30lx_looks_270_degrees_around_with_its_middle_beam_ahead() {
        let geometry = ScanGeometry::UTM_30LX;
        assert!((geometry.angle_rad(540)).abs() < 1e-12);
        assert!((geometry.angle_rad(1080) - 0.75 * core::f64::consts::PI).abs() < 1e-12);
    }

    #[test]
    fn only_hits_are_hits() {
        let mut scan = LaserScan::empty(ScanGeometry::UTM_30LX);
        scan.ranges.extend([Range::NoReturn, Range::Hit(1.0), Range::TooNear, Range::Error]);
        assert_eq!(scan.hits().count(), 1);
    }
}
