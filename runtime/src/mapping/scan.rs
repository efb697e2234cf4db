//! What the planar LiDAR says about the cells around it.

use hal::{LaserScan, Pose2, Range};

use super::grid::check_pose2;
use super::{Cell, LidarUse, MapError, OccupancyGrid};

impl OccupancyGrid {
    /// Takes in a scan: hits within the range limit mark their cells; the way to a hit is free where nothing was known.
    ///
    /// A planar scan sees one height, so it never clears what the camera saw; what only the LiDAR marked it clears. "No
    /// return" says nothing, neither do "too near" and errors.
    ///
    /// # Errors
    /// When the pose is not finite or out of reach, or the scan has another number of ranges than beams.
    pub fn integrate_scan(&mut self, scan: &LaserScan, t_odom_laser: &Pose2) -> Result<(), MapError> {
        check_pose2("t_odom_laser", t_odom_laser)?;
        let beams = scan.geometry.beams;
        if scan.ranges.len() != beams {
            return Err(MapError::ScanShape { ranges: scan.ranges.len(), beams });
        }
        if self.config.lidar == LidarUse::Off {
            return Ok(());
        }
        self.mark_hits(scan, t_odom_laser);
        if self.config.lidar == LidarUse::HitsAndFree {
            self.clear_to_hits(scan, t_odom_laser);
        }
        Ok(())
    }

    fn mark_hits(&mut self, scan: &LaserScan, t_odom_laser: &Pose2) {
        for (angle_rad, range_m) in scan.hits() {
            if range_m > 0.0 && range_m <= self.config.lidar_range_m {
                let [x_m, y_m] = end_of(t_odom_laser, angle_rad, f64::from(range_m));
                let cell = self.cell_at(x_m, y_m);
                if let Some(index) = self.index(cell) {
                    self.add_evidence(cell, index, self.config.occupied_increment);
                }
            }
        }
    }

    /// One line for every group of beams that lie closer together than cells do; a group reaches as far as its shortest
    /// beam, and nowhere if one of them is not a hit.
    fn clear_to_hits(&mut self, scan: &LaserScan, t_odom_laser: &Pose2) {
        let limit_m = self.config.lidar_range_m;
        let cell_m = self.config.cell_m;
        let spacing_m = f64::from(limit_m) * scan.geometry.angle_increment_rad.abs();
        let group = ((0.7 * cell_m / spacing_m) as usize).clamp(1, scan.ranges.len().max(1));
        for (first, beams) in (0..).step_by(group).zip(scan.ranges.chunks(group)) {
            let shortest = beams.iter().map(|range| reach_m(*range)).fold(f32::INFINITY, f32::min);
            let reach_m = f64::from(shortest.min(limit_m)) - cell_m;
            if reach_m > 0.0 {
                let angle_rad =
                    scan.geometry.angle_rad(first) + scan.geometry.angle_increment_rad * (beams.len() - 1) as f64 / 2.0;
                let end_m = end_of(t_odom_laser, angle_rad, reach_m);
                self.clear_line([t_odom_laser.x_m, t_odom_laser.y_m], end_m);
            }
        }
    }

    fn clear_line(&mut self, start_m: [f64; 2], end_m: [f64; 2]) {
        let free = -self.config.free_decrement;
        for cell in line(start_m, end_m, self.config.cell_m) {
            if let Some(index) = self.index(cell)
                && self.lidar_may_clear(index)
            {
                self.add_evidence(cell, index, free);
            }
        }
    }
}

fn reach_m(range: Range) -> f32 {
    range.hit_m().filter(|range_m| *range_m > 0.0).unwrap_or(0.0)
}

fn end_of(from: &Pose2, angle_rad: f64, distance_m: f64) -> [f64; 2] {
    let (sin, cos) = (from.yaw_rad + angle_rad).sin_cos();
    [from.x_m + cos * distance_m, from.y_m + sin * distance_m]
}

/// Every cell that a straight line touches, from start to end (Amanatides and Woo 1987).
pub(crate) fn line(start_m: [f64; 2], end_m: [f64; 2], cell_m: f64) -> impl Iterator<Item = Cell> {
    let mut cell = Cell::containing(start_m[0], start_m[1], cell_m);
    let end = Cell::containing(end_m[0], end_m[1], cell_m);
    let axis = |start: f64, end: f64, at: i32| {
        let delta = end - start;
        let step = if delta > 0.0 { 1 } else { -1 };
        let edge = f64::from(at + i32::from(delta > 0.0)) * cell_m;
        // In shares of the line's length: where the next edge is crossed, and how far apart crossings are.
        if delta == 0.0 {
            (step, f64::INFINITY, f64::INFINITY)
        } else {
            (step, (edge - start) / delta, cell_m / delta.abs())
        }
    };
    let (step_x, mut next_x, apart_x) = axis(start_m[0], end_m[0], cell.x);
    let (step_y, mut next_y, apart_y) = axis(start_m[1], end_m[1], cell.y);
    // Counting the crossings of each axis makes the line end in the right cell whatever the rounding.
    let mut left_x = (end.x - cell.x).unsigned_abs();
    let mut left_y = (end.y - cell.y).unsigned_abs();
    (0..=left_x + left_y).map(move |_| {
        let here = cell;
        if left_x > 0 && (left_y == 0 || next_x < next_y) {
            left_x -= 1;
            cell.x += step_x;
            next_x += apart_x;
        } else if left_y > 0 {
            left_y -= 1;
            cell.y += step_y;
            next_y += apart_y;
        }
        here
    })
}
