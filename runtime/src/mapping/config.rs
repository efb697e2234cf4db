//! The map's size and how it weighs evidence.

use hal::settings::OutOfRange;
use serde::{Deserialize, Serialize};

use super::MapError;

/// What the map takes from the planar LiDAR.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidarUse {
    /// The map ignores the LiDAR.
    Off,
    /// Hits mark cells occupied.
    Hits,
    /// Hits mark cells occupied, and cells on the line to a hit become free if they were unknown.
    #[default]
    HitsAndFree,
}

hal::choices!(LidarUse: "off", "hits", "hits-and-free");

hal::settings! {
    /// The occupancy grid: its size, and how it weighs evidence.
    pub struct MapConfig {
        /// Side of a cell.
        cell_m: f64 = 0.03, in 0.005..=1.0, unit "m", source "paper (real robot)";
        /// Cells along one side of the square window that moves with the robot.
        side_cells: usize = 1000, in 16..=4096, unit "cells", source "paper";
        /// The window moves when the robot is further than this from its middle, and only as far as needed. A small window
        /// moves earlier, so that the longest range always lies inside.
        recenter_cells: usize = 300, in 0..=2048, unit "cells",
            source "keeps 24 m behind the robot in a window of 1000 cells of 3 cm";
        /// Log-odds that are added to a cell where an obstacle was observed.
        occupied_increment: f32 = 2.0, in 0.001..=1000.0, unit "log-odds", source "paper's code";
        /// Log-odds that are taken from a cell that was observed to be free.
        free_decrement: f32 = 1.5, in 0.001..=1000.0, unit "log-odds", source "paper's code";
        /// Factor on all log-odds at each update: old evidence counts less.
        decay: f32 = 0.98, in 0.5..=1.0, source "paper's code";
        /// Log-odds stay between minus this and plus this.
        limit: f32 = 1000.0, in 1.0..=1000000.0, unit "log-odds", source "paper's code";
        /// Points lower than this above the floor are no obstacles: the robot can drive over them.
        band_min_m: f32 = 0.06, in 0.0..=2.0, unit "m";
        /// Points higher than this above the floor are no obstacles: the robot can drive under them.
        band_max_m: f32 = 1.4, in 0.0..=2.5, unit "m", source "paper's code";
        /// The camera marks obstacles up to this distance in the plane.
        mark_range_m: f32 = 2.0, in 0.1..=20.0, unit "m", source "paper's code";
        /// The camera clears cells up to this distance in the plane.
        clear_range_m: f32 = 2.0, in 0.1..=20.0, unit "m", source "paper's code";
        /// The camera marks a drop, such as stairs down, where a ray meets the floor's plane up to this distance and continues
        /// below it; 0 marks none. Errors of coarse depth make false drops, too. The default camera sees the floor from 1.25 m on.
        drop_range_m: f32 = 2.0, in 0.0..=20.0, unit "m", source "the range of other obstacles";
        /// Points that are less than this below the floor, and 8 mm more for every metre of distance, are no drop.
        drop_min_m: f32 = 0.04, in 0.01..=1.0, unit "m", source "thresholds and carpets; a stair is 0.14 m or more";
        /// Probability with which a point must be below the floor by the confidence of its depth.
        drop_certainty: f32 = 0.99, in 0.0..=0.9999,
            source "20 homes with stairs: no fall; with 0.999 two falls in four of them";
        /// Clearing stops this fraction of the distance before an obstacle, because depth is noisy, and more so far away.
        clear_margin: f32 = 0.05, in 0.0..=0.9;
        /// Depth with a lower probability of being correct stays out of the map. At 0.75 or less, walls and floor that are only
        /// assumed enter it.
        min_confidence: f32 = 0.8, in 0.0..=1.0;
        /// After the camera was turned by more than this during the run, the map takes no more depth from it, and the robot goes
        /// on with scans, unless the report is withdrawn; 180: it always takes depth. See docs/calibration.md.
        camera_trust_deg: f64 = 1.5, in 0.0..=180.0, unit "deg",
            source "at 1.7 degrees the floor at `mark_range_m` seems as high as `band_min_m`, and is an obstacle";
        /// Probability with which a point must be above the floor, by the confidence of its depth, to be an obstacle.
        obstacle_certainty: f32 = 0.99, in 0.0..=0.999,
            source "with the camera 16 degrees down, floor whose depth is too small was an obstacle";
        /// Every n-th column of the depth image is used.
        stride_u: usize = 4, in 1..=64, unit "columns";
        /// Every n-th row of the depth image is used.
        stride_v: usize = 2, in 1..=64, unit "rows";
        /// Pixels that must agree on a cell to mark it, and on a bearing to clear it.
        min_points: u16 = 3, in 1..=1000, unit "pixels";
        /// Fraction of the points of a bearing that may be wrong when the map decides how far the bearing is free.
        outlier_share: f32 = 0.05, in 0.0..=0.49;
        /// Weight of an observation that passes above the known obstacle of a cell. Near the robot the camera's lowest ray is
        /// high above the floor, and a low obstacle that leaves the image is still there. 1 weighs it like any other
        /// observation (paper's code), 0 never clears such a cell.
        over_the_top_weight: f32 = 0.1, in 0.0..=1.0;
        /// What the map takes from the safety LiDAR: nothing, obstacles, or obstacles and the free space before them.
        lidar: LidarUse = LidarUse::default();
        /// LiDAR hits further away are not used.
        lidar_range_m: f32 = 2.0, in 0.1..=30.0, unit "m";
        /// Cells that are further than this behind a surface which the LiDAR measures on a width of 0.2 m take nothing from the
        /// camera but low obstacles, which leave the image when the robot comes near, and these only if the map holds nothing at
        /// the surface that would hide them. 20: they take everything. Without effect if `lidar` is "off".
        behind_hit_m: f32 = 0.1, in 0.05..=20.0, unit "m", source "noise of ranges and poses, and one cell";
        /// Probability with which a camera obstacle must be nearer or further than a surface that the LiDAR measures, by the
        /// confidence of its depth. With less it is marked at the surface; 0: always where the camera shows it. Without effect if
        /// `lidar` is "off".
        apart_certainty: f32 = 0.5, in 0.0..=0.999,
            source "rooms with plain walls: 11 % of the cells off by 10 cm with 0, 7 % with 0.5 and with 0.7";
        /// Width of the obstacle that a collision puts into the map.
        collision_width_m: f64 = 0.2, in 0.0..=2.0, unit "m", source "paper's code";
        /// Log-odds of a collision. They neither decay nor are cleared until the collision expires.
        collision_log_odds: f32 = 1000.0, in 0.001..=1000000.0, unit "log-odds", source "paper's code";
        /// Updates after which a collision is forgotten, because the obstacle may have been moved.
        collision_updates: u64 = 2000, in 1..=1000000000, unit "updates";
        /// Updates after which the planner tries a place again before which the robot stood because the scanner did not see it.
        unseen_updates: u64 = 300, in 1..=1000000000, unit "updates", source "half a minute: time to go round";
    }
}

impl From<OutOfRange> for MapError {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        Self::Config { field: key, value, allowed }
    }
}

impl MapConfig {
    /// Checks every value, and the values together.
    ///
    /// # Errors
    /// [`MapError::Config`] names the first value that is not allowed.
    pub fn validate(&self) -> Result<(), MapError> {
        self.check_ranges()?;
        if self.band_max_m <= self.band_min_m {
            return Err(MapError::Config {
                field: "band_max_m",
                value: f64::from(self.band_max_m),
                allowed: "above band_min_m",
            });
        }
        if self.cells_beyond_reach() < 0.0 {
            return Err(MapError::Config {
                field: "side_cells",
                value: self.side_cells as f64,
                allowed: REACH,
            });
        }
        Ok(())
    }

    /// How far the robot may be from the window's middle, in cells, so that the longest range ahead lies inside.
    pub(super) fn follow_cells(&self) -> i32 {
        (self.cells_beyond_reach() as i32)
            .min(i32::try_from(self.recenter_cells).unwrap_or(i32::MAX))
    }

    /// Cells between the end of the longest range, which starts in the window's middle, and the window's edge.
    fn cells_beyond_reach(&self) -> f64 {
        let reach_m = self.mark_range_m.max(self.clear_range_m).max(self.lidar_range_m);
        self.side_cells as f64 / 2.0 - f64::from(reach_m) / self.cell_m - 2.0
    }
}

const REACH: &str =
    "at least twice (range / cell_m + 2), so that the longest range fits into the window";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed() {
        assert_eq!(MapConfig::default().validate(), Ok(()));
    }

    #[test]
    fn a_nan_is_refused_by_name() {
        let config = MapConfig { decay: f32::NAN, ..MapConfig::default() };
        assert!(matches!(config.validate(), Err(MapError::Config { field: "decay", .. })));
    }

    #[test]
    fn a_window_too_small_for_the_range_is_refused() {
        // 2 m are 67 cells of 3 cm.
        let config = MapConfig { side_cells: 136, ..MapConfig::default() };
        assert!(matches!(config.validate(), Err(MapError::Config { field: "side_cells", .. })));
    }

    #[test]
    fn the_window_follows_the_robot_so_that_the_longest_range_stays_inside() {
        assert_eq!(MapConfig::default().follow_cells(), 300);
        let small = MapConfig { side_cells: 200, ..MapConfig::default() };
        assert_eq!(small.validate(), Ok(()));
        assert_eq!(small.follow_cells(), 31);
        assert_eq!(MapConfig { recenter_cells: 20, ..small }.follow_cells(), 20);
    }
}
