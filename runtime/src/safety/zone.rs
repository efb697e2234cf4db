//! What a scan says about the ground that a round robot is about to drive over.

use hal::{LaserScan, Range};

/// Share of error beams above which a scan is no longer believed.
const MAX_ERROR_SHARE: f64 = 0.5;
/// Neighbouring beams that must agree before a return counts: a single one is rain, dust or crosstalk.
const MIN_NEIGHBOURS: usize = 2;
/// Neighbouring beams "agree" when their ranges differ by less than this: twice the ±30 mm of a UTM-30LX, and slack.
const NEIGHBOUR_GAP_M: f64 = 0.08;

/// The strip in front of (or behind) a round footprint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopZone {
    /// Radius of the footprint, metres.
    pub radius_m: f64,
    /// Free way that must remain between footprint and obstacle, metres.
    pub distance_m: f64,
}

/// Something in the stop zone, in `base_link`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obstacle {
    /// Forward, metres.
    pub x_m: f64,
    /// Left, metres.
    pub y_m: f64,
    /// Free way to it along x, metres; negative inside the footprint.
    pub gap_m: f64,
    /// The sensor only knows that it is nearer than it can measure.
    pub too_near: bool,
}

/// Whether a scan may be driven by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanHealth {
    /// Enough beams measured something.
    Good,
    /// Too many beams are errors, or not one of all beams came back: a covered, blinded or broken sensor. A home has walls.
    Bad,
}

impl ScanHealth {
    /// Judges a scan.
    #[must_use]
    pub fn of(scan: &LaserScan) -> Self {
        let errors = scan.ranges.iter().filter(|range| matches!(range, Range::Error)).count();
        let measured = scan.ranges.iter().any(|range| matches!(range, Range::Hit(_) | Range::TooNear));
        let too_many_errors = errors as f64 > MAX_ERROR_SHARE * scan.ranges.len() as f64;
        if too_many_errors || !measured || scan.ranges.len() != scan.geometry.beams { Self::Bad } else { Self::Good }
    }
}

impl StopZone {
    /// The nearest obstacle on the way forward (`sign` = 1.0) or backward (-1.0) that leaves less than `distance_m`.
    /// The laser sits at `base_link`'s centre, `laser_forward_m` in front of it.
    #[must_use]
    pub fn nearest(&self, scan: &LaserScan, laser_forward_m: f64, sign: f64) -> Option<Obstacle> {
        let mut nearest: Option<Obstacle> = None;
        let mut neighbours = 0;
        let mut last_m = f64::NEG_INFINITY;
        for (beam, range) in scan.ranges.iter().enumerate() {
            let (range_m, too_near) = match *range {
                Range::Hit(range_m) => (f64::from(range_m), false),
                Range::TooNear => (f64::from(scan.geometry.range_min_m), true),
                Range::NoReturn | Range::Error => {
                    neighbours = 0;
                    continue;
                }
            };
            let angle = scan.geometry.angle_rad(beam);
            let x_m = laser_forward_m + range_m * angle.cos();
            let y_m = range_m * angle.sin();
            let Some(gap_m) = self.gap_m(sign * x_m, y_m).filter(|gap| *gap < self.distance_m) else {
                neighbours = 0;
                continue;
            };
            neighbours = if (range_m - last_m).abs() < NEIGHBOUR_GAP_M { neighbours + 1 } else { 1 };
            last_m = range_m;
            if neighbours >= MIN_NEIGHBOURS && nearest.is_none_or(|known| gap_m < known.gap_m) {
                nearest = Some(Obstacle { x_m, y_m, gap_m, too_near });
            }
        }
        nearest
    }

    /// Free way along x from the footprint's edge to a point ahead; `None` when driving on does not touch it.
    fn gap_m(&self, ahead_m: f64, across_m: f64) -> Option<f64> {
        if ahead_m <= 0.0 || across_m.abs() >= self.radius_m {
            return None;
        }
        Some(ahead_m - (self.radius_m * self.radius_m - across_m * across_m).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::ScanGeometry;

    pub(crate) const ZONE: StopZone = StopZone { radius_m: 0.16, distance_m: 0.1 };

    fn scan_of(range_at: impl Fn(f64) -> Range) -> LaserScan {
        let geometry = ScanGeometry::UTM_30LX;
        let ranges = (0..geometry.beams).map(|beam| range_at(geometry.angle_rad(beam))).collect();
        LaserScan { time_ns: 0, geometry, ranges }
    }

    /// A wall across the way, `distance_m` ahead of the sensor.
    fn wall_ahead(distance_m: f64) -> LaserScan {
        scan_of(|angle| match angle.cos() {
            cos if cos > 0.1 => Range::Hit((distance_m / cos) as f32),
            _ => Range::NoReturn,
        })
    }

    #[test]
    fn a_wall_nearer_than_the_stop_distance_is_found_with_its_gap() {
        let obstacle = ZONE.nearest(&wall_ahead(0.25), 0.0, 1.0).unwrap();
        assert!((obstacle.gap_m - 0.09).abs() < 1e-3, "{obstacle:?}");
        assert!(ZONE.nearest(&wall_ahead(0.27), 0.0, 1.0).is_none());
    }

    #[test]
    fn a_wall_ahead_does_not_block_the_way_back() {
        assert!(ZONE.nearest(&wall_ahead(0.2), 0.0, -1.0).is_none());
    }

    #[test]
    fn a_wall_beside_the_robot_is_passed() {
        let beside = scan_of(|angle| match angle.sin() {
            sin if sin > 0.1 => Range::Hit((0.18 / sin) as f32),
            _ => Range::Hit(5.0),
        });
        assert!(ZONE.nearest(&beside, 0.0, 1.0).is_none());
    }

    #[test]
    fn a_single_stray_return_is_not_an_obstacle_but_a_thin_leg_is() {
        let beam_rad = ScanGeometry::UTM_30LX.angle_increment_rad;
        let stray = scan_of(|angle| if angle.abs() < 0.4 * beam_rad { Range::Hit(0.2) } else { Range::Hit(3.0) });
        assert!(ZONE.nearest(&stray, 0.0, 1.0).is_none());
        let leg = scan_of(|angle| if angle.abs() < 0.05 { Range::Hit(0.2) } else { Range::Hit(3.0) });
        assert!(ZONE.nearest(&leg, 0.0, 1.0).is_some());
    }

    #[test]
    fn too_near_ahead_is_an_obstacle_and_no_return_is_not() {
        let near = scan_of(|angle| if angle.abs() < 0.3 { Range::TooNear } else { Range::Hit(3.0) });
        assert!(ZONE.nearest(&near, 0.0, 1.0).unwrap().too_near);
        assert!(ZONE.nearest(&scan_of(|_| Range::NoReturn), 0.0, 1.0).is_none());
    }

    #[test]
    fn blind_and_broken_scans_are_bad_and_an_ordinary_one_is_good() {
        assert_eq!(ScanHealth::of(&scan_of(|_| Range::NoReturn)), ScanHealth::Bad);
        assert_eq!(ScanHealth::of(&scan_of(|_| Range::Error)), ScanHealth::Bad);
        assert_eq!(ScanHealth::of(&wall_ahead(1.0)), ScanHealth::Good);
        let mut short = wall_ahead(1.0);
        short.ranges.pop();
        assert_eq!(ScanHealth::of(&short), ScanHealth::Bad);
    }
}
