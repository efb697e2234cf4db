//! What the newest scan says about the ground around the robot.

use hal::{LaserScan, Range, ScanGeometry};
use serde::{Deserialize, Serialize};

use super::{BodySector, Footprint, SafetyConfig};
use crate::snapshot::remembers;

/// Share of error beams above which a scan is no longer believed.
const MAX_ERROR_SHARE: f64 = 0.5;
/// Neighbouring beams that must agree before a return counts: a single one is rain, dust or crosstalk. Nearer than a metre the
/// beams of a scanner with 0.25 degrees lie within 4 mm, so that no leg of a chair hides between two of them.
const MIN_NEIGHBOURS: usize = 2;
/// Neighbouring beams "agree" when their ranges differ by less than this: twice the ±30 mm of a UTM-30LX, and slack.
const NEIGHBOUR_GAP_M: f32 = 0.08;
/// Nothing farther from the laser than this, metres, changes what the safety plane does, unless it is told to stop farther away.
pub(super) const HORIZON_M: f32 = 1.5;
/// So much is seen beyond the stop distance at least, metres.
const SIGHT_M: f64 = 1.0;

/// Something near the robot, in `base_link`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Obstacle {
    /// Forward, metres.
    pub x_m: f64,
    /// Left, metres.
    pub y_m: f64,
    /// The sensor only knows that it is nearer than it can measure.
    pub too_near: bool,
}

impl Obstacle {
    /// Where it is.
    #[must_use]
    pub fn point_m(&self) -> [f64; 2] {
        [self.x_m, self.y_m]
    }
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

/// A distance that is none is an error, whatever the driver calls it.
fn is_error(range: Range) -> bool {
    match range {
        Range::Hit(range_m) => !(range_m.is_finite() && range_m >= 0.0),
        Range::Error => true,
        Range::NoReturn | Range::TooNear => false,
    }
}

/// How far away the beam met something, metres: at most, where it is nearer than can be measured.
pub(super) fn distance_m(range: Range, geometry: &ScanGeometry) -> Option<f32> {
    match range {
        Range::TooNear => Some(geometry.range_min_m),
        range => range.hit_m().filter(|_| !is_error(range)),
    }
}

/// The newest scan as points around the robot. Allocates when a scanner is seen first, not after.
#[derive(Debug, Clone, PartialEq)]
pub struct Surroundings {
    laser_forward_m: f64,
    horizon_m: f32,
    body: Vec<BodySector>,
    /// Cosine and sine of every beam of `geometry`, and up to where it meets the robot itself.
    beams: Vec<Beam>,
    geometry: Option<ScanGeometry>,
    obstacles: Vec<Obstacle>,
    /// Room to the left minus room to the right, metres summed over beams.
    left_over_right_m: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Beam {
    cos: f64,
    sin: f64,
    own_body_m: f32,
}

impl Surroundings {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(config: &SafetyConfig) -> Self {
        let footprint = Footprint::new(config.footprint_radius_m, &config.footprint_m);
        let needed_m =
            config.laser_forward_m.abs() + footprint.reach_m() + config.stop_distance_m + SIGHT_M;
        Self {
            laser_forward_m: config.laser_forward_m,
            horizon_m: needed_m.max(f64::from(HORIZON_M)) as f32,
            body: config.body.clone(),
            beams: Vec::new(),
            geometry: None,
            obstacles: Vec::new(),
            left_over_right_m: 0.0,
        }
    }

    fn learn(&mut self, geometry: ScanGeometry) {
        let body = &self.body;
        let beam = |angle: f64| {
            let own = body
                .iter()
                .filter(|part| (part.from_deg..=part.to_deg).contains(&angle.to_degrees()));
            let own_body_m = own.map(|part| part.up_to_m as f32).fold(0.0, f32::max);
            Beam { cos: angle.cos(), sin: angle.sin(), own_body_m }
        };
        self.beams = (0..geometry.beams).map(|index| beam(geometry.angle_rad(index))).collect();
        self.obstacles.reserve(geometry.beams);
        self.geometry = Some(geometry);
    }

    /// Takes in a scan.
    pub fn see(&mut self, scan: &LaserScan) {
        if self.geometry != Some(scan.geometry) {
            self.learn(scan.geometry);
        }
        self.obstacles.clear();
        self.left_over_right_m = 0.0;
        let (mut neighbours, mut last_m) = (0, f32::NEG_INFINITY);
        for (beam, range) in self.beams.iter().zip(&scan.ranges) {
            // An error says nothing, also not that its neighbours are single.
            if is_error(*range) {
                continue;
            }
            let Some(range_m) = distance_m(*range, &scan.geometry) else {
                neighbours = 0;
                continue;
            };
            self.left_over_right_m += range_m.min(2.0).copysign(beam.sin as f32);
            if range_m > self.horizon_m || range_m <= beam.own_body_m {
                neighbours = 0;
                continue;
            }
            neighbours =
                if (range_m - last_m).abs() < NEIGHBOUR_GAP_M { neighbours + 1 } else { 1 };
            last_m = range_m;
            if neighbours >= MIN_NEIGHBOURS {
                let range_m = f64::from(range_m);
                let (x_m, y_m) = (self.laser_forward_m + range_m * beam.cos, range_m * beam.sin);
                self.obstacles.push(Obstacle { x_m, y_m, too_near: *range == Range::TooNear });
            }
        }
    }

    /// Up to where a beam of the newest scan meets the robot itself, metres; 0: nowhere.
    pub(super) fn own_body_m(&self, beam: usize) -> f32 {
        self.beams.get(beam).map_or(0.0, |beam| beam.own_body_m)
    }

    /// Free way straight ahead of the outline within which everything is seen, metres.
    #[must_use]
    pub fn sight_m(&self, footprint: &Footprint) -> f64 {
        f64::from(self.horizon_m) + self.laser_forward_m - footprint.straight_edge_m()
    }

    /// Everything that was seen within the horizon of the laser, but for single stray returns.
    #[must_use]
    pub fn obstacles(&self) -> &[Obstacle] {
        &self.obstacles
    }

    /// What the robot would meet first, and after which way, when it drives by `twist`; looked at up to `reach_m`.
    #[must_use]
    pub fn first_met(
        &self,
        footprint: &Footprint,
        twist: &hal::Twist2,
        reach_m: f64,
    ) -> Option<(Obstacle, f64)> {
        // Nothing is known beyond the horizon.
        let reach_m = reach_m.min(2.0 * f64::from(self.horizon_m));
        let gap = |obstacle: &Obstacle| {
            Some((*obstacle, footprint.gap_m(obstacle.point_m(), twist, reach_m)?))
        };
        self.obstacles.iter().filter_map(gap).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Side with more room: +1 left, -1 right.
    #[must_use]
    pub fn open_side(&self) -> f64 {
        if self.left_over_right_m >= 0.0 { 1.0 } else { -1.0 }
    }
}

remembers!(Surroundings: obstacles, left_over_right_m);

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

    /// A wall across the way, `distance_m` ahead of the sensor.
    pub fn wall_ahead(distance_m: f64) -> LaserScan {
        scan_of(|angle| match angle.cos() {
            cos if cos > 0.1 => Range::Hit((distance_m / cos) as f32),
            _ => Range::NoReturn,
        })
    }

    fn met(scan: &LaserScan, twist: Twist2) -> Option<(Obstacle, f64)> {
        met_with(&SafetyConfig::default(), scan, twist)
    }

    fn met_with(config: &SafetyConfig, scan: &LaserScan, twist: Twist2) -> Option<(Obstacle, f64)> {
        let mut around = Surroundings::new(config);
        around.see(scan);
        around.first_met(&Footprint::new(0.16, &[]), &twist, 0.1)
    }

    #[test]
    fn a_wall_nearer_than_the_reach_is_found_with_its_gap() {
        let (_, gap_m) = met(&wall_ahead(0.25), FORWARD).unwrap();
        assert!((gap_m - 0.09).abs() < 1e-3, "{gap_m}");
        assert!(met(&wall_ahead(0.27), FORWARD).is_none());
    }

    #[test]
    fn a_wall_ahead_does_not_block_the_way_back() {
        assert!(met(&wall_ahead(0.2), Twist2 { linear_mps: -0.3, angular_radps: 0.0 }).is_none());
    }

    #[test]
    fn a_wall_beside_the_robot_is_passed() {
        let beside = scan_of(|angle| match angle.sin() {
            sin if sin > 0.1 => Range::Hit((0.18 / sin) as f32),
            _ => Range::Hit(5.0),
        });
        assert!(met(&beside, FORWARD).is_none());
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
        assert!(met(&stray, FORWARD).is_none());
        let leg =
            scan_of(|angle| if angle.abs() < 0.05 { Range::Hit(0.2) } else { Range::Hit(3.0) });
        assert!(met(&leg, FORWARD).is_some());
    }

    #[test]
    fn too_near_ahead_is_an_obstacle_and_no_return_is_not() {
        let near =
            scan_of(|angle| if angle.abs() < 0.3 { Range::TooNear } else { Range::Hit(3.0) });
        assert!(met(&near, FORWARD).unwrap().0.too_near);
        assert!(met(&scan_of(|_| Range::NoReturn), FORWARD).is_none());
    }

    #[test]
    fn the_robots_own_mast_is_not_an_obstacle_and_what_stands_behind_the_mast_is() {
        let body = vec![BodySector { from_deg: -10.0, to_deg: 10.0, up_to_m: 0.15 }];
        let config = SafetyConfig { body, ..SafetyConfig::default() };
        let mast =
            scan_of(|angle| if angle.abs() < 0.15 { Range::Hit(0.12) } else { Range::Hit(3.0) });
        assert!(met(&mast, FORWARD).is_some());
        assert!(met_with(&config, &mast, FORWARD).is_none());
        assert!(met_with(&config, &wall_ahead(0.2), FORWARD).is_some());
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
            assert!(met(&scan_of(|_| Range::Hit(none)), FORWARD).is_none(), "{none}");
        }
    }

    #[test]
    fn half_of_the_beams_may_be_errors_and_not_one_more() {
        let with = |errors: usize| {
            let mut scan = scan_of(|_| Range::Hit(1.0));
            scan.ranges[..errors].fill(Range::Error);
            ScanHealth::of(&scan)
        };
        assert_eq!((with(540), with(541)), (ScanHealth::Good, ScanHealth::Bad));
        assert_eq!(ScanHealth::of(&scan_of(|_| Range::TooNear)), ScanHealth::Good);
    }

    #[test]
    fn errors_between_returns_do_not_hide_what_returned_and_nothing_between_them_leaves_them_single()
     {
        for (between, hidden) in
            [(Range::Error, false), (Range::Hit(f32::NAN), false), (Range::NoReturn, true)]
        {
            let mut scan = wall_ahead(0.2);
            scan.ranges.iter_mut().step_by(2).for_each(|range| *range = between);
            assert_eq!(met(&scan, FORWARD).is_none(), hidden, "{between:?}");
        }
    }

    #[test]
    fn neighbours_agree_within_eight_centimetres() {
        let teeth = |depth_m: f32| {
            let mut scan = scan_of(|_| Range::Hit(3.0));
            for beam in 535..545 {
                scan.ranges[beam] = Range::Hit(if beam % 2 == 0 { 0.2 } else { 0.2 + depth_m });
            }
            met(&scan, FORWARD).is_some()
        };
        assert!(teeth(0.079) && !teeth(0.081));
    }

    #[test]
    fn the_robot_turns_to_the_side_with_more_room() {
        let mut around = Surroundings::new(&SafetyConfig::default());
        for (left_m, right_m, side) in
            [(1.0, 0.5, 1.0), (0.5, 1.0, -1.0), (5.0, 2.5, 1.0), (1.0, 1.0, 1.0)]
        {
            around.see(&scan_of(|angle| match angle.sin() {
                sin if sin.abs() < 1e-6 => Range::NoReturn,
                sin => Range::Hit(if sin > 0.0 { left_m } else { right_m }),
            }));
            assert_eq!(around.open_side(), side, "{left_m} {right_m}");
        }
    }

    #[test]
    fn a_laser_in_front_of_the_axle_sees_from_there_and_as_far_as_it_must() {
        let config = SafetyConfig { laser_forward_m: 0.1, ..SafetyConfig::default() };
        let (obstacle, gap_m) = met_with(&config, &wall_ahead(0.15), FORWARD).unwrap();
        assert!(
            (obstacle.x_m - 0.25).abs() < 1e-3 && (gap_m - 0.09).abs() < 1e-3,
            "{obstacle:?} {gap_m}"
        );
        let sight =
            |config: &SafetyConfig| Surroundings::new(config).sight_m(&Footprint::new(0.16, &[]));
        assert!((sight(&config) - (1.5 + 0.1 - 0.16)).abs() < 1e-6);
        for laser_forward_m in [-0.5, 0.5] {
            let far =
                SafetyConfig { laser_forward_m, stop_distance_m: 2.0, ..SafetyConfig::default() };
            assert!(
                (sight(&far) - (0.5 + laser_forward_m + 2.0 + 1.0)).abs() < 1e-6,
                "{}",
                sight(&far)
            );
        }
    }

    #[test]
    fn a_body_that_is_seen_between_two_directions_is_masked_between_them_and_up_to_its_distance_only()
     {
        let body = vec![
            BodySector { from_deg: -10.0, to_deg: 10.0, up_to_m: 0.15 },
            BodySector { from_deg: 5.0, to_deg: 20.0, up_to_m: 0.3 },
        ];
        let config = SafetyConfig { body, ..SafetyConfig::default() };
        let mut around = Surroundings::new(&config);
        assert_eq!(around.own_body_m(540), 0.0, "no scan yet");
        around.see(&wall_ahead(1.0));
        let beam = |degrees: f64| (540.0 + 4.0 * degrees) as usize;
        let seen: Vec<f32> =
            [-11.0, -9.0, 0.0, 6.0, 19.0, 21.0].map(|at| around.own_body_m(beam(at))).to_vec();
        assert_eq!(seen, [0.0, 0.15, 0.15, 0.3, 0.3, 0.0]);
    }

    #[test]
    fn another_scanner_is_learned_anew() {
        let mut around = Surroundings::new(&SafetyConfig::default());
        around.see(&wall_ahead(0.2));
        let geometry = ScanGeometry { angle_min_rad: 0.0, ..ScanGeometry::UTM_30LX };
        around.see(&LaserScan { geometry, ..wall_ahead(0.2) });
        assert!(
            around.first_met(&Footprint::new(0.16, &[]), &FORWARD, 0.1).is_none(),
            "it looks to the left"
        );
    }

    #[test]
    fn what_is_seen_lies_where_the_beam_points_and_nothing_beyond_the_horizon_is_kept() {
        let mut around =
            Surroundings::new(&SafetyConfig { laser_forward_m: 0.1, ..SafetyConfig::default() });
        around.see(&scan_of(|angle| {
            if (0.5..0.6).contains(&angle) { Range::Hit(1.0) } else { Range::Hit(3.0) }
        }));
        assert!(around.obstacles().len() > 20);
        for obstacle in around.obstacles() {
            let (x_m, y_m) = (obstacle.x_m - 0.1, obstacle.y_m);
            assert!(
                (x_m.hypot(y_m) - 1.0).abs() < 1e-6 && (0.5..0.6).contains(&y_m.atan2(x_m)),
                "{obstacle:?}"
            );
        }
        for (range_m, is_kept) in [(1.5, true), (1.51, false), (20.0, false)] {
            around.see(&scan_of(|_| Range::Hit(range_m)));
            assert_eq!(!around.obstacles().is_empty(), is_kept, "{range_m}");
        }
    }

    #[test]
    fn whatever_is_within_the_horizon_is_met_by_who_looks_far_enough() {
        let mut around = Surroundings::new(&SafetyConfig::default());
        around.see(&scan_of(|_| Range::Hit(1.5)));
        let robot = Footprint::new(0.16, &[]);
        let (_, gap_m) = around.first_met(&robot, &FORWARD, 100.0).unwrap();
        assert!((gap_m - 1.34).abs() < 1e-3, "{gap_m}");
        assert!(around.first_met(&robot, &FORWARD, 1.3).is_none());
    }
}
