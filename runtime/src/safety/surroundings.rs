//! The obstacles of the newest LiDAR scan.

use hal::{LaserScan, Pose2, Range, ScanGeometry};
use serde::{Deserialize, Serialize};

use super::corridor::View;
use super::{BodySector, Footprint, SafetyConfig};
use crate::snapshot::remembers;

/// A scan with a larger share of error beams is bad.
const MAX_ERROR_SHARE: f64 = 0.5;
/// Number of neighbouring beams that must agree before a return counts as an obstacle: a single
/// return is dust or crosstalk. Within one metre the beams of a scanner with 0.25 degrees of
/// resolution are at most 4 mm apart, so a chair leg always meets several of them.
const MIN_RUN: usize = 2;
/// Neighbouring beams agree when their ranges differ by less than this: twice the ±30 mm accuracy
/// of a UTM-30LX, plus 20 mm of tolerance.
const NEIGHBOUR_GAP_M: f32 = 0.08;
/// Fringe, fur or a plant returns only some beams, at different depths. A return also counts as part
/// of an obstacle if one of this many beams before it returned from a similar distance, and if the
/// scan before had such a return there, too. Two stray returns at one place in two scans are rare.
const SPARSE_BEAMS: usize = 4;
/// Depth of such an obstacle, metres.
const SPARSE_GAP_M: f32 = 0.12;
/// With beams wider apart than this, a chair leg of 25 mm may meet a single beam at the horizon. A single
/// return then counts as an obstacle if the scan before had one at about the same place: two stray
/// returns at one place in two scans are rare.
const FEW_BEAMS_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Horizon: obstacles farther from the laser than this are ignored, metres. A large configured stop
/// distance extends it.
pub(super) const HORIZON_M: f32 = 1.5;
/// The horizon lies at least this far beyond the stop distance, metres.
const SIGHT_M: f64 = 1.0;

/// A LiDAR return near the robot, in `base_link` (x forward, y left).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Obstacle {
    pub x_m: f64,
    pub y_m: f64,
    /// The obstacle is nearer than the sensor's minimum range; its position is that of the minimum
    /// range.
    pub too_near: bool,
}

impl Obstacle {
    #[must_use]
    pub fn point_m(&self) -> [f64; 2] {
        [self.x_m, self.y_m]
    }
}

/// Whether a scan is good enough to drive by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanHealth {
    Good,
    /// More than half of the beams are errors, no beam returned, or beams are missing: the sensor
    /// is covered, blinded or broken. In a home some beam always meets a wall.
    Bad,
}

impl ScanHealth {
    #[must_use]
    pub fn of(scan: &LaserScan) -> Self {
        let errors = scan.ranges.iter().filter(|range| is_error(**range)).count();
        let measured = scan.ranges.iter().any(|range| distance_m(*range, &scan.geometry).is_some());
        let too_many_errors = errors as f64 > MAX_ERROR_SHARE * scan.ranges.len() as f64;
        if too_many_errors || !measured || scan.ranges.len() != scan.geometry.beams {
            Self::Bad
        } else {
            Self::Good
        }
    }
}

/// Whether a scanner has so few beams that thin obstacles count only in the second scan that shows them.
#[must_use]
pub fn needs_second_scan(geometry: &ScanGeometry) -> bool {
    geometry.angle_increment_rad > FEW_BEAMS_RAD + 1e-9
}

/// A range that is not finite or is negative counts as an error even if the driver reports it as a
/// hit.
pub(super) fn is_error(range: Range) -> bool {
    match range {
        Range::Hit(range_m) => !(range_m.is_finite() && range_m >= 0.0),
        Range::Error => true,
        Range::NoReturn | Range::TooNear => false,
    }
}

/// Distance of a beam's return, metres. For a return below the minimum range this is the minimum
/// range: an upper bound.
pub(super) fn distance_m(range: Range, geometry: &ScanGeometry) -> Option<f32> {
    match range {
        Range::TooNear => Some(geometry.range_min_m),
        range => range.hit_m().filter(|_| !is_error(range)),
    }
}

/// The newest scan as obstacle points in `base_link`. It allocates memory only when the scan
/// geometry changes.
#[derive(Debug, Clone, PartialEq)]
pub struct Surroundings {
    t_base_laser: Pose2,
    horizon_m: f32,
    body: Vec<BodySector>,
    /// One entry for every beam of `geometry`.
    beams: Vec<Beam>,
    geometry: Option<ScanGeometry>,
    obstacles: Vec<Obstacle>,
    /// Sum of the ranges to the left minus the sum of the ranges to the right, each range limited
    /// to 2 m.
    left_minus_right_m: f32,
    /// Ranges of sparse returns of this scan and of the one before, by beam, metres; infinite where
    /// there was none.
    sparse_m: Vec<f32>,
    sparse_before_m: Vec<f32>,
    view: View,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Beam {
    /// Its direction in `base_link`.
    cos: f64,
    sin: f64,
    /// Returns up to this distance come from the robot's own body, metres.
    own_body_m: f32,
}

impl Beam {
    /// A beam at `angle_rad` in the frame of a laser that is turned by `yaw_rad`.
    fn new(angle_rad: f64, yaw_rad: f64, body: &[BodySector]) -> Self {
        let own_sectors = body
            .iter()
            .filter(|part| (part.from_deg..=part.to_deg).contains(&angle_rad.to_degrees()));
        let own_body_m = own_sectors.map(|part| part.up_to_m as f32).fold(0.0, f32::max);
        let (sin, cos) = (angle_rad + yaw_rad).sin_cos();
        Self { cos, sin, own_body_m }
    }
}

impl Surroundings {
    /// Surroundings before the first scan: no obstacles.
    #[must_use]
    pub fn new(config: &SafetyConfig) -> Self {
        let footprint = Footprint::new(config.footprint_radius_m, &config.footprint_m);
        let needed_m = config.t_base_laser.x_m.hypot(config.t_base_laser.y_m)
            + footprint.circumscribed_radius_m()
            + config.stop_distance_m
            + SIGHT_M;
        Self {
            t_base_laser: config.t_base_laser,
            horizon_m: needed_m.max(f64::from(HORIZON_M)) as f32,
            body: config.body.clone(),
            beams: Vec::new(),
            geometry: None,
            obstacles: Vec::new(),
            left_minus_right_m: 0.0,
            sparse_m: Vec::new(),
            sparse_before_m: Vec::new(),
            view: View::default(),
        }
    }

    fn set_geometry(&mut self, geometry: ScanGeometry) {
        let yaw_rad = self.t_base_laser.yaw_rad;
        self.beams = (0..geometry.beams)
            .map(|index| Beam::new(geometry.angle_rad(index), yaw_rad, &self.body))
            .collect();
        self.obstacles.reserve(geometry.beams);
        self.sparse_m.reserve(geometry.beams);
        self.sparse_before_m.reserve(geometry.beams);
        self.geometry = Some(geometry);
    }

    /// Replaces the obstacles with those of a new scan.
    pub fn update(&mut self, scan: &LaserScan) {
        if self.geometry != Some(scan.geometry) {
            self.set_geometry(scan.geometry);
        }
        self.view.update(scan);
        self.obstacles.clear();
        self.left_minus_right_m = 0.0;
        std::mem::swap(&mut self.sparse_m, &mut self.sparse_before_m);
        self.sparse_m.clear();
        self.sparse_m.resize(scan.ranges.len(), f32::INFINITY);
        let has_few_beams = needs_second_scan(&scan.geometry);
        let mut run_length = 0;
        let mut last_m = f32::NEG_INFINITY;
        let mut recent_m = [f32::INFINITY; SPARSE_BEAMS];
        for (index, (beam, range)) in self.beams.iter().zip(&scan.ranges).enumerate() {
            let before_m = recent_m;
            recent_m.rotate_right(1);
            recent_m[0] = f32::INFINITY;
            // An error beam carries no information, so it does not interrupt a run of agreeing
            // beams.
            if is_error(*range) {
                continue;
            }
            let Some(range_m) = distance_m(*range, &scan.geometry) else {
                run_length = 0;
                continue;
            };
            self.left_minus_right_m += range_m.min(2.0).copysign(beam.sin as f32);
            if range_m > self.horizon_m || range_m <= beam.own_body_m {
                run_length = 0;
                continue;
            }
            recent_m[0] = range_m;
            run_length =
                if (range_m - last_m).abs() < NEIGHBOUR_GAP_M { run_length + 1 } else { 1 };
            last_m = range_m;
            let is_sparse = has_few_beams || agrees(&before_m, range_m);
            if is_sparse && let Some(sparse_m) = self.sparse_m.get_mut(index) {
                *sparse_m = range_m;
            }
            let is_obstacle = run_length >= MIN_RUN
                || is_sparse && agrees(around(&self.sparse_before_m, index), range_m);
            if is_obstacle {
                let range_m = f64::from(range_m);
                self.obstacles.push(Obstacle {
                    x_m: self.t_base_laser.x_m + range_m * beam.cos,
                    y_m: self.t_base_laser.y_m + range_m * beam.sin,
                    too_near: *range == Range::TooNear,
                });
            }
        }
    }

    /// Whether the scanner does not see a part of the path of a forward twist.
    #[must_use]
    pub fn is_blind_ahead(&self, footprint: &Footprint, twist: &hal::Twist2) -> bool {
        self.geometry.is_some_and(|geometry| {
            self.view.is_blind(&geometry, &self.t_base_laser, footprint, twist)
        })
    }

    /// Returns of this beam up to this distance come from the robot's own body, metres; 0 if the
    /// beam does not meet it.
    pub(super) fn own_body_m(&self, beam: usize) -> f32 {
        self.beams.get(beam).map_or(0.0, |beam| beam.own_body_m)
    }

    /// Distance straight ahead of the outline within which every obstacle is known, metres.
    #[must_use]
    pub fn visible_ahead_m(&self, footprint: &Footprint) -> f64 {
        let horizon_m = f64::from(self.horizon_m);
        let left_m = self.t_base_laser.y_m;
        let ahead_m = (horizon_m * horizon_m - left_m * left_m).sqrt();
        ahead_m + self.t_base_laser.x_m - footprint.front_edge_m()
    }

    /// All returns within the horizon, without single stray returns and the robot's own body.
    #[must_use]
    pub fn obstacles(&self) -> &[Obstacle] {
        &self.obstacles
    }

    /// The obstacle that the footprint would meet first when the robot drives with `twist`, and the
    /// free distance to it, metres; `None` if it meets none within `reach_m`.
    #[must_use]
    pub fn first_obstacle(
        &self,
        footprint: &Footprint,
        twist: &hal::Twist2,
        reach_m: f64,
    ) -> Option<(Obstacle, f64)> {
        // Limits the work: no obstacle is known beyond the horizon.
        let reach_m = reach_m.min(2.0 * f64::from(self.horizon_m));
        self.obstacles
            .iter()
            .filter_map(|obstacle| {
                Some((*obstacle, footprint.gap_m(obstacle.point_m(), twist, reach_m)?))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The side with more free space: +1 left, -1 right.
    #[must_use]
    pub fn side_with_more_space(&self) -> f64 {
        if self.left_minus_right_m >= 0.0 { 1.0 } else { -1.0 }
    }
}

/// Whether one of the ranges is about this one.
fn agrees(ranges_m: &[f32], range_m: f32) -> bool {
    ranges_m.iter().any(|other_m| (other_m - range_m).abs() < SPARSE_GAP_M)
}

/// The entries around a beam.
fn around(ranges_m: &[f32], beam: usize) -> &[f32] {
    let end = (beam + SPARSE_BEAMS + 1).min(ranges_m.len());
    ranges_m.get(beam.saturating_sub(SPARSE_BEAMS)..end).unwrap_or_default()
}

remembers!(Surroundings: obstacles, left_minus_right_m, sparse_m, sparse_before_m, view);

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use hal::Twist2;

    const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };

    pub fn scan_of(range_at: impl Fn(f64) -> Range) -> LaserScan {
        let geometry = ScanGeometry::UTM_30LX;
        let ranges = (0..geometry.beams).map(|beam| range_at(geometry.angle_rad(beam))).collect();
        LaserScan { time_ns: 0, geometry, ranges }
    }

    /// A wall at a right angle to the x axis, `distance_m` ahead of the sensor.
    pub fn wall_ahead(distance_m: f64) -> LaserScan {
        scan_of(|angle| match angle.cos() {
            cos if cos > 0.1 => Range::Hit((distance_m / cos) as f32),
            _ => Range::NoReturn,
        })
    }

    #[test]
    fn the_entries_around_a_beam_are_four_on_each_side_as_far_as_there_are_any() {
        let ranges_m: Vec<f32> = (0..20_u8).map(f32::from).collect();
        for (beam, from, to) in [(8, 4, 12), (1, 0, 5), (18, 14, 19), (0, 0, 4), (19, 15, 19)] {
            assert_eq!(around(&ranges_m, beam), &ranges_m[from..=to], "{beam}");
        }
        assert!(around(&[], 0).is_empty());
    }

    #[test]
    fn only_scanners_with_more_than_half_a_degree_between_beams_need_a_second_scan() {
        let every_deg = |degrees: f64| ScanGeometry {
            angle_increment_rad: degrees.to_radians(),
            ..ScanGeometry::UTM_30LX
        };
        assert!(!needs_second_scan(&every_deg(0.5)), "exactly half a degree");
        // 720 beams a rotation, as a driver computes it.
        let rounded = ScanGeometry {
            angle_increment_rad: std::f64::consts::TAU / 720.0 + 1e-12,
            ..ScanGeometry::UTM_30LX
        };
        assert!(!needs_second_scan(&rounded));
        assert!(needs_second_scan(&every_deg(0.501)));
        assert!(needs_second_scan(&every_deg(1.0)));
    }

    fn with_laser_at(t_base_laser: Pose2) -> SafetyConfig {
        SafetyConfig { t_base_laser, ..SafetyConfig::default() }
    }

    fn first_obstacle(scan: &LaserScan, twist: Twist2) -> Option<(Obstacle, f64)> {
        first_obstacle_with(&SafetyConfig::default(), scan, twist)
    }

    fn first_obstacle_with(
        config: &SafetyConfig,
        scan: &LaserScan,
        twist: Twist2,
    ) -> Option<(Obstacle, f64)> {
        let mut surroundings = Surroundings::new(config);
        surroundings.update(scan);
        surroundings.first_obstacle(&Footprint::new(0.16, &[]), &twist, 0.1)
    }

    #[test]
    fn a_wall_nearer_than_the_reach_is_found_with_its_gap() {
        let (_, gap_m) = first_obstacle(&wall_ahead(0.25), FORWARD).unwrap();
        assert!((gap_m - 0.09).abs() < 1e-3, "{gap_m}");
        assert!(first_obstacle(&wall_ahead(0.27), FORWARD).is_none());
    }

    #[test]
    fn a_wall_ahead_does_not_block_reversing() {
        assert!(
            first_obstacle(&wall_ahead(0.2), Twist2 { linear_mps: -0.3, angular_radps: 0.0 })
                .is_none()
        );
    }

    #[test]
    fn a_wall_beside_the_robot_is_passed() {
        let beside = scan_of(|angle| match angle.sin() {
            sin if sin > 0.1 => Range::Hit((0.18 / sin) as f32),
            _ => Range::Hit(5.0),
        });
        assert!(first_obstacle(&beside, FORWARD).is_none());
    }

    #[test]
    fn a_single_stray_return_is_not_an_obstacle_but_a_thin_leg_is() {
        let beam_rad = ScanGeometry::UTM_30LX.angle_increment_rad;
        let stray =
            scan_of(
                |angle| {
                    if angle.abs() < 0.4 * beam_rad { Range::Hit(0.2) } else { Range::Hit(3.0) }
                },
            );
        assert!(first_obstacle(&stray, FORWARD).is_none());
        let leg =
            scan_of(|angle| if angle.abs() < 0.05 { Range::Hit(0.2) } else { Range::Hit(3.0) });
        assert!(first_obstacle(&leg, FORWARD).is_some());
    }

    #[test]
    fn too_near_ahead_is_an_obstacle_and_no_return_is_not() {
        let near =
            scan_of(|angle| if angle.abs() < 0.3 { Range::TooNear } else { Range::Hit(3.0) });
        assert!(first_obstacle(&near, FORWARD).unwrap().0.too_near);
        assert!(first_obstacle(&scan_of(|_| Range::NoReturn), FORWARD).is_none());
    }

    #[test]
    fn the_robots_own_mast_is_not_an_obstacle_and_what_stands_behind_the_mast_is() {
        let body = vec![BodySector { from_deg: -10.0, to_deg: 10.0, up_to_m: 0.15 }];
        let config = SafetyConfig { body, ..SafetyConfig::default() };
        let mast =
            scan_of(|angle| if angle.abs() < 0.15 { Range::Hit(0.12) } else { Range::Hit(3.0) });
        assert!(first_obstacle(&mast, FORWARD).is_some());
        assert!(first_obstacle_with(&config, &mast, FORWARD).is_none());
        assert!(first_obstacle_with(&config, &wall_ahead(0.2), FORWARD).is_some());
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

    #[test]
    fn a_distance_that_is_none_is_an_error_whatever_the_driver_calls_it() {
        for none in [f32::NAN, f32::INFINITY, -0.2] {
            assert_eq!(ScanHealth::of(&scan_of(|_| Range::Hit(none))), ScanHealth::Bad, "{none}");
            assert!(first_obstacle(&scan_of(|_| Range::Hit(none)), FORWARD).is_none(), "{none}");
        }
    }

    #[test]
    fn half_of_the_beams_may_be_errors_and_not_one_more() {
        fn health_with(errors: usize) -> ScanHealth {
            let mut scan = scan_of(|_| Range::Hit(1.0));
            scan.ranges[..errors].fill(Range::Error);
            ScanHealth::of(&scan)
        }
        assert_eq!(health_with(540), ScanHealth::Good);
        assert_eq!(health_with(541), ScanHealth::Bad);
        assert_eq!(ScanHealth::of(&scan_of(|_| Range::TooNear)), ScanHealth::Good);
    }

    #[test]
    fn error_beams_between_returns_do_not_hide_an_obstacle_and_beams_without_return_do() {
        for (between, hidden) in
            [(Range::Error, false), (Range::Hit(f32::NAN), false), (Range::NoReturn, true)]
        {
            let mut scan = wall_ahead(0.2);
            scan.ranges.iter_mut().step_by(2).for_each(|range| *range = between);
            assert_eq!(first_obstacle(&scan, FORWARD).is_none(), hidden, "{between:?}");
        }
    }

    #[test]
    fn neighbours_agree_within_eight_centimetres() {
        fn teeth_are_an_obstacle(depth_m: f32) -> bool {
            let mut scan = scan_of(|_| Range::Hit(3.0));
            for beam in 535..545 {
                scan.ranges[beam] = Range::Hit(if beam % 2 == 0 { 0.2 } else { 0.2 + depth_m });
            }
            first_obstacle(&scan, FORWARD).is_some()
        }
        assert!(teeth_are_an_obstacle(0.079) && !teeth_are_an_obstacle(0.081));
    }

    #[test]
    fn what_returns_every_second_beam_or_is_rough_is_an_obstacle_in_the_second_scan() {
        fn obstacle_after_scans(range_m: impl Fn(usize) -> Range) -> Vec<bool> {
            let mut surroundings = Surroundings::new(&SafetyConfig::default());
            let mut scan = scan_of(|_| Range::Hit(3.0));
            (530..550).for_each(|beam| scan.ranges[beam] = range_m(beam));
            let robot = Footprint::new(0.16, &[]);
            let mut seen = Vec::new();
            for _ in 0..2 {
                surroundings.update(&scan);
                seen.push(surroundings.first_obstacle(&robot, &FORWARD, 0.1).is_some());
            }
            seen
        }
        assert_eq!(obstacle_after_scans(every_second), [false, true]);
        assert_eq!(obstacle_after_scans(rough), [false, true]);
        assert_eq!(obstacle_after_scans(single), [false, false]);
    }

    fn every_second(beam: usize) -> Range {
        if beam.is_multiple_of(2) { Range::Hit(0.2) } else { Range::NoReturn }
    }

    fn rough(beam: usize) -> Range {
        Range::Hit(0.2 + 0.09 * (beam % 2) as f32)
    }

    fn single(beam: usize) -> Range {
        if beam == 540 { Range::Hit(0.2) } else { Range::Hit(3.0) }
    }

    #[test]
    fn a_thin_leg_that_meets_one_of_few_beams_is_an_obstacle_in_the_second_scan() {
        fn obstacle_after_scans(beams: usize) -> [bool; 2] {
            let geometry = ScanGeometry {
                angle_min_rad: -std::f64::consts::PI,
                angle_increment_rad: std::f64::consts::TAU / beams as f64,
                beams,
                ..ScanGeometry::UTM_30LX
            };
            let mut ranges = vec![Range::Hit(3.0); beams];
            ranges[beams / 2] = Range::Hit(0.2);
            let scan = LaserScan { time_ns: 0, geometry, ranges };
            let mut surroundings = Surroundings::new(&SafetyConfig::default());
            let robot = Footprint::new(0.16, &[]);
            std::array::from_fn(|_| {
                surroundings.update(&scan);
                surroundings.first_obstacle(&robot, &FORWARD, 0.1).is_some()
            })
        }
        assert_eq!(obstacle_after_scans(400), [false, true]);
        assert_eq!(obstacle_after_scans(1440), [false, false]);
    }

    #[test]
    fn the_side_with_larger_ranges_has_more_space() {
        let mut surroundings = Surroundings::new(&SafetyConfig::default());
        for (left_m, right_m, side) in
            [(1.0, 0.5, 1.0), (0.5, 1.0, -1.0), (5.0, 2.5, 1.0), (1.0, 1.0, 1.0)]
        {
            surroundings.update(&scan_of(|angle| match angle.sin() {
                sin if sin.abs() < 1e-6 => Range::NoReturn,
                sin => Range::Hit(if sin > 0.0 { left_m } else { right_m }),
            }));
            assert_eq!(surroundings.side_with_more_space(), side, "{left_m} {right_m}");
        }
    }

    #[test]
    fn the_laser_position_and_a_large_stop_distance_shift_the_horizon() {
        let config = with_laser_at(Pose2::new(0.1, 0.0, 0.0));
        let (obstacle, gap_m) = first_obstacle_with(&config, &wall_ahead(0.15), FORWARD).unwrap();
        assert!(
            (obstacle.x_m - 0.25).abs() < 1e-3 && (gap_m - 0.09).abs() < 1e-3,
            "{obstacle:?} {gap_m}"
        );
        fn visible_m(config: &SafetyConfig) -> f64 {
            Surroundings::new(config).visible_ahead_m(&Footprint::new(0.16, &[]))
        }
        assert!((visible_m(&config) - (1.5 + 0.1 - 0.16)).abs() < 1e-6);
        for forward_m in [-0.5, 0.5] {
            let far = SafetyConfig {
                stop_distance_m: 2.0,
                ..with_laser_at(Pose2::new(forward_m, 0.0, 0.0))
            };
            assert!(
                (visible_m(&far) - (0.5 + forward_m + 2.0 + 1.0)).abs() < 1e-6,
                "{}",
                visible_m(&far)
            );
        }
        // From 0.9 m beside the axis, a horizon of 1.5 m reaches 1.2 m ahead on it.
        let beside = Surroundings {
            horizon_m: 1.5,
            ..Surroundings::new(&with_laser_at(Pose2::new(0.0, 0.9, 0.0)))
        };
        let ahead_m = beside.visible_ahead_m(&Footprint::new(0.16, &[]));
        assert!((ahead_m - (1.2 - 0.16)).abs() < 1e-6, "{ahead_m}");
    }

    #[test]
    fn a_scanner_in_a_corner_and_turned_outwards_sees_the_wall_ahead_where_it_is() {
        let t_base_laser = Pose2::new(0.12, -0.1, -0.5);
        let mut surroundings = Surroundings::new(&with_laser_at(t_base_laser));
        surroundings.update(&scan_of(|angle| {
            let cos = (angle + t_base_laser.yaw_rad).cos();
            if cos > 0.1 {
                Range::Hit(((0.3 - t_base_laser.x_m) / cos) as f32)
            } else {
                Range::NoReturn
            }
        }));
        assert!(surroundings.obstacles().len() > 100);
        assert!(surroundings.obstacles().iter().all(|obstacle| (obstacle.x_m - 0.3).abs() < 1e-6));
        let footprint = Footprint::new(0.16, &[]);
        let (_, gap_m) = surroundings.first_obstacle(&footprint, &FORWARD, 0.2).unwrap();
        assert!((gap_m - 0.14).abs() < 1e-3, "{gap_m}");
    }

    #[test]
    fn body_sectors_mask_their_directions_up_to_their_distance_only() {
        let body = vec![
            BodySector { from_deg: -10.0, to_deg: 10.0, up_to_m: 0.15 },
            BodySector { from_deg: 5.0, to_deg: 20.0, up_to_m: 0.3 },
        ];
        let config = SafetyConfig { body, ..SafetyConfig::default() };
        let mut surroundings = Surroundings::new(&config);
        assert_eq!(surroundings.own_body_m(540), 0.0, "no scan yet");
        surroundings.update(&wall_ahead(1.0));
        let masked_m = [-11.0, -9.0, 0.0, 6.0, 19.0, 21.0].map(|degrees: f64| {
            let beam = (540.0 + 4.0 * degrees) as usize;
            surroundings.own_body_m(beam)
        });
        assert_eq!(masked_m, [0.0, 0.15, 0.15, 0.3, 0.3, 0.0]);
    }

    #[test]
    fn a_change_of_the_scan_geometry_is_taken_over() {
        let mut surroundings = Surroundings::new(&SafetyConfig::default());
        surroundings.update(&wall_ahead(0.2));
        let geometry = ScanGeometry { angle_min_rad: 0.0, ..ScanGeometry::UTM_30LX };
        surroundings.update(&LaserScan { geometry, ..wall_ahead(0.2) });
        assert!(
            surroundings.first_obstacle(&Footprint::new(0.16, &[]), &FORWARD, 0.1).is_none(),
            "the new scanner is turned to the left"
        );
    }

    #[test]
    fn obstacles_lie_in_the_direction_of_their_beam_and_within_the_horizon() {
        let mut surroundings = Surroundings::new(&with_laser_at(Pose2::new(0.1, 0.0, 0.0)));
        surroundings.update(&scan_of(|angle| {
            if (0.5..0.6).contains(&angle) { Range::Hit(1.0) } else { Range::Hit(3.0) }
        }));
        assert!(surroundings.obstacles().len() > 20);
        for obstacle in surroundings.obstacles() {
            let x_m = obstacle.x_m - 0.1;
            let y_m = obstacle.y_m;
            assert!(
                (x_m.hypot(y_m) - 1.0).abs() < 1e-6 && (0.5..0.6).contains(&y_m.atan2(x_m)),
                "{obstacle:?}"
            );
        }
        for (range_m, is_kept) in [(1.5, true), (1.51, false), (20.0, false)] {
            surroundings.update(&scan_of(|_| Range::Hit(range_m)));
            assert_eq!(!surroundings.obstacles().is_empty(), is_kept, "{range_m}");
        }
    }

    #[test]
    fn a_long_reach_finds_every_obstacle_within_the_horizon() {
        let mut surroundings = Surroundings::new(&SafetyConfig::default());
        surroundings.update(&scan_of(|_| Range::Hit(1.5)));
        let robot = Footprint::new(0.16, &[]);
        let (_, gap_m) = surroundings.first_obstacle(&robot, &FORWARD, 100.0).unwrap();
        assert!((gap_m - 1.34).abs() < 1e-3, "{gap_m}");
        assert!(surroundings.first_obstacle(&robot, &FORWARD, 1.3).is_none());
    }
}
