//! What is behind the surfaces that the planar LiDAR measures. A network takes a plain wall for more distant than it is: without the
//! scan, the map would hold free floor behind the wall, and another wall.

use core::f64::consts::TAU;

use hal::{LaserScan, Pose2};
use serde::{Deserialize, Serialize};

/// A surface hides what is behind it where it is at least this wide, metres: the camera sees past the leg of a chair.
const WIDTH_M: f64 = 0.2;
/// Share of the beams across that width which must have hit something: a beam may be lost now and then.
const LEAST_HITS: f64 = 0.8;
/// A scan says what is hidden from the robot until the laser has moved this far, metres. A robot at 0.4 m/s moves less from one
/// scan to the next of a scanner with 5 revolutions a second.
const REACH_M: f64 = 0.1;

/// The surfaces that one scan measured, in `map`. The default is the shadow of a robot without a scan: nothing is hidden.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Shadow {
    t_map_laser: Pose2,
    /// Correction of the map's frame at the time of the scan.
    t_map_odom: Pose2,
    /// Direction of the first beam in `laser`, and the angle between two beams, radians.
    angle_min_rad: f64,
    angle_increment_rad: f64,
    /// For each beam the distance from the laser to a wide surface, metres; infinite where there is none.
    surfaces_m: Vec<f32>,
}

impl Shadow {
    /// Replaces the shadow by that of a scan, with the pose of the laser at the time of the scan. A scan whose beams do not turn
    /// counter-clockwise hides nothing.
    pub fn cast(&mut self, scan: &LaserScan, t_map_laser: &Pose2, t_map_odom: &Pose2) {
        self.t_map_laser = *t_map_laser;
        self.t_map_odom = *t_map_odom;
        self.angle_min_rad = scan.geometry.angle_min_rad;
        self.angle_increment_rad = scan.geometry.angle_increment_rad;
        self.surfaces_m.clear();
        if self.angle_increment_rad > 0.0 && self.angle_increment_rad.is_finite() {
            let surfaces = (0..scan.ranges.len()).map(|beam| surface_m(scan, beam));
            self.surfaces_m.extend(surfaces.map(|surface_m| surface_m.unwrap_or(f32::INFINITY)));
        }
    }

    /// Ends the shadow of an earlier scan if the laser has moved away from where the scan was taken, or the map's frame was corrected.
    pub fn follow(&mut self, t_map_laser: &Pose2, t_map_odom: &Pose2) {
        let is_near = self.t_map_laser.distance_m(t_map_laser) <= REACH_M;
        if !is_near || self.t_map_odom != *t_map_odom {
            self.surfaces_m.clear();
        }
    }

    /// Whether a place in `map`, metres, is more than `behind_m` behind a surface.
    #[must_use]
    pub fn hides(&self, [x_m, y_m]: [f64; 2], behind_m: f32) -> bool {
        let dx_m = x_m - self.t_map_laser.x_m;
        let dy_m = y_m - self.t_map_laser.y_m;
        let first_rad = self.t_map_laser.yaw_rad + self.angle_min_rad;
        let turn_rad = (dy_m.atan2(dx_m) - first_rad).rem_euclid(TAU);
        let beam = (turn_rad / self.angle_increment_rad).round() as usize;
        let beam = if beam == whole_turn(self.angle_increment_rad) { 0 } else { beam };
        let surface_m = self.surfaces_m.get(beam).copied().unwrap_or(f32::INFINITY);
        dx_m.hypot(dy_m) > f64::from(surface_m) + f64::from(behind_m)
    }
}

/// Number of beams of a scanner that sees all around.
fn whole_turn(angle_increment_rad: f64) -> usize {
    (TAU / angle_increment_rad).round() as usize
}

/// Distance of the surface at a beam, if it is wide enough to hide something: that of its furthest hit.
fn surface_m(scan: &LaserScan, beam: usize) -> Option<f32> {
    let beams = scan.ranges.len();
    let is_round = beams == whole_turn(scan.geometry.angle_increment_rad);
    let near_m = [0, -1, 1].into_iter().find_map(|offset| hit_m(scan, beam, offset, is_round))?;
    let half_rad = (WIDTH_M / 2.0).atan2(f64::from(near_m));
    let half =
        (half_rad / scan.geometry.angle_increment_rad).ceil().min(beams as f64 / 2.0) as isize;
    let hits = (-half..=half).filter_map(|offset| hit_m(scan, beam, offset, is_round));
    let is_whole = hits.clone().count() as f64 >= LEAST_HITS * (2 * half + 1) as f64;
    is_whole.then(|| hits.fold(near_m, f32::max))
}

fn hit_m(scan: &LaserScan, beam: usize, offset: isize, is_round: bool) -> Option<f32> {
    let beams = scan.ranges.len();
    let at = beam.checked_add_signed(offset).filter(|at| *at < beams);
    let at = if is_round { Some((beam + beams).checked_add_signed(offset)? % beams) } else { at };
    scan.ranges.get(at?)?.hit_m().filter(|range_m| range_m.is_finite() && *range_m > 0.0)
}
