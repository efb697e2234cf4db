//! What is known of the ground behind the robot, where a scanner of 270 degrees does not look.
//!
//! Two things make ground known: the robot drove over it a moment ago, or the scanner looked that way a moment ago, before the
//! robot turned away.

use std::f64::consts::{PI, TAU};

use hal::{LaserScan, Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::Footprint;
use super::surroundings::{Surroundings, distance_m};
use crate::snapshot::{SnapshotError, State};

/// Directions in `odom` that are remembered apart: 10 degrees each.
const SECTORS: usize = 36;
/// A look from farther away than this no longer tells what is behind the robot here, metres.
const MOVED_ON_M: f64 = 0.1;
/// Places of the way that are remembered, and the way between two, metres.
const TRAIL: usize = 64;
const TRAIL_STEP_M: f64 = 0.02;
/// Beside the way by less than this is still on it, metres. Less than a step, so that standing somewhere says nothing of what
/// is behind.
const ON_TRAIL_M: f64 = 0.019;
/// A footprint with corners drove over the ground only when it pointed the same way, within this, radians.
const SAME_HEADING_RAD: f64 = 0.2;
/// Steps in which the way back is checked, metres.
const STEP_M: f64 = 0.02;

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Look {
    time_ns: u64,
    from_m: [f64; 2],
    /// The nearest return of that direction, metres.
    nearest_m: f64,
}

/// What is known of the ground behind. Fixed size: nothing is allocated.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rear {
    memory_ns: u64,
    looks: [Option<Look>; SECTORS],
    trail: [Option<(u64, Pose2)>; TRAIL],
    next: usize,
}

impl Rear {
    pub fn new(memory_s: f64) -> Self {
        Self {
            memory_ns: (memory_s * 1e9) as u64,
            looks: [None; SECTORS],
            trail: [None; TRAIL],
            next: 0,
        }
    }

    /// The robot stands here.
    pub fn stand(&mut self, time_ns: u64, pose: &Pose2) {
        let last = self.trail[(self.next + TRAIL - 1) % TRAIL];
        let moved = last.is_none_or(|(_, last)| {
            last.distance_m(pose) >= TRAIL_STEP_M
                || wrap_angle(last.yaw_rad - pose.yaw_rad).abs() > SAME_HEADING_RAD / 2.0
        });
        if moved {
            self.trail[self.next] = Some((time_ns, *pose));
            self.next = (self.next + 1) % TRAIL;
        }
    }

    /// Odometry jumped or began anew: nothing that was known is where it was.
    pub fn forget(&mut self) {
        (self.looks, self.trail) = ([None; SECTORS], [None; TRAIL]);
    }

    /// A scan, taken while the laser was at `t_odom_laser`. A direction counts as looked at when half of its beams came back
    /// from something that is not the robot itself. When fewer did, what an older look saw there no longer counts.
    pub fn see(&mut self, scan: &LaserScan, t_odom_laser: &Pose2, around: &Surroundings) {
        let mut returned = [(0_u32, 0_u32, f64::INFINITY); SECTORS];
        for (beam, range) in scan.ranges.iter().enumerate() {
            let (all, back, nearest_m) =
                &mut returned[sector_of(scan.geometry.angle_rad(beam) + t_odom_laser.yaw_rad)];
            *all += 1;
            let range_m = distance_m(*range, &scan.geometry)
                .filter(|range_m| *range_m > around.own_body_m(beam));
            if let Some(range_m) = range_m {
                *back += 1;
                *nearest_m = nearest_m.min(f64::from(range_m));
            }
        }
        let from_m = [t_odom_laser.x_m, t_odom_laser.y_m];
        // Directions at the border of the view are seen in part only.
        let whole = (TAU / SECTORS as f64 / scan.geometry.angle_increment_rad) as u32;
        for (look, (all, back, nearest_m)) in self.looks.iter_mut().zip(returned) {
            if all >= whole.max(1) {
                *look =
                    (2 * back >= all).then_some(Look { time_ns: scan.time_ns, from_m, nearest_m });
            }
        }
    }

    /// How far back from `pose` the ground is known to be free, up to `wanted_m`, metres.
    pub fn known_free_m(
        &self,
        time_ns: u64,
        pose: &Pose2,
        footprint: &Footprint,
        wanted_m: f64,
    ) -> f64 {
        if self.looks_behind(time_ns, pose).all(|look| look.is_some()) {
            let looks = self
                .looks
                .iter()
                .enumerate()
                .filter_map(|(sector, look)| Some((sector, look.as_ref()?)));
            return seen_gap_m(looks, pose, footprint).min(wanted_m).max(0.0);
        }
        // Whoever has stepped onto the way since was seen, if somebody looked.
        let seen_m = seen_gap_m(self.looks_behind(time_ns, pose).flatten(), pose, footprint);
        let steps = (wanted_m / STEP_M).ceil() as usize;
        let driven_over = |step: &usize| {
            let place = pose.compose(&Pose2::new(-(*step as f64 * STEP_M).min(wanted_m), 0.0, 0.0));
            self.way(time_ns, pose).any(|(was, then)| {
                let same_way = matches!(footprint, Footprint::Round { .. })
                    || wrap_angle(was.yaw_rad - pose.yaw_rad).abs() < SAME_HEADING_RAD;
                same_way && distance_to_way_m(&place, &was, &then) < ON_TRAIL_M
            })
        };
        ((1..=steps).take_while(driven_over).count() as f64 * STEP_M)
            .min(wanted_m)
            .min(seen_m.max(0.0))
    }

    /// The way that was driven a moment ago, piece by piece, up to here.
    fn way<'a>(
        &'a self,
        time_ns: u64,
        here: &'a Pose2,
    ) -> impl Iterator<Item = (Pose2, Pose2)> + 'a {
        let place = move |back: usize| self.trail[(self.next + 2 * TRAIL - 1 - back) % TRAIL];
        (0..TRAIL)
            .map_while(place)
            .take_while(move |(when_ns, _)| self.recent(time_ns, *when_ns))
            .scan(*here, |then, (_, was)| Some((was, std::mem::replace(then, was))))
    }

    fn recent(&self, time_ns: u64, when_ns: u64) -> bool {
        time_ns.saturating_sub(when_ns) <= self.memory_ns
    }

    /// The looks behind, as far as they are recent and were taken near here.
    fn looks_behind<'a>(
        &'a self,
        time_ns: u64,
        pose: &'a Pose2,
    ) -> impl Iterator<Item = Option<(usize, &'a Look)>> + 'a {
        let behind = move |sector: &usize| {
            wrap_angle(direction_of(*sector) - pose.yaw_rad).abs() > 0.75 * PI
        };
        (0..SECTORS).filter(behind).map(move |sector| {
            let look = self.looks[sector].as_ref()?;
            let near = (look.from_m[0] - pose.x_m).hypot(look.from_m[1] - pose.y_m) < MOVED_ON_M;
            (near && self.recent(time_ns, look.time_ns)).then_some((sector, look))
        })
    }
}

/// Free way back to what looks saw, metres; infinite where they saw nothing in the way. A return may be anywhere across its
/// direction.
fn seen_gap_m<'a>(
    looks: impl Iterator<Item = (usize, &'a Look)>,
    pose: &Pose2,
    footprint: &Footprint,
) -> f64 {
    let half = PI / SECTORS as f64;
    let t_base_odom = pose.inverse();
    let points = looks.flat_map(|(sector, look)| {
        [-half, 0.0, half].map(|off| {
            let (sin, cos) = (direction_of(sector) + off).sin_cos();
            let (x_m, y_m) =
                (look.from_m[0] + look.nearest_m * cos, look.from_m[1] + look.nearest_m * sin);
            let (x_m, y_m) = t_base_odom.transform(x_m, y_m);
            [x_m, y_m]
        })
    });
    points.filter_map(|point| footprint.straight_gap_m(point, -1.0)).fold(f64::INFINITY, f64::min)
}

/// Distance of a place from the straight piece between two others.
fn distance_to_way_m(place: &Pose2, from: &Pose2, to: &Pose2) -> f64 {
    let (along_x, along_y) = (to.x_m - from.x_m, to.y_m - from.y_m);
    let (x, y) = (place.x_m - from.x_m, place.y_m - from.y_m);
    let length_2 = along_x * along_x + along_y * along_y;
    let share =
        if length_2 > 0.0 { ((x * along_x + y * along_y) / length_2).clamp(0.0, 1.0) } else { 0.0 };
    (x - share * along_x).hypot(y - share * along_y)
}

fn sector_of(angle_rad: f64) -> usize {
    let turns = (angle_rad / TAU).rem_euclid(1.0);
    ((turns * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// The middle of a sector.
fn direction_of(sector: usize) -> f64 {
    (sector as f64 + 0.5) * TAU / SECTORS as f64
}

impl State for Rear {
    fn write(&self, to: &mut Vec<u8>) {
        self.looks.iter().for_each(|look| look.write(to));
        self.trail.iter().for_each(|place| place.write(to));
        self.next.write(to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.looks.iter_mut().try_for_each(|look| look.read(from))?;
        self.trail.iter_mut().try_for_each(|place| place.read(from))?;
        self.next.read(from)?;
        self.next %= TRAIL;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::safety::surroundings::tests::scan_of;
    use crate::safety::{BodySector, SafetyConfig};
    use hal::{Range, ScanGeometry};

    const ROUND: Footprint = Footprint::Round { radius_m: 0.16 };

    fn rear() -> Rear {
        Rear::new(30.0)
    }

    /// A scanner that sees nothing of the robot itself.
    fn nobody() -> Surroundings {
        Surroundings::new(&SafetyConfig::default())
    }

    /// A round room with the robot in its middle.
    fn round_room(radius_m: f32) -> LaserScan {
        scan_of(|_| Range::Hit(radius_m))
    }

    #[test]
    fn nothing_is_known_before_anything_was_seen() {
        assert_eq!(rear().known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn the_ground_that_the_robot_has_just_driven_over_is_free_and_no_farther() {
        let mut rear = rear();
        for step in 0..10 {
            rear.stand(0, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0));
        }
        let here = Pose2::new(0.18, 0.0, 0.0);
        let known_m = rear.known_free_m(0, &here, &ROUND, 0.5);
        assert!((0.16..=0.22).contains(&known_m), "{known_m}");
        let turned = Pose2::new(0.18, 0.0, 1.5);
        assert!(
            rear.known_free_m(0, &turned, &ROUND, 0.5) < 0.03,
            "the way is not behind any more"
        );
        assert_eq!(
            rear.known_free_m(29_000_000_000, &here, &ROUND, 0.5),
            known_m,
            "not too long ago"
        );
        assert_eq!(rear.known_free_m(31_000_000_000, &here, &ROUND, 0.5), 0.0, "too long ago");
    }

    #[test]
    fn standing_for_long_does_not_forget_the_way_that_was_driven() {
        let mut rear = rear();
        let at =
            |way_m: f64, yaw: f64| Pose2::new(0.0, 0.0, 1.0).compose(&Pose2::new(way_m, 0.0, yaw));
        (0..10).for_each(|step| rear.stand(0, &at(f64::from(step) * 0.021, 0.0)));
        (0..1000).for_each(|_| rear.stand(0, &at(0.195, 0.05)));
        assert!(rear.known_free_m(0, &at(0.195, 0.0), &ROUND, 0.5) > 0.16);
    }

    #[test]
    fn a_turn_on_the_spot_lets_the_scanner_see_what_is_then_behind() {
        let mut rear = rear();
        rear.see(&round_room(2.0), &Pose2::IDENTITY, &nobody());
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0, "behind is blind");
        rear.see(&round_room(2.0), &Pose2::new(0.0, 0.0, 1.7), &nobody());
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
    fn only_what_lies_behind_need_be_looked_at_and_a_direction_that_was_seen_in_part_was_not() {
        // A scan reaches 135 degrees to the left; behind are the directions from 200 to 290 degrees.
        let here = Pose2::new(1.0, -2.0, 63f64.to_radians());
        for (looked_deg, known_m) in [(146.1, 0.0), (156.1, 0.2)] {
            let mut rear = rear();
            rear.see(
                &round_room(2.0),
                &Pose2::new(1.0, -2.0, f64::to_radians(looked_deg)),
                &nobody(),
            );
            assert_eq!(rear.known_free_m(0, &here, &ROUND, 0.2), known_m, "{looked_deg}");
        }
    }

    #[test]
    fn a_direction_is_seen_when_half_of_its_beams_came_back() {
        for (every, known_m) in [(2, 0.2), (3, 0.0)] {
            let mut scan = round_room(2.0);
            let dark = |(beam, range): (usize, &mut Range)| {
                if beam % every != 0 {
                    *range = Range::NoReturn;
                }
            };
            scan.ranges.iter_mut().enumerate().for_each(dark);
            let mut rear = rear();
            for yaw in [0.0, 1.7] {
                rear.see(&scan, &Pose2::new(0.0, 0.0, yaw), &nobody());
            }
            assert_eq!(
                rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2),
                known_m,
                "one of {every}"
            );
        }
    }

    #[test]
    fn a_return_may_be_anywhere_across_its_direction_and_is_where_it_was_when_the_robot_has_moved_a_little()
     {
        let mut rear = rear();
        // Something between 190 and 200 degrees, 0.7 m away; the robot looks that way and turns back.
        let looked_rad = -1.7;
        let post = scan_of(|angle| match (angle + looked_rad).to_degrees().rem_euclid(360.0) {
            at if (190.1..199.9).contains(&at) => Range::Hit(0.7),
            _ => Range::Hit(3.0),
        });
        rear.see(&round_room(3.0), &Pose2::new(0.0, 0.0, 1.7), &nobody());
        rear.see(&post, &Pose2::new(0.0, 0.0, looked_rad), &nobody());
        let known_m = |y_m: f64| rear.known_free_m(0, &Pose2::new(0.0, y_m, 0.0), &ROUND, 1.0);
        // At 190 degrees it would be met; its middle would be passed.
        let (far_m, aside_m) = (0.7 * 10f64.to_radians().cos(), 0.7 * 10f64.to_radians().sin());
        let gap_m = |aside_m: f64| far_m - (0.16 * 0.16 - aside_m * aside_m).sqrt();
        assert!((known_m(0.0) - gap_m(aside_m)).abs() < 1e-6, "{}", known_m(0.0));
        assert!((known_m(-0.06) - gap_m(aside_m - 0.06)).abs() < 1e-6, "{}", known_m(-0.06));
        assert_eq!(known_m(0.06), 1.0, "beside it");
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
            "a whole turn, but for less than a number can hold"
        );
    }

    #[test]
    fn the_distance_from_a_straight_piece_is_that_from_its_nearest_place() {
        // Five metres to the north-east: three and four.
        let (from, to) = (Pose2::new(1.0, 2.0, 0.0), Pose2::new(4.0, 6.0, 0.0));
        let at = |along_m: f64, aside_m: f64| {
            Pose2::new(
                1.0 + 0.6 * along_m - 0.8 * aside_m,
                2.0 + 0.8 * along_m + 0.6 * aside_m,
                0.0,
            )
        };
        for (along_m, aside_m, distance_m) in [
            (2.0, 0.5, 0.5),
            (4.0, -0.25, 0.25),
            (0.0, 1.0, 1.0),
            (-3.0, 4.0, 5.0),
            (8.0, -4.0, 5.0),
        ] {
            assert!(
                (distance_to_way_m(&at(along_m, aside_m), &from, &to) - distance_m).abs() < 1e-12
            );
        }
        assert!(
            (distance_to_way_m(&at(-3.0, 4.0), &from, &from) - 5.0).abs() < 1e-12,
            "a piece without length"
        );
    }

    #[test]
    fn what_was_seen_before_the_turn_is_still_there_after_it() {
        let mut rear = rear();
        rear.see(&round_room(0.3), &Pose2::IDENTITY, &nobody());
        rear.see(&round_room(0.3), &Pose2::new(0.0, 0.0, 1.7), &nobody());
        let known_m = rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.5);
        assert!(known_m > 0.05 && known_m < 0.15, "a wall 0.14 m behind the footprint: {known_m}");
    }

    #[test]
    fn directions_without_a_return_are_not_known() {
        let mut rear = rear();
        let dark = scan_of(|angle| if angle > 0.5 { Range::NoReturn } else { Range::Hit(2.0) });
        for yaw in [0.0, 1.7] {
            rear.see(&dark, &Pose2::new(0.0, 0.0, yaw), &nobody());
        }
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn a_direction_that_fell_dark_is_not_known_any_more() {
        let mut rear = rear();
        rear.see(&round_room(2.0), &Pose2::IDENTITY, &nobody());
        rear.see(&round_room(2.0), &Pose2::new(0.0, 0.0, 1.7), &nobody());
        rear.see(&scan_of(|_| Range::NoReturn), &Pose2::new(0.0, 0.0, 1.7), &nobody());
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn a_distance_that_is_nan_says_nothing_of_the_ground() {
        let mut rear = rear();
        for yaw in [0.0, 1.7] {
            rear.see(&scan_of(|_| Range::Hit(f32::NAN)), &Pose2::new(0.0, 0.0, yaw), &nobody());
        }
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn something_too_near_behind_is_as_near_as_can_be_measured() {
        let mut rear = rear();
        for yaw in [0.0, 1.7] {
            rear.see(&scan_of(|_| Range::TooNear), &Pose2::new(0.0, 0.0, yaw), &nobody());
        }
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
        let slim = Footprint::Round { radius_m: 0.04 };
        let known_m = rear.known_free_m(0, &Pose2::IDENTITY, &slim, 0.2);
        assert!((known_m - 0.06).abs() < 0.01, "0.1 m from the laser: {known_m}");
    }

    #[test]
    fn a_scanner_so_coarse_that_no_beam_looks_behind_has_not_looked_there() {
        let geometry = ScanGeometry {
            angle_min_rad: -2.0,
            angle_increment_rad: 0.25,
            beams: 17,
            ..ScanGeometry::UTM_30LX
        };
        let mut rear = rear();
        rear.see(
            &LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(3.0); 17] },
            &Pose2::IDENTITY,
            &nobody(),
        );
        assert_eq!(rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2), 0.0);
    }

    #[test]
    fn the_robots_own_mast_is_neither_free_ground_nor_an_obstacle_behind() {
        let mast = |sector: BodySector| {
            let mut around =
                Surroundings::new(&SafetyConfig { body: vec![sector], ..SafetyConfig::default() });
            around.see(&round_room(0.17));
            around
        };
        let (wide, narrow) = (
            mast(BodySector { from_deg: -135.0, to_deg: 135.0, up_to_m: 0.17 }),
            mast(BodySector { from_deg: 90.0, to_deg: 92.0, up_to_m: 0.17 }),
        );
        // Behind is free, but for the mast before the scanner.
        let with_mast = scan_of(|angle| match angle.to_degrees() {
            at if (90.0..=92.0).contains(&at) => Range::Hit(0.165),
            _ => Range::Hit(2.0),
        });
        let known_m = |scan: &LaserScan, around: &Surroundings| {
            let mut rear = rear();
            for yaw in [0.0, 1.7] {
                rear.see(scan, &Pose2::new(0.0, 0.0, yaw), around);
            }
            rear.known_free_m(0, &Pose2::IDENTITY, &ROUND, 0.2)
        };
        assert_eq!(known_m(&round_room(0.17), &wide), 0.0, "nothing but the robot was seen");
        assert_eq!(known_m(&with_mast, &narrow), 0.2);
        assert!(known_m(&with_mast, &nobody()) < 0.05, "unknown masts are obstacles");
    }

    #[test]
    fn whoever_stepped_onto_the_way_that_was_driven_is_seen_there_if_anybody_looked() {
        let mut rear = rear();
        (0..=10).for_each(|step| rear.stand(0, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0)));
        let here = Pose2::new(0.2, 0.0, 0.0);
        assert_eq!(rear.known_free_m(0, &here, &ROUND, 0.2), 0.2);
        // A look over the left shoulder: a foot 10 cm behind the outline.
        let foot = scan_of(|angle| if angle > 1.5 { Range::Hit(0.26) } else { Range::Hit(2.0) });
        rear.see(&foot, &Pose2::new(0.2, 0.0, 0.9), &nobody());
        let known_m = rear.known_free_m(0, &here, &ROUND, 0.2);
        assert!((0.05..=0.12).contains(&known_m), "{known_m}");
        let elsewhere = Pose2::new(0.05, 0.0, 0.0);
        assert!(rear.known_free_m(0, &elsewhere, &ROUND, 0.04) > 0.03, "seen from elsewhere");
    }

    #[test]
    fn a_cart_has_driven_over_the_ground_only_where_it_pointed_the_same_way() {
        let corners = [[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]];
        for (yaw, known_m) in [(0.0, 0.1), (0.19, 0.1), (0.21, 0.0), (-0.21, 0.0)] {
            let mut rear = rear();
            (0..10).for_each(|step| rear.stand(0, &Pose2::new(f64::from(step) * 0.02, 0.0, yaw)));
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
    fn a_cart_that_has_turned_on_the_spot_knows_the_way_that_it_drives_from_there() {
        let cart = Footprint::new(0.0, &[[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]]);
        let mut rear = rear();
        // When it stood at the beginning of its way first, it pointed 0.27 rad to the side: its corners were elsewhere.
        let start = Pose2::new(0.5, 0.5, 0.5);
        let turned = |rad: f64| start.compose(&Pose2::new(0.0, 0.0, rad));
        [0.0, 0.04, 0.08, 0.12, 0.16, 0.19].iter().for_each(|rad| rear.stand(0, &turned(*rad)));
        let mut here = turned(0.19);
        for _ in 0..4 {
            here = here.compose(&Pose2::new(0.0249, 0.0, 0.02));
            rear.stand(0, &here);
        }
        let known_m = rear.known_free_m(0, &here, &cart, 0.12);
        assert!((0.1..0.12).contains(&known_m), "{known_m}");
    }

    #[test]
    fn the_trail_is_as_long_as_its_places_and_older_ones_are_overwritten() {
        let mut rear = rear();
        (0..200).for_each(|step| rear.stand(0, &Pose2::new(f64::from(step) * 0.021, 0.0, 0.0)));
        let known_m = rear.known_free_m(0, &Pose2::new(199.0 * 0.021, 0.0, 0.0), &ROUND, 3.0);
        assert!((known_m - 63.0 * 0.021).abs() < 0.021, "{known_m}");
    }

    #[test]
    fn a_jump_of_the_odometry_forgets_everything() {
        let mut rear = rear();
        (0..10).for_each(|step| rear.stand(0, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0)));
        rear.forget();
        assert_eq!(rear.known_free_m(0, &Pose2::new(0.18, 0.0, 0.0), &ROUND, 0.2), 0.0);
    }

    #[test]
    fn what_is_known_of_the_ground_behind_is_the_same_after_a_snapshot_and_half_of_one_is_refused()
    {
        let mut known = rear();
        (0..70).for_each(|step| {
            known.stand(step as u64, &Pose2::new(f64::from(step) * 0.02, 0.0, 0.0));
        });
        known.see(&round_room(2.0), &Pose2::new(1.38, 0.0, 0.5), &nobody());
        let mut bytes = Vec::new();
        known.write(&mut bytes);
        let (mut taken_up, mut rest) = (rear(), bytes.as_slice());
        taken_up.read(&mut rest).unwrap();
        assert_eq!((&taken_up, rest.len()), (&known, 0));
        for len in 0..bytes.len() {
            assert!(rear().read(&mut &bytes[..len]).is_err(), "{len} of {}", bytes.len());
        }
    }

    #[test]
    fn a_snapshot_that_names_a_place_beyond_the_trail_is_taken_for_one_on_it() {
        let mut bytes = Vec::new();
        rear().write(&mut bytes);
        // Its last number is the next place: 200, in two bytes.
        assert_eq!(bytes.pop(), Some(0));
        bytes.extend([0xc8, 0x01]);
        let mut taken_up = rear();
        taken_up.read(&mut bytes.as_slice()).unwrap();
        assert_eq!(taken_up.next, 200 - 3 * TRAIL);
    }
}
