//! The surfaces that the planar LiDAR measures around the robot. Its ranges are better than depth: a camera obstacle near such a surface
//! stands at it, and what a camera shows behind it is doubted (`frame_evidence.rs`).

use core::f64::consts::TAU;

use hal::{LaserScan, Pose2};
use serde::{Deserialize, Serialize};

/// A surface is at least this wide, metres: the camera sees past the leg of a chair.
const WIDTH_M: f64 = 0.2;
/// Of the beams across that width, at most this many on each side are looked at.
const SIDE_BEAMS: usize = 16;
/// Share of these beams which must have hit something: a beam may be lost now and then.
const LEAST_HITS: f64 = 0.8;
/// A scan counts until the laser has moved this far, metres. A robot at 0.4 m/s moves less from one
/// scan to the next of a scanner with 5 revolutions a second.
const REACH_M: f64 = 0.1;

/// The surfaces that one scan measured, in `map`. The default is that of a robot without a scan: there are none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Surfaces {
    t_map_laser: Pose2,
    /// Correction of the map's frame at the time of the scan.
    t_map_odom: Pose2,
    /// Direction of the first beam in `laser`, and the angle between two beams, radians.
    angle_min_rad: f64,
    angle_increment_rad: f64,
    /// For each beam the distance from the laser to a wide surface, metres; infinite where there is none.
    surfaces_m: Vec<f32>,
}

/// The surface in the direction of a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surface {
    /// Its point in that direction, in `map`, metres.
    pub point_m: [f64; 2],
    /// Distance of the place behind it, metres; negative if the place is before it.
    pub behind_m: f64,
}

impl Surfaces {
    /// Replaces the surfaces by those of a scan, with the pose of the laser at the time of the scan. A scan whose beams do not turn
    /// counter-clockwise has none.
    pub fn measure(&mut self, scan: &LaserScan, t_map_laser: &Pose2, t_map_odom: &Pose2) {
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

    /// Forgets the surfaces of an earlier scan if the laser has moved away from where the scan was taken, or the map's frame was corrected.
    pub fn follow(&mut self, t_map_laser: &Pose2, t_map_odom: &Pose2) {
        let is_near = self.t_map_laser.distance_m(t_map_laser) <= REACH_M;
        if !is_near || self.t_map_odom != *t_map_odom {
            self.surfaces_m.clear();
        }
    }

    /// The surface in the direction of a place in `map`, metres.
    pub(super) fn toward(&self, [x_m, y_m]: [f64; 2]) -> Option<Surface> {
        let dx_m = x_m - self.t_map_laser.x_m;
        let dy_m = y_m - self.t_map_laser.y_m;
        let first_rad = self.t_map_laser.yaw_rad + self.angle_min_rad;
        let turn_rad = (dy_m.atan2(dx_m) - first_rad).rem_euclid(TAU);
        let beam = (turn_rad / self.angle_increment_rad).round() as usize;
        let beam = if beam == whole_turn(self.angle_increment_rad) { 0 } else { beam };
        let surface_m = self.surfaces_m.get(beam).map(|surface_m| f64::from(*surface_m))?;
        let distance_m = dx_m.hypot(dy_m);
        let share = surface_m / distance_m;
        let point_m = [self.t_map_laser.x_m + share * dx_m, self.t_map_laser.y_m + share * dy_m];
        surface_m.is_finite().then_some(Surface { point_m, behind_m: distance_m - surface_m })
    }
}

/// Number of beams of a scanner that sees all around.
fn whole_turn(angle_increment_rad: f64) -> usize {
    (TAU / angle_increment_rad).round() as usize
}

/// Distance of the surface at a beam, if there is one as wide as [`WIDTH_M`]: the median of its ranges. That is the wall's where the leg
/// of a chair is before the wall.
fn surface_m(scan: &LaserScan, beam: usize) -> Option<f32> {
    let beams = scan.ranges.len();
    let is_round = beams == whole_turn(scan.geometry.angle_increment_rad);
    let near_m = [0, -1, 1].into_iter().find_map(|offset| hit_m(scan, beam, offset, is_round))?;
    let half_rad = (WIDTH_M / 2.0).atan2(f64::from(near_m));
    let half = (half_rad / scan.geometry.angle_increment_rad).ceil().min(beams as f64 / 2.0);
    let step = (half as usize).div_ceil(SIDE_BEAMS).max(1);
    let mut hits_m = [0.0; 2 * SIDE_BEAMS + 1];
    let mut hits = 0;
    let mut looked_at = 0;
    for offset in (-(half as isize)..=half as isize).step_by(step) {
        looked_at += 1;
        if let Some(range_m) = hit_m(scan, beam, offset, is_round) {
            hits_m[hits] = range_m;
            hits += 1;
        }
    }
    if (hits as f64) < LEAST_HITS * f64::from(looked_at) {
        return None;
    }
    let (_, median_m, _) = hits_m[..hits].select_nth_unstable_by(hits / 2, f32::total_cmp);
    Some(*median_m)
}

fn hit_m(scan: &LaserScan, beam: usize, offset: isize, is_round: bool) -> Option<f32> {
    let beams = scan.ranges.len();
    let at = beam.checked_add_signed(offset).filter(|at| *at < beams);
    let at = if is_round { Some((beam + beams).checked_add_signed(offset)? % beams) } else { at };
    scan.ranges.get(at?)?.hit_m().filter(|range_m| range_m.is_finite() && *range_m > 0.0)
}
