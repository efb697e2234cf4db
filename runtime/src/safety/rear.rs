//! Memory of the ground behind the robot, which a scanner with a field of view of 270 degrees does
//! not see.
//!
//! Ground counts as known to be free for two reasons: the robot drove over it a moment ago, or the
//! scanner saw it a moment ago, before the robot rotated.

use std::f64::consts::{PI, TAU};

use hal::{LaserScan, Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::Footprint;
use super::surroundings::{Surroundings, distance_m};
use crate::snapshot::{SnapshotError, State};

/// Number of directions in `odom` for which observations are stored: 10 degrees each.
const SECTORS: usize = 36;
/// An observation from a place farther away than this is not used, metres.
const SAME_PLACE_M: f64 = 0.1;
/// Number of stored poses of the driven path, and the distance between two of them, metres.
const TRAIL_LENGTH: usize = 64;
const TRAIL_STEP_M: f64 = 0.02;
/// A point within this distance of the driven path counts as driven over, metres. It is less than
/// [`CHECK_STEP_M`], so that a robot that has only stood somewhere does not know the ground behind
/// it.
const ON_TRAIL_M: f64 = 0.019;
/// A footprint with corners covered the ground only if its heading was the same within this
/// tolerance, radians.
const SAME_HEADING_RAD: f64 = 0.2;
/// The path behind the robot is checked in steps of this length, metres.
const CHECK_STEP_M: f64 = 0.02;

/// What the scanner last saw in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Observation {
    time_ns: u64,
    /// Position of the laser in `odom`, metres.
    from_m: [f64; 2],
    /// Distance of the nearest return in this direction, metres.
    nearest_m: f64,
}

/// The beams of one scan that lie in one direction.
#[derive(Debug, Clone, Copy)]
struct SectorReturns {
    beams: u32,
    returns: u32,
    nearest_m: f64,
}

impl SectorReturns {
    const NONE: Self = Self { beams: 0, returns: 0, nearest_m: f64::INFINITY };
}

/// Recent observations and the recently driven path. Its size is fixed, so it never allocates
/// memory.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RearMemory {
    memory_ns: u64,
    observations: [Option<Observation>; SECTORS],
    /// Ring buffer of poses in `odom`, with the time at which the robot left each of them.
    trail: [Option<(u64, Pose2)>; TRAIL_LENGTH],
    /// Index of the next entry of `trail` to overwrite.
    next: usize,
}

impl RearMemory {
    pub fn new(memory_s: f64) -> Self {
        Self {
            memory_ns: (memory_s * 1e9) as u64,
            observations: [None; SECTORS],
            trail: [None; TRAIL_LENGTH],
            next: 0,
        }
    }

    /// Adds the robot's pose in `odom` to the driven path.
    pub fn record_pose(&mut self, time_ns: u64, pose: &Pose2) {
        let last = &mut self.trail[(self.next + TRAIL_LENGTH - 1) % TRAIL_LENGTH];
        if let Some((left_ns, last)) = last
            && last.distance_m(pose) < TRAIL_STEP_M
            && wrap_angle(last.yaw_rad - pose.yaw_rad).abs() <= SAME_HEADING_RAD / 2.0
        {
            // Nothing can step onto the ground under the robot: the time counts from when it leaves.
            *left_ns = time_ns;
            return;
        }
        self.trail[self.next] = Some((time_ns, *pose));
        self.next = (self.next + 1) % TRAIL_LENGTH;
    }

    /// Forgets everything: the odometry was reset, so stored positions are wrong.
    pub fn forget(&mut self) {
        self.observations = [None; SECTORS];
        self.trail = [None; TRAIL_LENGTH];
    }

    /// Records a scan that was taken with the laser at `t_odom_laser`. A direction counts as
    /// observed when at least half of its beams returned from something other than the robot's own
    /// body. With fewer returns, an older observation of this direction is dropped.
    pub fn record_scan(
        &mut self,
        scan: &LaserScan,
        t_odom_laser: &Pose2,
        surroundings: &Surroundings,
    ) {
        let mut sectors = [SectorReturns::NONE; SECTORS];
        for (beam, range) in scan.ranges.iter().enumerate() {
            let sector =
                &mut sectors[sector_of(scan.geometry.angle_rad(beam) + t_odom_laser.yaw_rad)];
            sector.beams += 1;
            let range_m = distance_m(*range, &scan.geometry)
                .filter(|range_m| *range_m > surroundings.own_body_m(beam));
            if let Some(range_m) = range_m {
                sector.returns += 1;
                sector.nearest_m = sector.nearest_m.min(f64::from(range_m));
            }
        }
        let from_m = [t_odom_laser.x_m, t_odom_laser.y_m];
        // Directions at the edge of the field of view have fewer beams: they are observed only in
        // part.
        let beams_of_sector = (TAU / SECTORS as f64 / scan.geometry.angle_increment_rad) as u32;
        for (observation, sector) in self.observations.iter_mut().zip(sectors) {
            if sector.beams >= beams_of_sector.max(1) {
                *observation = (2 * sector.returns >= sector.beams).then_some(Observation {
                    time_ns: scan.time_ns,
                    from_m,
                    nearest_m: sector.nearest_m,
                });
            }
        }
    }

    /// Distance behind `pose` within which the ground is known to be free, metres, at most
    /// `limit_m`.
    pub fn known_free_m(
        &self,
        time_ns: u64,
        pose: &Pose2,
        footprint: &Footprint,
        limit_m: f64,
    ) -> f64 {
        if self.observations_behind(time_ns, pose).all(|observation| observation.is_some()) {
            let observations = self
                .observations
                .iter()
                .enumerate()
                .filter_map(|(sector, observation)| Some((sector, observation.as_ref()?)));
            return observed_gap_m(observations, pose, footprint).min(limit_m).max(0.0);
        }
        // The robot drove over this ground, but a person may have stepped onto it since then. An
        // observation shows that.
        let observations = self.observations_behind(time_ns, pose).flatten();
        let observed_m = observed_gap_m(observations, pose, footprint);
        let steps = (limit_m / CHECK_STEP_M).ceil() as usize;
        let driven_steps = (1..=steps).take_while(|step| {
            let back_m = (*step as f64 * CHECK_STEP_M).min(limit_m);
            let place = pose.compose(&Pose2::new(-back_m, 0.0, 0.0));
            self.was_driven_over(time_ns, pose, footprint, &place)
        });
        (driven_steps.count() as f64 * CHECK_STEP_M).min(limit_m).min(observed_m.max(0.0))
    }

    /// Whether the footprint recently covered `place` with about the heading of `pose`.
    fn was_driven_over(
        &self,
        time_ns: u64,
        pose: &Pose2,
        footprint: &Footprint,
        place: &Pose2,
    ) -> bool {
        self.driven_segments(time_ns, pose).any(|(start, end)| {
            let same_heading = matches!(footprint, Footprint::Round { .. })
                || wrap_angle(start.yaw_rad - pose.yaw_rad).abs() < SAME_HEADING_RAD;
            same_heading && distance_to_segment_m(place, &start, &end) < ON_TRAIL_M
        })
    }

    /// The segments of the recently driven path as (start, end), the newest first; the first one
    /// ends at `here`.
    fn driven_segments<'a>(
        &'a self,
        time_ns: u64,
        here: &'a Pose2,
    ) -> impl Iterator<Item = (Pose2, Pose2)> + 'a {
        (0..TRAIL_LENGTH)
            .map_while(move |back| {
                self.trail[(self.next + 2 * TRAIL_LENGTH - 1 - back) % TRAIL_LENGTH]
            })
            .take_while(move |(when_ns, _)| self.is_recent(time_ns, *when_ns))
            .scan(*here, |then, (_, was)| Some((was, std::mem::replace(then, was))))
    }

    fn is_recent(&self, time_ns: u64, when_ns: u64) -> bool {
        time_ns.saturating_sub(when_ns) <= self.memory_ns
    }

    /// One item for every direction behind the robot: its observation, if that is recent and was
    /// made near `pose`.
    fn observations_behind<'a>(
        &'a self,
        time_ns: u64,
        pose: &'a Pose2,
    ) -> impl Iterator<Item = Option<(usize, &'a Observation)>> + 'a {
        (0..SECTORS)
            .filter(|sector| wrap_angle(direction_of(*sector) - pose.yaw_rad).abs() > 0.75 * PI)
            .map(move |sector| {
                let observation = self.observations[sector].as_ref()?;
                let [from_x_m, from_y_m] = observation.from_m;
                let is_near = (from_x_m - pose.x_m).hypot(from_y_m - pose.y_m) < SAME_PLACE_M;
                (is_near && self.is_recent(time_ns, observation.time_ns))
                    .then_some((sector, observation))
            })
    }
}

/// Free distance straight back to the nearest observed return, metres; infinite if no return is on
/// the path. A return may lie anywhere across the width of its direction, so its middle and both
/// edges are checked.
fn observed_gap_m<'a>(
    observations: impl Iterator<Item = (usize, &'a Observation)>,
    pose: &Pose2,
    footprint: &Footprint,
) -> f64 {
    let half = PI / SECTORS as f64;
    let t_base_odom = pose.inverse();
    let points = observations.flat_map(|(sector, observation)| {
        [-half, 0.0, half].map(|off| {
            let (sin, cos) = (direction_of(sector) + off).sin_cos();
            let x_m = observation.from_m[0] + observation.nearest_m * cos;
            let y_m = observation.from_m[1] + observation.nearest_m * sin;
            <[f64; 2]>::from(t_base_odom.transform(x_m, y_m))
        })
    });
    points.filter_map(|point| footprint.straight_gap_m(point, -1.0)).fold(f64::INFINITY, f64::min)
}

/// Distance of a place from the line segment between two others, metres.
fn distance_to_segment_m(place: &Pose2, from: &Pose2, to: &Pose2) -> f64 {
    let along_x = to.x_m - from.x_m;
    let along_y = to.y_m - from.y_m;
    let x = place.x_m - from.x_m;
    let y = place.y_m - from.y_m;
    let length_2 = along_x * along_x + along_y * along_y;
    let share =
        if length_2 > 0.0 { ((x * along_x + y * along_y) / length_2).clamp(0.0, 1.0) } else { 0.0 };
    (x - share * along_x).hypot(y - share * along_y)
}

fn sector_of(angle_rad: f64) -> usize {
    // The same bits as `rem_euclid(1.0)`, which calls `fmod` for each of the 1,081 beams.
    let circles = angle_rad / TAU;
    let rest = circles - circles as i64 as f64;
    let share_of_circle = if rest < 0.0 { rest + 1.0 } else { rest };
    ((share_of_circle * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// Direction of the middle of a sector in `odom`, radians.
fn direction_of(sector: usize) -> f64 {
    (sector as f64 + 0.5) * TAU / SECTORS as f64
}

impl State for RearMemory {
    fn write(&self, to: &mut Vec<u8>) {
        self.observations.iter().for_each(|observation| observation.write(to));
        self.trail.iter().for_each(|place| place.write(to));
        self.next.write(to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.observations.iter_mut().try_for_each(|observation| observation.read(from))?;
        self.trail.iter_mut().try_for_each(|place| place.read(from))?;
        self.next.read(from)?;
        self.next %= TRAIL_LENGTH;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::safety::surroundings::tests::scan_of;
    use crate::safety::{BodySector, SafetyConfig};
    use hal::{Range, ScanGeometry};
    use proptest::prelude::*;

    const ROUND: Footprint = Footprint::Round { radius_m: 0.16 };

    fn rear() -> RearMemory {
        RearMemory::new(30.0)
    }

    /// A scanner whose view is not blocked by the robot's own body.
    fn no_body() -> Surroundings {
        Surroundings::new(&SafetyConfig::default())
    }

    /// A round room with the robot in its middle.
    fn round_room(radius_m: f32) -> LaserScan {
        scan_of(|_| Range::Hit(radius_m))
    }

    proptest! {
        #[test]
        fn the_sector_of_a_direction_is_the_same_after_any_number_of_rotations(
            sector in 0..SECTORS, part in 0.01..0.99_f64, rotations in -3..=3_i32,
        ) {
            let angle_rad = (sector as f64 + part) * TAU / SECTORS as f64;
            prop_assert_eq!(sector_of(angle_rad + f64::from(rotations) * TAU), sector);
        }
    }

    #[test]
    fn the_first_sector_begins_exactly_ahead() {
        assert_eq!(sector_of(0.0), 0);
        assert_eq!(sector_of(-1e-9), SECTORS - 1);
    }

    #[test]
    fn nothing_is_known_before_anything_was_seen() {
        assert_eq!(rear().known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn the_ground_that_the_robot_has_just_driven_over_is_free_and_no_farther() {
        let mut rear = rear();
        for step in 0..10 {
            rear.record_pose(0, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0));
        }
        let here = Pose2::new(0.18, 0.0, 0.0);
        let known_m = rear.known_free_m(0, &here, &ROUND, 0.5);
        assert!((0.16..=0.22).contains(&known_m), "{known_m}");
        let turned = Pose2::new(0.18, 0.0, 1.5);
        assert!(
            rear.known_free_m(0, &turned, &ROUND, 0.5) < 0.03,
            "the driven path is no longer behind"
        );
        assert_eq!(
            rear.known_free_m(29_000_000_000, &here, &ROUND, 0.5),
            known_m,
            "not too long ago"
        );
        assert_eq!(rear.known_free_m(31_000_000_000, &here, &ROUND, 0.5), 0.0, "too long ago");
    }

    #[test]
    fn standing_for_long_does_not_forget_the_driven_path() {
        fn at(forward_m: f64, yaw: f64) -> Pose2 {
            Pose2::new(0.0, 0.0, 1.0).compose(&Pose2::new(forward_m, 0.0, yaw))
        }
        let mut rear = rear();
        (0..10).for_each(|step| rear.record_pose(0, &at(f64::from(step) * 0.021, 0.0)));
        (0..1000).for_each(|_| rear.record_pose(0, &at(0.195, 0.05)));
        assert!(rear.known_free_m(0, &at(0.195, 0.0), &ROUND, 0.5) > 0.16);
    }

    #[test]
    fn a_rotation_on_the_spot_lets_the_scanner_observe_the_ground_that_is_then_behind() {
        let mut rear = rear();
        rear.record_scan(&round_room(2.0), &Pose2::IDENTITY, &no_body());
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0, "behind is blind");
        rear.record_scan(&round_room(2.0), &Pose2::new(0.0, 0.0, 1.7), &no_body());
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.2);
        for (x_m, y_m) in [(0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3)] {
            let moved_on = Pose2::new(x_m, y_m, 0.0);
            assert_eq!(rear.known_free_m(0, &moved_on, &ROUND, 0.2), 0.0, "seen from elsewhere");
        }
        assert_eq!(
            rear.known_free_m(31_000_000_000, &Pose2::IDENTITY, &ROUND, 0.2),
            0.0,
            "too long ago"
        );
    }

    #[test]
    fn only_directions_behind_must_be_observed_and_a_direction_that_is_partly_in_view_is_not() {
        // A scan reaches 135 degrees to the left; behind are the directions from 200 to 290
        // degrees.
        let here = Pose2::new(1.0, -2.0, 63f64.to_radians());
        for (looked_deg, known_m) in [(146.1, 0.0), (156.1, 0.2)] {
            let mut rear = rear();
            rear.record_scan(
                &round_room(2.0),
                &Pose2::new(1.0, -2.0, f64::to_radians(looked_deg)),
                &no_body(),
            );
            assert_eq!(rear.known_free_m(0, &here, &ROUND, 0.2), known_m, "{looked_deg}");
        }
    }

    #[test]
    fn a_direction_is_seen_when_half_of_its_beams_came_back() {
        for (every, known_m) in [(2, 0.2), (3, 0.0)] {
            let mut scan = round_room(2.0);
            for (beam, range) in scan.ranges.iter_mut().enumerate() {
                if beam % every != 0 {
                    *range = Range::NoReturn;
                }
            }
            let mut rear = rear();
            for yaw in [0.0, 1.7] {
                rear.record_scan(&scan, &Pose2::new(0.0, 0.0, yaw), &no_body());
            }
            assert_eq!(
                rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2),
                known_m,
                "one of {every}"
            );
        }
    }

    #[test]
    fn a_return_may_lie_anywhere_across_its_direction_and_keeps_its_place_when_the_robot_moves() {
        let mut rear = rear();
        // An obstacle between 190 and 200 degrees, 0.7 m away; the robot rotates towards it and
        // back.
        let looked_rad = -1.7;
        let post = scan_of(|angle| match (angle + looked_rad).to_degrees().rem_euclid(360.0) {
            at if (190.1..199.9).contains(&at) => Range::Hit(0.7),
            _ => Range::Hit(3.0),
        });
        rear.record_scan(&round_room(3.0), &Pose2::new(0.0, 0.0, 1.7), &no_body());
        rear.record_scan(&post, &Pose2::new(0.0, 0.0, looked_rad), &no_body());
        // The robot would hit its edge at 190 degrees and pass beside its middle.
        let far_m = 0.7 * 10f64.to_radians().cos();
        let aside_m = 0.7 * 10f64.to_radians().sin();
        let straight_m = known_m(&rear, 0.0);
        assert!((straight_m - gap_m(far_m, aside_m)).abs() < 1e-6, "{straight_m}");
        let beside_m = known_m(&rear, -0.06);
        assert!((beside_m - gap_m(far_m, aside_m - 0.06)).abs() < 1e-6, "{beside_m}");
        assert_eq!(known_m(&rear, 0.06), 1.0, "beside it");
    }

    fn known_m(rear: &RearMemory, y_m: f64) -> f64 {
        rear.known_free_m(0, &Pose2::new(0.0, y_m, 0.0), &ROUND, 1.0)
    }

    /// How far the round robot drives until its edge is at a point, `far_m` ahead and `aside_m` to the side.
    fn gap_m(far_m: f64, aside_m: f64) -> f64 {
        far_m - (0.16 * 0.16 - aside_m * aside_m).sqrt()
    }

    #[test]
    fn directions_are_ten_degrees_each_and_there_is_none_beyond_the_last() {
        assert!((direction_of(0) - 5f64.to_radians()).abs() < 1e-12);
        assert!((direction_of(35) - 355f64.to_radians()).abs() < 1e-12);
        for sector in 0..SECTORS {
            for (turns, off) in [(-1.0, -0.08), (0.0, 0.0), (1.0, 0.08)] {
                assert_eq!(sector_of(direction_of(sector) + turns * TAU + off), sector);
            }
        }
        assert_eq!(
            sector_of(-1e-20),
            SECTORS - 1,
            "rounding must not give a sector beyond the last"
        );
    }

    #[test]
    fn the_distance_from_a_segment_is_that_from_its_nearest_point() {
        // A segment of five metres: 3 m along x and 4 m along y.
        fn at(along_m: f64, aside_m: f64) -> Pose2 {
            Pose2::new(
                1.0 + 0.6 * along_m - 0.8 * aside_m,
                2.0 + 0.8 * along_m + 0.6 * aside_m,
                0.0,
            )
        }
        let from = Pose2::new(1.0, 2.0, 0.0);
        let to = Pose2::new(4.0, 6.0, 0.0);
        for (along_m, aside_m, distance_m) in [
            (2.0, 0.5, 0.5),
            (4.0, -0.25, 0.25),
            (0.0, 1.0, 1.0),
            (-3.0, 4.0, 5.0),
            (8.0, -4.0, 5.0),
        ] {
            assert!(
                (distance_to_segment_m(&at(along_m, aside_m), &from, &to) - distance_m).abs()
                    < 1e-12
            );
        }
        assert!(
            (distance_to_segment_m(&at(-3.0, 4.0), &from, &from) - 5.0).abs() < 1e-12,
            "a segment without length"
        );
    }

    #[test]
    fn an_obstacle_observed_before_a_rotation_is_remembered_after_it() {
        let mut rear = rear();
        rear.record_scan(&round_room(0.3), &Pose2::IDENTITY, &no_body());
        rear.record_scan(&round_room(0.3), &Pose2::new(0.0, 0.0, 1.7), &no_body());
        let known_m = rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.5);
        assert!(known_m > 0.05 && known_m < 0.15, "a wall 0.14 m behind the footprint: {known_m}");
    }

    #[test]
    fn directions_without_a_return_are_not_known() {
        let mut rear = rear();
        let dark = scan_of(|angle| if angle > 0.5 { Range::NoReturn } else { Range::Hit(2.0) });
        for yaw in [0.0, 1.7] {
            rear.record_scan(&dark, &Pose2::new(0.0, 0.0, yaw), &no_body());
        }
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn a_direction_whose_beams_stop_returning_is_no_longer_known() {
        let mut rear = rear();
        rear.record_scan(&round_room(2.0), &Pose2::IDENTITY, &no_body());
        rear.record_scan(&round_room(2.0), &Pose2::new(0.0, 0.0, 1.7), &no_body());
        rear.record_scan(&scan_of(|_| Range::NoReturn), &Pose2::new(0.0, 0.0, 1.7), &no_body());
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn nan_ranges_do_not_make_ground_known() {
        let mut rear = rear();
        for yaw in [0.0, 1.7] {
            rear.record_scan(
                &scan_of(|_| Range::Hit(f32::NAN)),
                &Pose2::new(0.0, 0.0, yaw),
                &no_body(),
            );
        }
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn a_too_near_return_behind_counts_as_an_obstacle_at_the_minimum_range() {
        let mut rear = rear();
        for yaw in [0.0, 1.7] {
            rear.record_scan(&scan_of(|_| Range::TooNear), &Pose2::new(0.0, 0.0, yaw), &no_body());
        }
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
        let slim = Footprint::Round { radius_m: 0.04 };
        let known_m = rear.known_free_m(0, &Pose2::IDENTITY, &slim, 0.2);
        assert!((known_m - 0.06).abs() < 0.01, "0.1 m from the laser: {known_m}");
    }

    #[test]
    fn a_scanner_too_coarse_to_have_a_beam_in_every_direction_observes_none() {
        let geometry = ScanGeometry {
            angle_min_rad: -2.0,
            angle_increment_rad: 0.25,
            beams: 17,
            ..ScanGeometry::UTM_30LX
        };
        let mut rear = rear();
        rear.record_scan(
            &LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(3.0); 17] },
            &Pose2::IDENTITY,
            &no_body(),
        );
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn the_robots_own_mast_is_neither_free_ground_nor_an_obstacle_behind() {
        fn with_body(sector: BodySector) -> Surroundings {
            let config = SafetyConfig { body: vec![sector], ..SafetyConfig::default() };
            let mut surroundings = Surroundings::new(&config);
            surroundings.update(&round_room(0.17));
            surroundings
        }
        fn known_m(scan: &LaserScan, surroundings: &Surroundings) -> f64 {
            let mut rear = rear();
            for yaw in [0.0, 1.7] {
                rear.record_scan(scan, &Pose2::new(0.0, 0.0, yaw), surroundings);
            }
            rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2)
        }
        let wide = with_body(BodySector { from_deg: -135.0, to_deg: 135.0, up_to_m: 0.17 });
        let narrow = with_body(BodySector { from_deg: 90.0, to_deg: 92.0, up_to_m: 0.17 });
        // The ground behind is free except for the mast in front of the scanner.
        let with_mast = scan_of(|angle| match angle.to_degrees() {
            at if (90.0..=92.0).contains(&at) => Range::Hit(0.165),
            _ => Range::Hit(2.0),
        });
        assert_eq!(known_m(&round_room(0.17), &wide), 0.0, "every return is the robot's own body");
        assert_eq!(known_m(&with_mast, &narrow), 0.2);
        assert!(known_m(&with_mast, &no_body()) < 0.05, "unknown masts are obstacles");
    }

    #[test]
    fn an_observed_obstacle_on_the_driven_path_limits_the_known_ground() {
        let mut rear = rear();
        (0..=10)
            .for_each(|step| rear.record_pose(0, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0)));
        let here = Pose2::new(0.2, 0.0, 0.0);
        assert_eq!(rear.known_free_m(0, &here, &ROUND, 0.2), 0.2);
        // A scan to the left rear sees a foot 10 cm behind the outline.
        let foot = scan_of(|angle| if angle > 1.5 { Range::Hit(0.26) } else { Range::Hit(2.0) });
        rear.record_scan(&foot, &Pose2::new(0.2, 0.0, 0.9), &no_body());
        let known_m = rear.known_free_m(0, &here, &ROUND, 0.2);
        assert!((0.05..=0.12).contains(&known_m), "{known_m}");
        let elsewhere = Pose2::new(0.05, 0.0, 0.0);
        assert!(rear.known_free_m(0, &elsewhere, &ROUND, 0.04) > 0.03, "observed from elsewhere");
    }

    #[test]
    fn a_cart_has_driven_over_the_ground_only_with_the_same_heading() {
        let corners = [[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]];
        for (yaw, known_m) in [(0.0, 0.1), (0.19, 0.1), (0.21, 0.0), (-0.21, 0.0)] {
            let mut rear = rear();
            (0..10).for_each(|step| {
                rear.record_pose(0, &Pose2::new(f64::from(step) * 0.02, 0.0, yaw));
            });
            let here = Pose2::new(0.19, 0.0, 0.0);
            let known = rear.known_free_m(0, &here, &Footprint::new(0.0, &corners), 0.1);
            assert_eq!(known, known_m, "{yaw}");
            assert_eq!(
                rear.known_free_m(0, &here, &ROUND, 0.1),
                0.1,
                "a round robot has no heading"
            );
        }
    }

    #[test]
    fn a_cart_that_has_rotated_on_the_spot_knows_the_path_that_it_drives_from_there() {
        let cart = Footprint::new(0.0, &[[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]]);
        let mut rear = rear();
        // At first its heading was 0.27 rad off, so its corners covered other ground.
        let start = Pose2::new(0.5, 0.5, 0.5);
        for yaw_rad in [0.0, 0.04, 0.08, 0.12, 0.16, 0.19] {
            rear.record_pose(0, &start.compose(&Pose2::new(0.0, 0.0, yaw_rad)));
        }
        let mut here = start.compose(&Pose2::new(0.0, 0.0, 0.19));
        for _ in 0..4 {
            here = here.compose(&Pose2::new(0.0249, 0.0, 0.02));
            rear.record_pose(0, &here);
        }
        let known_m = rear.known_free_m(0, &here, &cart, 0.12);
        assert!((0.1..0.12).contains(&known_m), "{known_m}");
    }

    #[test]
    fn a_full_trail_overwrites_its_oldest_poses() {
        let mut rear = rear();
        (0..200)
            .for_each(|step| rear.record_pose(0, &Pose2::new(f64::from(step) * 0.021, 0.0, 0.0)));
        let known_m = rear.known_free_m(0, &Pose2::new(199.0 * 0.021, 0.0, 0.0), &ROUND, 3.0);
        assert!((known_m - 63.0 * 0.021).abs() < 0.021, "{known_m}");
    }

    #[test]
    fn a_jump_of_the_odometry_forgets_everything() {
        let mut rear = rear();
        (0..10).for_each(|step| rear.record_pose(0, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0)));
        rear.forget();
        assert_eq!(rear.known_free_m(0, &Pose2::new(0.18, 0.0, 0.0), &ROUND, 0.2), 0.0);
    }

    #[test]
    fn a_snapshot_restores_the_memory_and_a_truncated_one_is_refused() {
        let mut known = rear();
        (0..70).for_each(|step| {
            known.record_pose(step as u64, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0));
        });
        known.record_scan(&round_room(2.0), &Pose2::new(1.38, 0.0, 0.5), &no_body());
        let mut bytes = Vec::new();
        known.write(&mut bytes);
        let mut restored = rear();
        let mut rest = bytes.as_slice();
        restored.read(&mut rest).unwrap();
        assert_eq!((&restored, rest.len()), (&known, 0));
        for len in 0..bytes.len() {
            assert!(rear().read(&mut &bytes[..len]).is_err(), "{len} of {}", bytes.len());
        }
    }

    #[test]
    fn a_snapshot_whose_next_index_is_beyond_the_trail_wraps_around() {
        let mut bytes = Vec::new();
        rear().write(&mut bytes);
        // The last number is the next index: 200 takes two bytes.
        assert_eq!(bytes.pop(), Some(0));
        bytes.extend([0xc8, 0x01]);
        let mut restored = rear();
        restored.read(&mut bytes.as_slice()).unwrap();
        assert_eq!(restored.next, 200 - 3 * TRAIL_LENGTH);
    }
}
