//! An independent witness of the wheels: the motion between two scans.
//!
//! Wheels that slip, are lifted or have a wrong radius, track or sign report a motion that did not
//! take place, and everything that is computed from it is wrong. The scanner sees the room, so it
//! measures the motion independently. Each time the wheels report [`STEP_M`] or [`STEP_RAD`], the
//! newest scan is matched to the scan at the beginning of that motion: point-to-line ICP (Censi,
//! "An ICP variant using a point-to-line metric", 2008) with correspondences by direction. Maps and
//! poses of the exploration plane play no part in it.
//!
//! Single errors are ordinary: a person walks by, a wheel crosses a door sill. Therefore errors are
//! summed with a memory of about five steps, and the sum has a bound.

use hal::{LaserScan, Pose2, ScanGeometry, wrap_angle};
use nalgebra::{Matrix3, Vector3};

use super::surroundings::distance_m;
use crate::snapshot::remembers;

/// Motion of the wheels between two comparisons, metres and radians.
const STEP_M: f64 = 0.1;
const STEP_RAD: f64 = 0.2;
/// A reference scan that is older than this is replaced without a comparison: the room may have
/// changed.
const REFERENCE_NS: u64 = 2_000_000_000;
/// Share of the sum of errors that remains at the next comparison.
const MEMORY: f64 = 0.8;
/// Bounds of the sums. With [`STEP_M`] and [`MEMORY`], a constant error of half of the motion
/// reaches them, and wheels that rotate while the robot stands reach them after 0.4 m or 0.8 rad.
const MOST_M: f64 = 0.25;
const MOST_RAD: f64 = 0.5;
/// About this many beams are matched.
const SAMPLES: usize = 270;
/// A match needs this many beams, and this share of the measured ones.
const MIN_MATCHED: usize = 80;
const MIN_SHARE: f64 = 0.5;
const ITERATIONS: usize = 10;
/// Points farther from their line than this do not belong together, metres.
const GATE_M: f64 = 0.3;
/// Residuals above this count less, metres: three standard deviations of a UTM-30LX.
const HUBER_M: f64 = 0.03;
/// Correspondences are searched within this many beams.
const SEARCH: usize = 4;
/// A line is fitted through the neighbours at this distance in beams.
const NEIGHBOUR: usize = 3;
/// Neighbours whose ranges differ by more than this share do not lie on one surface.
const SURFACE: f64 = 0.15;
/// A direction of motion is observed if its information is at least that of this many beams at a
/// right angle to a wall.
const MIN_INFORMATION: f64 = 12.0;

/// How far the motion of the wheels is from the motion that the scanner measures, summed up with a memory of about five
/// comparisons. The robot stops beyond [`WheelError::MOST`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelError {
    /// Along the robot's heading, metres; positive where the wheels report more than the scanner.
    pub forward_m: f64,
    /// Of the robot's yaw, radians; counterclockwise is positive.
    pub yaw_rad: f64,
}

impl WheelError {
    /// The bounds of both errors.
    pub const MOST: Self = Self { forward_m: MOST_M, yaw_rad: MOST_RAD };

    fn is_too_large(&self) -> bool {
        self.forward_m.abs() > MOST_M || self.yaw_rad.abs() > MOST_RAD
    }
}

/// Compares the wheels with the scanner.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Witness {
    t_base_laser: Pose2,
    geometry: Option<ScanGeometry>,
    /// Direction of each beam.
    rays: Vec<[f64; 2]>,
    /// Ranges of the reference scan, metres; infinite where there was no return. Empty without a
    /// reference.
    reference: Vec<f32>,
    reference_ns: u64,
    /// `t_odom_base` at the reference scan.
    reference_odom: Pose2,
    /// Remembered sums of the errors along the robot's heading and of its yaw.
    drift_m: f64,
    drift_rad: f64,
}

remembers!(Witness: reference, reference_ns, reference_odom, drift_m, drift_rad);

impl Witness {
    pub fn new(t_base_laser: Pose2) -> Self {
        Self { t_base_laser, ..Self::default() }
    }

    /// Forgets everything: the robot was disarmed or stopped, or the odometry was reset.
    pub fn forget(&mut self) {
        self.reference.clear();
        self.drift_m = 0.0;
        self.drift_rad = 0.0;
    }

    /// Compares a new scan, taken at about `t_odom_base` = `odom`, with the reference; returns
    /// whether wheels and scanner disagree.
    pub fn observe(&mut self, scan: &LaserScan, odom: &Pose2) -> bool {
        if self.geometry != Some(scan.geometry) {
            self.set_geometry(scan.geometry);
        }
        let is_new = self.reference.len() != scan.geometry.beams
            || scan.time_ns.saturating_sub(self.reference_ns) > REFERENCE_NS;
        let t_then_now = self.reference_odom.inverse().compose(odom);
        if !is_new {
            let moved_m = t_then_now.x_m.hypot(t_then_now.y_m);
            if moved_m < STEP_M && wrap_angle(t_then_now.yaw_rad).abs() < STEP_RAD {
                return false;
            }
            self.compare(scan, &t_then_now);
        }
        self.set_reference(scan, odom);
        self.error().is_too_large()
    }

    /// The remembered errors.
    pub fn error(&self) -> WheelError {
        WheelError { forward_m: self.drift_m, yaw_rad: self.drift_rad }
    }

    fn set_geometry(&mut self, geometry: ScanGeometry) {
        self.rays.clear();
        self.rays.extend((0..geometry.beams).map(|beam| {
            let (sin, cos) = geometry.angle_rad(beam).sin_cos();
            [cos, sin]
        }));
        self.reference.reserve(geometry.beams);
        self.geometry = Some(geometry);
    }

    fn set_reference(&mut self, scan: &LaserScan, odom: &Pose2) {
        let ranges = scan.ranges.iter().map(|range| distance_m(*range, &scan.geometry));
        self.reference.clear();
        self.reference.extend(ranges.map(|range_m| range_m.unwrap_or(f32::INFINITY)));
        self.reference_ns = scan.time_ns;
        self.reference_odom = *odom;
    }

    /// Adds the difference between the motion of the wheels and that of the scanner to the sums.
    fn compare(&mut self, scan: &LaserScan, wheels: &Pose2) {
        let t_base_laser = self.t_base_laser;
        let guess = t_base_laser.inverse().compose(wheels).compose(&t_base_laser);
        self.drift_m *= MEMORY;
        self.drift_rad *= MEMORY;
        let Some(observed) = self.match_near(scan, &guess) else { return };
        let seen = t_base_laser.compose(&observed.motion).compose(&t_base_laser.inverse());
        self.drift_rad += wrap_angle(wheels.yaw_rad - seen.yaw_rad);
        if observed.sees_forward {
            self.drift_m += wheels.x_m - seen.x_m;
        }
    }

    /// The motion of the laser since the reference scan, near the wheels' motion or not. Wheels that
    /// are far from the truth give an initial guess from which no match is found. The robot then
    /// stood still, or moved in the opposite direction.
    fn match_near(&self, scan: &LaserScan, guess: &Pose2) -> Option<Observed> {
        self.match_scan(scan, guess)
            .or_else(|| self.match_scan(scan, &Pose2::IDENTITY))
            .or_else(|| self.match_scan(scan, &guess.inverse()))
    }

    /// The motion of the laser since the reference scan. `None` if too little of the room was seen in
    /// both scans.
    fn match_scan(&self, scan: &LaserScan, guess: &Pose2) -> Option<Observed> {
        let mut motion = *guess;
        let mut observed = None;
        for _ in 0..ITERATIONS {
            let system = self.linearize(scan, &motion);
            if !system.is_enough() {
                return None;
            }
            let step = system.information.cholesky()?.solve(&system.gradient);
            motion = Pose2::new(
                motion.x_m + step.x,
                motion.y_m + step.y,
                wrap_angle(motion.yaw_rad + step.z),
            );
            let sees_forward = system.information.m11 >= MIN_INFORMATION;
            let sees_sideways = system.information.m22 >= MIN_INFORMATION;
            observed = Some(Observed { motion, sees_forward, sees_sideways });
            if step.norm() < 1e-4 {
                break;
            }
        }
        observed.filter(|observed| observed.motion.is_finite())
    }

    /// The normal equations of the point-to-line distances around a motion.
    fn linearize(&self, scan: &LaserScan, motion: &Pose2) -> System {
        let mut system = System::default();
        let stride = stride_of(scan.ranges.len());
        let (sin, cos) = motion.yaw_rad.sin_cos();
        for (beam, range) in scan.ranges.iter().enumerate().step_by(stride) {
            let Some(range_m) = distance_m(*range, &scan.geometry) else { continue };
            let Some([ray_x, ray_y]) = self.rays.get(beam) else { continue };
            system.measured += 1;
            let x_m = f64::from(range_m) * ray_x;
            let y_m = f64::from(range_m) * ray_y;
            let rotated = [cos * x_m - sin * y_m, sin * x_m + cos * y_m];
            let point = [rotated[0] + motion.x_m, rotated[1] + motion.y_m];
            let Some(line) = self.nearest_line(&scan.geometry, point) else { continue };
            let [nx, ny] = line.normal;
            let residual_m = nx * (line.point[0] - point[0]) + ny * (line.point[1] - point[1]);
            let slope = Vector3::new(nx, ny, ny * rotated[0] - nx * rotated[1]);
            let weight = (HUBER_M / residual_m.abs().max(HUBER_M)).min(1.0);
            system.information += slope * slope.transpose() * weight;
            system.gradient += slope * (weight * residual_m);
            system.matched += 1;
        }
        system
    }

    /// The surface of the reference scan that a point belongs to.
    fn nearest_line(&self, geometry: &ScanGeometry, [x_m, y_m]: [f64; 2]) -> Option<Line> {
        let angle_rad = wrap_angle(y_m.atan2(x_m) - geometry.angle_min_rad);
        let angle_rad = if angle_rad < 0.0 { angle_rad + std::f64::consts::TAU } else { angle_rad };
        let middle = (angle_rad / geometry.angle_increment_rad).round() as usize;
        let beams = middle.saturating_sub(SEARCH)..(middle + SEARCH + 1).min(geometry.beams);
        let (beam, _) = beams
            .filter_map(|beam| {
                let [px, py] = self.reference_point(beam)?;
                Some((beam, (px - x_m).hypot(py - y_m)))
            })
            .filter(|(_, distance_m)| *distance_m < GATE_M)
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        self.line(beam)
    }

    fn reference_point(&self, beam: usize) -> Option<[f64; 2]> {
        let range_m = f64::from(*self.reference.get(beam)?);
        let [ray_x, ray_y] = self.rays.get(beam)?;
        range_m.is_finite().then_some([range_m * ray_x, range_m * ray_y])
    }

    /// The line through the neighbours of a beam, if they lie on one surface.
    fn line(&self, beam: usize) -> Option<Line> {
        let before = beam.checked_sub(NEIGHBOUR)?;
        let range_m = self.reference.get(beam)?;
        let is_surface = [before, beam + NEIGHBOUR].iter().all(|neighbour| {
            let other_m = self.reference.get(*neighbour).copied().unwrap_or(f32::INFINITY);
            f64::from((other_m - range_m).abs()) < SURFACE * f64::from(*range_m)
        });
        if !is_surface {
            return None;
        }
        let [ax, ay] = self.reference_point(before)?;
        let [bx, by] = self.reference_point(beam + NEIGHBOUR)?;
        // It is not 0: no range is within the share `SURFACE` of a neighbour whose range is 0.
        let length_m = (bx - ax).hypot(by - ay);
        let normal = [-(by - ay) / length_m, (bx - ax) / length_m];
        Some(Line { point: self.reference_point(beam)?, normal })
    }
}

/// Distance between two beams that are matched, in beams: about [`SAMPLES`] of a scan are.
fn stride_of(beams: usize) -> usize {
    (beams / SAMPLES).max(1)
}

/// The motion of the laser between two scans, as `t_before_after`, starting from a guess; `None` if too
/// little of the room was seen to know it in both directions.
#[must_use]
pub fn scanner_motion(before: &LaserScan, after: &LaserScan, guess: &Pose2) -> Option<Pose2> {
    let mut witness = Witness::new(Pose2::IDENTITY);
    witness.set_geometry(before.geometry);
    witness.set_reference(before, &Pose2::IDENTITY);
    let observed = witness.match_near(after, guess)?;
    (observed.sees_forward && observed.sees_sideways).then_some(observed.motion)
}

/// A piece of a surface.
struct Line {
    point: [f64; 2],
    normal: [f64; 2],
}

/// The motion of the laser between two scans.
struct Observed {
    motion: Pose2,
    /// The motion along the robot's heading was observed. In a long corridor it is not.
    sees_forward: bool,
    /// So was the motion across it.
    sees_sideways: bool,
}

/// Normal equations, with the number of beams behind them.
#[derive(Default)]
struct System {
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
    measured: usize,
    matched: usize,
}

impl System {
    fn is_enough(&self) -> bool {
        self.matched >= MIN_MATCHED && self.matched as f64 >= MIN_SHARE * self.measured as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::safety::surroundings::tests::{scan_of, wall_ahead};
    use hal::{Range, Twist2};
    use proptest::prelude::*;

    const GEOMETRY: ScanGeometry = ScanGeometry::UTM_30LX;
    const PERIOD_NS: u64 = GEOMETRY.period_ns;

    /// A room of 6 m by 4 m with a box in it, seen from `t_room_laser`; `noise_m` is a deterministic
    /// error of up to this size.
    fn scan_at(laser: &Pose2, time_ns: u64, noise_m: f64) -> LaserScan {
        let walls = [(3.0, true), (-3.0, true), (2.0, false), (-2.0, false)];
        let ranges = (0..GEOMETRY.beams).map(|beam| {
            let (sin, cos) = (GEOMETRY.angle_rad(beam) + laser.yaw_rad).sin_cos();
            let mut range_m = walls
                .into_iter()
                .map(
                    |(at_m, is_x)| {
                        if is_x { (at_m - laser.x_m) / cos } else { (at_m - laser.y_m) / sin }
                    },
                )
                .filter(|range_m| *range_m > 0.0)
                .fold(f64::INFINITY, f64::min);
            // A box from x = 1.5 to the wall, below y = -1.
            let to_side = (1.5 - laser.x_m) / cos;
            if to_side > 0.0 && laser.y_m + to_side * sin < -1.0 {
                range_m = range_m.min(to_side);
            }
            let noise = (beam as f64 * 12.9898 + time_ns as f64 * 1e-6).sin() * noise_m;
            Range::Hit((range_m + noise) as f32)
        });
        LaserScan { time_ns, geometry: GEOMETRY, ranges: ranges.collect() }
    }

    /// Drives for `seconds` while the wheels report `wheels` and the robot moves by `truth`;
    /// returns the time of the first disagreement, seconds.
    fn disagrees_after_s(wheels: Twist2, truth: Twist2, seconds: f64) -> Option<f64> {
        // A scanner that is mounted in a corner of the robot and turned outwards.
        let t_base_laser = Pose2::new(0.1, -0.08, -0.4);
        let mut witness = Witness::new(t_base_laser);
        let mut pose = Pose2::new(-1.0, 0.3, 0.2);
        let mut odom = Pose2::IDENTITY;
        let scans = (seconds / (PERIOD_NS as f64 * 1e-9)) as u64;
        (0..scans).find_map(|number| {
            let step_s = PERIOD_NS as f64 * 1e-9;
            pose = pose.compose(&truth.integrate(step_s));
            odom = odom.compose(&wheels.integrate(step_s));
            let scan = scan_at(&pose.compose(&t_base_laser), number * PERIOD_NS, 0.02);
            witness.observe(&scan, &odom).then_some(number as f64 * step_s)
        })
    }

    const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
    const ROTATION: Twist2 = Twist2 { linear_mps: 0.0, angular_radps: 0.6 };

    fn scaled(twist: Twist2, by: f64) -> Twist2 {
        Twist2 { linear_mps: twist.linear_mps * by, angular_radps: twist.angular_radps * by }
    }

    #[test]
    fn wheels_that_report_the_true_motion_are_believed() {
        let arc = Twist2 { linear_mps: 0.2, angular_radps: 0.5 };
        for (twist, seconds) in [(FORWARD, 9.0), (ROTATION, 30.0), (arc, 30.0)] {
            assert_eq!(disagrees_after_s(twist, twist, seconds), None, "{twist:?}");
        }
    }

    #[test]
    fn wheels_that_turn_while_the_room_stands_still_are_noticed_within_half_a_metre_and_a_radian() {
        let after_s = disagrees_after_s(FORWARD, Twist2::ZERO, 20.0).unwrap();
        assert!(after_s * 0.3 < 0.5, "{} m", after_s * 0.3);
        let after_s = disagrees_after_s(ROTATION, Twist2::ZERO, 20.0).unwrap();
        assert!(after_s * 0.6 < 1.0, "{} rad", after_s * 0.6);
    }

    #[test]
    fn swapped_signs_of_speed_and_yaw_are_noticed() {
        assert!(disagrees_after_s(FORWARD, scaled(FORWARD, -1.0), 5.0).is_some());
        assert!(disagrees_after_s(ROTATION, scaled(ROTATION, -1.0), 5.0).is_some());
    }

    #[test]
    fn a_radius_or_a_track_that_is_wrong_by_a_fifth_is_believed_and_by_a_factor_of_two_is_not() {
        for twist in [FORWARD, ROTATION] {
            assert_eq!(disagrees_after_s(scaled(twist, 1.2), twist, 8.0), None, "{twist:?}");
            assert!(disagrees_after_s(scaled(twist, 2.2), twist, 8.0).is_some(), "{twist:?}");
        }
    }

    #[test]
    fn a_scanner_that_sees_too_little_is_no_witness() {
        let mut witness = Witness::new(Pose2::IDENTITY);
        let mut scan = scan_at(&Pose2::IDENTITY, 0, 0.0);
        scan.ranges[60..].fill(Range::NoReturn);
        for number in 0..400 {
            scan.time_ns = number * PERIOD_NS;
            let odom = FORWARD.integrate(number as f64 * 0.025);
            assert!(!witness.observe(&scan, &odom));
        }
    }

    #[test]
    fn about_270_beams_are_matched_or_all_where_there_are_fewer() {
        for (beams, stride) in [(1081, 4), (682, 2), (540, 2), (539, 1), (360, 1), (100, 1)] {
            assert_eq!(stride_of(beams), stride, "{beams} beams");
        }
    }

    /// A witness whose reference is this scan.
    fn witness_of(reference: &LaserScan) -> Witness {
        let mut witness = Witness::new(Pose2::IDENTITY);
        witness.observe(reference, &Pose2::IDENTITY);
        witness
    }

    #[test]
    fn the_surface_of_a_point_is_searched_within_four_beams_of_its_direction_on_the_whole_circle() {
        // Only one beam has neighbours at both sides, 25 cm behind it.
        for beam in [100, 540, 1000] {
            let mut scan = scan_of(|_| Range::NoReturn);
            scan.ranges[beam] = Range::Hit(2.0);
            scan.ranges[beam - NEIGHBOUR] = Range::Hit(2.25);
            scan.ranges[beam + NEIGHBOUR] = Range::Hit(2.25);
            let witness = witness_of(&scan);
            for (apart, is_found) in [(0, true), (4, true), (-4, true), (5, false), (-5, false)] {
                let (sin, cos) = GEOMETRY.angle_rad(beam.saturating_add_signed(apart)).sin_cos();
                let line = witness.nearest_line(&GEOMETRY, [2.0 * cos, 2.0 * sin]);
                assert_eq!(line.is_some(), is_found, "{apart} from beam {beam}");
            }
        }
    }

    #[test]
    fn a_beam_of_which_a_neighbour_is_15_percent_nearer_or_farther_lies_on_no_surface() {
        for (before_m, after_m, is_surface) in [
            (2.0, 2.0, true),
            (2.28, 2.28, true),
            (1.72, 1.72, true),
            (2.32, 2.0, false),
            (2.0, 2.32, false),
            (1.68, 2.0, false),
            (2.0, 1.68, false),
        ] {
            let mut scan = scan_of(|_| Range::NoReturn);
            scan.ranges[540 - NEIGHBOUR] = Range::Hit(before_m);
            scan.ranges[540] = Range::Hit(2.0);
            scan.ranges[540 + NEIGHBOUR] = Range::Hit(after_m);
            let line = witness_of(&scan).line(540);
            assert_eq!(line.is_some(), is_surface, "{before_m} and {after_m} m");
        }
    }

    #[test]
    fn a_wall_that_is_nearer_by_2_cm_asks_for_a_motion_of_2_cm_along_its_normal() {
        let wall_at = |distance_m: f64| {
            scan_of(|angle| match (angle - 0.6).cos() {
                cos if cos > 0.3 => Range::Hit((distance_m / cos) as f32),
                _ => Range::NoReturn,
            })
        };
        let system = witness_of(&wall_at(2.0)).linearize(&wall_at(1.98), &Pose2::IDENTITY);
        let matched = system.matched as f64;
        assert!(system.is_enough(), "{matched}");
        let normal = 0.6_f64.sin_cos();
        assert!((system.gradient.x / matched - 0.02 * normal.1).abs() < 1e-4);
        assert!((system.gradient.y / matched - 0.02 * normal.0).abs() < 1e-4);
        assert!((system.information.m11 / matched - normal.1 * normal.1).abs() < 1e-3);
        assert!((system.information.m12 / matched - normal.1 * normal.0).abs() < 1e-3);
    }

    #[test]
    fn a_room_that_is_seen_rotated_by_a_degree_asks_for_that_rotation_in_the_first_step() {
        let rotated = Pose2::new(0.0, 0.0, 0.02);
        let witness = witness_of(&scan_at(&Pose2::IDENTITY, 0, 0.0));
        let system = witness.linearize(&scan_at(&rotated, 0, 0.0), &Pose2::IDENTITY);
        let step = system.information.cholesky().unwrap().solve(&system.gradient);
        assert!((step - Vector3::new(0.0, 0.0, 0.02)).norm() < 0.003, "{step:?}");
    }

    #[test]
    fn a_scan_of_which_less_than_half_is_found_again_is_not_matched() {
        for (seen_share, is_matched) in [(0.4, false), (0.6, true)] {
            let whole = scan_at(&Pose2::IDENTITY, 0, 0.0);
            let mut part = whole.clone();
            let seen = (seen_share * GEOMETRY.beams as f64) as usize;
            part.ranges[seen..].fill(Range::NoReturn);
            let found = witness_of(&part).match_scan(&whole, &Pose2::IDENTITY);
            assert_eq!(found.is_some(), is_matched, "{seen_share}");
        }
    }

    #[test]
    fn the_motion_between_two_scans_is_known_only_where_walls_stand_in_both_directions() {
        let motion = Pose2::new(0.05, -0.03, 0.1);
        let room = [Pose2::IDENTITY, motion].map(|pose| scan_at(&pose, 0, 0.0));
        let found = scanner_motion(&room[0], &room[1], &Pose2::IDENTITY).unwrap();
        assert!(found.distance_m(&motion) < 0.01, "{found:?}");
        // A corridor with walls 1 m to the left and to the right, and a single wall 2 m ahead.
        let corridor = scan_of(|angle| Range::Hit((1.0 / angle.sin().abs()).min(25.0) as f32));
        assert_eq!(scanner_motion(&corridor, &corridor, &Pose2::IDENTITY), None);
        let wall = wall_ahead(2.0);
        assert_eq!(scanner_motion(&wall, &wall, &Pose2::IDENTITY), None);
    }

    #[test]
    fn errors_are_what_the_wheels_report_more_than_the_scanner_and_are_remembered_to_four_fifths() {
        for sign in [1.0, -1.0] {
            let mut witness = Witness::new(Pose2::IDENTITY);
            let mut odom = Pose2::IDENTITY;
            witness.observe(&scan_at(&Pose2::IDENTITY, 0, 0.0), &odom);
            for (number, share) in [(1, 1.0), (2, 1.8)] {
                odom = odom.compose(&Pose2::new(sign * 0.12, 0.0, sign * 0.1));
                witness.observe(&scan_at(&Pose2::IDENTITY, number * PERIOD_NS, 0.0), &odom);
                let WheelError { forward_m, yaw_rad } = witness.error();
                assert!((forward_m - sign * share * 0.12).abs() < 0.005, "{forward_m} m");
                assert!((yaw_rad - sign * share * 0.1).abs() < 0.005, "{yaw_rad} rad");
            }
        }
    }

    #[test]
    fn a_reference_that_is_older_than_two_seconds_is_replaced_without_a_comparison() {
        let moved = Pose2::new(0.15, 0.0, 0.0);
        for (seconds, is_compared) in [(1.9, true), (2.0, true), (2.1, false), (3.0, false)] {
            let mut witness = Witness::new(Pose2::IDENTITY);
            witness.observe(&scan_at(&Pose2::IDENTITY, 0, 0.0), &Pose2::IDENTITY);
            let later_ns = (seconds * 1e9) as u64;
            witness.observe(&scan_at(&Pose2::IDENTITY, later_ns, 0.0), &moved);
            assert_eq!(witness.error().forward_m > 0.1, is_compared, "{seconds} s");
            assert_eq!(witness.reference_ns, later_ns);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn the_matched_motion_is_the_true_motion(
            x in -0.12..0.12f64,
            y in -0.05..0.05f64,
            yaw in -0.25..0.25f64,
            guess in -0.1..0.1f64,
        ) {
            let start = Pose2::new(-0.7, 0.2, 0.4);
            let mut witness = Witness::new(Pose2::IDENTITY);
            witness.observe(&scan_at(&start, 0, 0.01), &Pose2::IDENTITY);
            let motion = Pose2::new(x, y, yaw);
            let scan = scan_at(&start.compose(&motion), PERIOD_NS, 0.01);
            let guess = Pose2::new(x + guess, y, yaw + guess / 2.0);
            let found = witness.match_scan(&scan, &guess).unwrap();
            prop_assert!(found.sees_forward);
            prop_assert!(found.motion.distance_m(&motion) < 0.02, "{:?} {motion:?}", found.motion);
            prop_assert!(wrap_angle(found.motion.yaw_rad - yaw).abs() < 0.01);
        }
    }
}
