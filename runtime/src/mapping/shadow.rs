//! What is behind the surfaces that the planar LiDAR measures. The camera does not see through them: depth that ends behind one
//! is wrong, or of something that stands higher than the scan and that no path from here leads to.

use core::f64::consts::TAU;

use hal::{LaserScan, Pose2};
use serde::{Deserialize, Serialize};

use super::grid::check_pose2;
use super::{LidarUse, MapError, OccupancyGrid};

/// A surface hides what is behind it where it is at least this wide, metres: the camera sees past the leg of a chair.
const WIDTH_M: f64 = 0.2;
/// Share of the beams across that width which must have hit something: a beam may be lost now and then.
const LEAST_HITS: f64 = 0.8;
/// A scan says what is hidden from the robot until it has driven this far, metres. It is less than
/// [`behind_hit_m`](super::MapConfig::behind_hit_m), and a scanner with 5 revolutions a second has the next scan before.
const REACH_M: f64 = 0.1;

/// The shadow of one scan in the map's frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Shadow {
    /// Position of the laser and direction of the first beam.
    laser: [f64; 2],
    angle_min_rad: f64,
    angle_increment_rad: f64,
    /// Position of the robot at the time of the scan.
    robot: [f64; 2],
    /// For each beam the distance from the laser from which on everything is hidden; infinite if nothing is.
    hidden_from_m: Vec<f32>,
}

impl Shadow {
    /// Replaces the shadow by that of a scan. A place is hidden if it is more than `behind_m` behind a wide surface.
    fn cast(&mut self, scan: &LaserScan, t_odom_laser: &Pose2, robot: [f64; 2], behind_m: f32) {
        self.laser = [t_odom_laser.x_m, t_odom_laser.y_m];
        self.angle_min_rad = t_odom_laser.yaw_rad + scan.geometry.angle_min_rad;
        self.angle_increment_rad = scan.geometry.angle_increment_rad;
        self.robot = robot;
        let hidden = (0..scan.ranges.len()).map(|beam| Some(surface_m(scan, beam)? + behind_m));
        self.hidden_from_m.clear();
        self.hidden_from_m.extend(hidden.map(|from_m| from_m.unwrap_or(f32::INFINITY)));
    }

    /// Whether a place in the map is hidden.
    pub(super) fn hides(&self, [x_m, y_m]: [f64; 2]) -> bool {
        let dx_m = x_m - self.laser[0];
        let dy_m = y_m - self.laser[1];
        let turn_rad = (dy_m.atan2(dx_m) - self.angle_min_rad).rem_euclid(TAU);
        let beam = (turn_rad / self.angle_increment_rad).round() as usize;
        self.hidden_from_m.get(beam).is_some_and(|from_m| dx_m.hypot(dy_m) > f64::from(*from_m))
    }

    /// Nothing is hidden any more if the robot has driven away from where the scan was taken.
    pub(super) fn follow(&mut self, robot: [f64; 2]) {
        if (robot[0] - self.robot[0]).hypot(robot[1] - self.robot[1]) > REACH_M {
            self.hidden_from_m.clear();
        }
    }
}

/// Distance of the surface at a beam, if it is wide enough to hide something: that of its furthest hit.
fn surface_m(scan: &LaserScan, beam: usize) -> Option<f32> {
    let neighbours = scan.ranges.get(beam.saturating_sub(1)..=beam.saturating_add(1))?;
    let hit_m = neighbours.iter().find_map(|range| range.hit_m())?;
    let half_rad = (WIDTH_M / 2.0).atan2(f64::from(hit_m));
    let half = (half_rad / scan.geometry.angle_increment_rad).ceil() as usize;
    let around = scan.ranges.get(beam.checked_sub(half)?..=beam.saturating_add(half))?;
    let hits = around.iter().filter_map(|range| range.hit_m());
    let is_whole = hits.clone().count() as f64 >= LEAST_HITS * around.len() as f64;
    is_whole.then(|| hits.fold(hit_m, f32::max))
}

impl OccupancyGrid {
    /// Keeps depth out of the map that ends behind the surfaces of a scan, until the robot has driven on. The scan is that of
    /// the depth's time, in the pose in which it was taken, and is given before [`integrate_depth`](Self::integrate_depth).
    ///
    /// # Errors
    /// As [`integrate_scan`](Self::integrate_scan).
    pub fn hide_behind(&mut self, scan: &LaserScan, t_odom_laser: &Pose2) -> Result<(), MapError> {
        check_pose2("t_odom_laser", t_odom_laser)?;
        let beams = scan.geometry.beams;
        if scan.ranges.len() != beams {
            return Err(MapError::ScanShape { ranges: scan.ranges.len(), beams });
        }
        if self.config.lidar != LidarUse::Off {
            self.shadow.cast(scan, t_odom_laser, self.robot, self.config.behind_hit_m);
        }
        Ok(())
    }
}
