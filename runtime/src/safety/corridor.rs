//! What the scanner does not see of the path ahead.
//!
//! A beam without a measurement is not free space. An *error* beam carries no information: dirt on
//! the window, a hand, low sun. A beam *without a return* met glass or something black, or nothing
//! within range. Single such beams are ordinary, so the path ahead counts as unseen only where they
//! fill a window that is wide enough to hide an obstacle.

use hal::{LaserScan, Pose2, Range, ScanGeometry, Twist2};
use serde::{Deserialize, Serialize};

use super::Footprint;
use super::surroundings::is_error;

/// Error beams are judged in windows of this width: at the distance at which the paper's robot has
/// to brake (0.4 m) it hides an object of 3.5 cm.
const ERROR_WINDOW_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// A window with at least this share of error beams is blind. Low sun leaves single random returns.
const ERROR_SHARE: f64 = 0.8;
/// Beams without any measurement are judged in a wider window, which at 0.6 m is as wide as ten
/// table legs (0.31 m): in a room, some beam within 30 degrees normally meets something.
const UNSEEN_WINDOW_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
const UNSEEN_SHARE: f64 = 0.9;
/// The path ahead is judged where the footprint will be when its centre has moved this far beyond
/// its own radius, metres: at the stop distance, and where the robot must begin to brake.
const AHEAD_M: [f64; 2] = [0.06, 0.25];

/// A path whose middle is this far beside the field of view is not seen: less than the footprint
/// covers, and more than any scanner's beams are apart.
const BESIDE_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// What a beam measured of the space along it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
enum Sight {
    Measured,
    NoReturn,
    Error,
}

/// The beams of the newest scan, each with what it measured.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct View {
    sights: Vec<Sight>,
}

crate::snapshot::remembers!(View: sights);

impl View {
    /// Replaces the beams with those of a new scan. It allocates only when the number of beams
    /// grows.
    pub fn update(&mut self, scan: &LaserScan) {
        self.sights.clear();
        self.sights.extend(scan.ranges.iter().map(|range| match range {
            range if is_error(*range) => Sight::Error,
            Range::NoReturn => Sight::NoReturn,
            _ => Sight::Measured,
        }));
    }

    /// Whether a part of the path of a forward twist is not seen by a laser that is mounted at
    /// `t_base_laser`.
    pub fn is_blind(
        &self,
        geometry: &ScanGeometry,
        t_base_laser: &Pose2,
        footprint: &Footprint,
        twist: &Twist2,
    ) -> bool {
        let radius_m = footprint.half_width_m();
        let t_laser_base = t_base_laser.inverse();
        AHEAD_M.into_iter().any(|ahead_m| {
            let travel_m = radius_m + ahead_m;
            let seconds = (travel_m / twist.linear_mps).min(twist.angular_radps.abs().recip());
            let there = twist.integrate(seconds);
            let (x_m, y_m) = t_laser_base.transform(there.x_m, there.y_m);
            let distance_m = x_m.hypot(y_m);
            if distance_m <= radius_m {
                return false;
            }
            let middle_rad = y_m.atan2(x_m);
            // A scanner that is mounted turned may look past the path.
            if beams_between(geometry, middle_rad - BESIDE_RAD, middle_rad + BESIDE_RAD).is_empty()
            {
                return true;
            }
            let half_rad = (radius_m / distance_m).asin();
            let beams = beams_between(geometry, middle_rad - half_rad, middle_rad + half_rad);
            self.has_window(&beams, geometry, ERROR_WINDOW_RAD, ERROR_SHARE, |sight| {
                sight == Sight::Error
            }) || self.has_window(&beams, geometry, UNSEEN_WINDOW_RAD, UNSEEN_SHARE, |sight| {
                sight != Sight::Measured
            })
        })
    }

    /// Whether there is a window within `beams` in which at least this share of the beams match.
    fn has_window(
        &self,
        beams: &std::ops::Range<usize>,
        geometry: &ScanGeometry,
        width_rad: f64,
        share: f64,
        matches: impl Fn(Sight) -> bool,
    ) -> bool {
        let Some(sights) = self.sights.get(beams.clone()) else { return false };
        let width = ((width_rad / geometry.angle_increment_rad).round() as usize).max(2);
        let needed = (share * width as f64).ceil() as usize;
        let mut count = 0;
        for (index, sight) in sights.iter().enumerate() {
            count += usize::from(matches(*sight));
            if index >= width {
                count -= usize::from(sights.get(index - width).is_some_and(|gone| matches(*gone)));
            }
            if count >= needed {
                return true;
            }
        }
        false
    }
}

/// The beams between two directions, as far as the field of view reaches.
fn beams_between(geometry: &ScanGeometry, from_rad: f64, to_rad: f64) -> std::ops::Range<usize> {
    let index =
        |angle_rad: f64| (angle_rad - geometry.angle_min_rad) / geometry.angle_increment_rad;
    let first = index(from_rad).ceil().max(0.0) as usize;
    let end = (index(to_rad).floor() + 1.0).max(0.0) as usize;
    first.min(geometry.beams)..end.min(geometry.beams)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::safety::surroundings::tests::scan_of;

    const ROUND: Footprint = Footprint::Round { radius_m: 0.16 };

    fn is_blind(range_at: impl Fn(f64) -> Range, twist: (f64, f64)) -> bool {
        let scan = scan_of(range_at);
        let mut view = View::default();
        view.update(&scan);
        let twist = Twist2 { linear_mps: twist.0, angular_radps: twist.1 };
        view.is_blind(&scan.geometry, &Pose2::IDENTITY, &ROUND, &twist)
    }

    fn within(angle: f64, from_deg: f64, to_deg: f64) -> bool {
        (from_deg..to_deg).contains(&angle.to_degrees())
    }

    /// This range within `half_deg` of straight ahead, and hits elsewhere.
    fn ahead(half_deg: f64, range: Range) -> impl Fn(f64) -> Range {
        move |angle| if within(angle, -half_deg, half_deg) { range } else { Range::Hit(2.0) }
    }

    #[test]
    fn error_beams_blind_the_way_ahead_from_five_degrees_on() {
        for (half_deg, blind) in [(1.0, false), (1.9, false), (2.5, true), (67.0, true)] {
            let is_blind = is_blind(ahead(half_deg, Range::Error), (0.3, 0.0));
            assert_eq!(is_blind, blind, "{half_deg} degrees to each side");
        }
    }

    #[test]
    fn beams_without_a_return_blind_the_way_ahead_from_thirty_degrees_on() {
        for (half_deg, blind) in [(5.0, false), (13.0, false), (16.0, true), (90.0, true)] {
            let is_blind = is_blind(ahead(half_deg, Range::NoReturn), (0.3, 0.0));
            assert_eq!(is_blind, blind, "{half_deg} degrees to each side");
        }
    }

    #[test]
    fn a_path_hardly_beside_the_field_of_view_is_seen_and_one_that_is_further_beside_it_is_not() {
        let scan = scan_of(|_| Range::Hit(2.0));
        let mut view = View::default();
        view.update(&scan);
        let forward = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
        // The field of view ends at 135 degrees.
        for (yaw_deg, blind) in [(134.0, false), (136.5, false), (138.0, true)] {
            let mount = Pose2::new(0.0, 0.0, f64::to_radians(yaw_deg));
            let is_blind = view.is_blind(&scan.geometry, &mount, &ROUND, &forward);
            assert_eq!(is_blind, blind, "{yaw_deg} degrees");
        }
    }

    #[test]
    fn what_is_not_seen_behind_and_beside_the_robot_does_not_matter() {
        assert!(!is_blind(blind_beside, (0.3, 0.0)));
    }

    fn blind_beside(angle: f64) -> Range {
        if angle.abs() > 1.2 { Range::Error } else { Range::Hit(2.0) }
    }

    #[test]
    fn on_an_arc_the_way_ahead_lies_on_the_side_of_the_arc() {
        assert!(!is_blind(blind_left, (0.3, 0.0)));
        assert!(is_blind(blind_left, (0.1, 0.4)));
        assert!(!is_blind(blind_left, (0.1, -0.4)));
    }

    fn blind_left(angle: f64) -> Range {
        if within(angle, 60.0, 80.0) { Range::Error } else { Range::Hit(2.0) }
    }

    #[test]
    fn a_turned_scanner_is_blind_where_the_path_ahead_is_and_not_where_its_own_front_is() {
        let forward = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
        let scan =
            scan_of(
                |angle| {
                    if within(angle, -40.0, -20.0) { Range::Error } else { Range::Hit(2.0) }
                },
            );
        let mut view = View::default();
        view.update(&scan);
        for (yaw_deg, blind) in [(30.0_f64, true), (-80.0, false)] {
            let t_base_laser = Pose2::new(0.0, 0.0, yaw_deg.to_radians());
            assert_eq!(
                view.is_blind(&scan.geometry, &t_base_laser, &ROUND, &forward),
                blind,
                "{yaw_deg} degrees"
            );
        }
    }

    #[test]
    fn a_path_outside_of_the_field_of_view_is_not_seen() {
        let scan = scan_of(|_| Range::Hit(2.0));
        let mut view = View::default();
        view.update(&scan);
        let t_base_laser = Pose2::new(0.0, 0.0, std::f64::consts::PI);
        let forward = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
        assert!(view.is_blind(&scan.geometry, &t_base_laser, &ROUND, &forward));
    }

    #[test]
    fn every_second_beam_is_enough_to_see() {
        let mut scan = scan_of(|_| Range::Hit(2.0));
        scan.ranges.iter_mut().step_by(2).for_each(|range| *range = Range::Error);
        let mut view = View::default();
        view.update(&scan);
        let forward = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
        assert!(!view.is_blind(&scan.geometry, &Pose2::IDENTITY, &ROUND, &forward));
    }
}
