//! How the map believes what it is told.

use serde::{Deserialize, Serialize};

use super::MapError;

/// What the map takes from the planar LiDAR.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidarUse {
    /// Nothing.
    Off,
    /// Hits mark cells occupied.
    Hits,
    /// Hits mark cells occupied, and the way to a hit is free where the map knew nothing.
    #[default]
    HitsAndFree,
}

/// Size of the map and weight of the evidence. Log-odds values and ranges are those of the released code of "Embodied Depth
/// Prediction"; the rest is ours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapConfig {
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// Cells along one side of the square window.
    pub side_cells: usize,
    /// The window moves when the robot is further than this from its middle, and only as far, cells. Earlier where the window is so
    /// small that a range would reach out of it.
    pub recenter_cells: usize,
    /// Log-odds added where something was seen.
    pub occupied_increment: f32,
    /// Log-odds taken where nothing was seen.
    pub free_decrement: f32,
    /// Factor on every log-odds at each update: old evidence counts less.
    pub decay: f32,
    /// Log-odds stay within plus and minus this.
    pub limit: f32,
    /// Points from here up can be run into, metres above the floor.
    pub band_min_m: f32,
    /// Points up to here can be run into, metres above the floor.
    pub band_max_m: f32,
    /// Camera points nearer than this mark cells occupied, metres in the plane.
    pub mark_range_m: f32,
    /// The camera's view clears cells nearer than this, metres in the plane.
    pub clear_range_m: f32,
    /// Clearing stops this share of the distance in front of an obstacle: depth is noisy, and more so far away.
    pub clear_margin: f32,
    /// Depth that is less probably right stays out of the map.
    pub min_confidence: f32,
    /// Every so many columns of the depth picture are used.
    pub stride_u: usize,
    /// Every so many rows of the depth picture are used.
    pub stride_v: usize,
    /// Used pixels that must agree on a cell to mark it, and on a bearing to clear it.
    pub min_points: u16,
    /// Share of a bearing's points that may be wrong when it comes to how far it is free.
    pub outlier_share: f32,
    /// Weight of a look that passes above the obstacle a cell is known for. The camera's lowest ray is high above the floor
    /// near the robot; a low obstacle that leaves the view is still there. 1: as the paper's code; 0: never clears.
    pub over_the_top_weight: f32,
    /// What to take from the LiDAR.
    pub lidar: LidarUse,
    /// LiDAR hits beyond this are not used, metres.
    pub lidar_range_m: f32,
    /// Width of the obstacle that a collision puts into the map, metres.
    pub collision_width_m: f64,
    /// Log-odds of a collision; neither decays nor is cleared until it expires.
    pub collision_log_odds: f32,
    /// Updates until a collision is forgotten: what was run into may have been moved.
    pub collision_updates: u64,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.03,
            side_cells: 1000,
            recenter_cells: 300,
            occupied_increment: 2.0,
            free_decrement: 1.5,
            decay: 0.98,
            limit: 1000.0,
            band_min_m: 0.06,
            band_max_m: 1.4,
            mark_range_m: 2.0,
            clear_range_m: 2.0,
            clear_margin: 0.05,
            min_confidence: 0.8,
            stride_u: 4,
            stride_v: 2,
            min_points: 3,
            outlier_share: 0.05,
            over_the_top_weight: 0.1,
            lidar: LidarUse::default(),
            lidar_range_m: 2.0,
            collision_width_m: 0.2,
            collision_log_odds: 1000.0,
            collision_updates: 2000,
        }
    }
}

impl MapConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`MapError::Config`] names the first value that is out of range.
    pub fn validate(&self) -> Result<(), MapError> {
        let check = |ok: bool, field, value: f64, allowed| {
            if ok { Ok(()) } else { Err(MapError::Config { field, value, allowed }) }
        };
        let within = |field, value: f64, low: f64, high: f64, allowed| {
            // A NaN is in no range.
            check((low..=high).contains(&value), field, value, allowed)
        };
        let f = f64::from;
        within("cell_m", self.cell_m, 0.005, 1.0, "0.005 to 1")?;
        within("side_cells", self.side_cells as f64, 16.0, 4096.0, "16 to 4096")?;
        within("occupied_increment", f(self.occupied_increment), 1e-3, 1e3, "0.001 to 1000")?;
        within("free_decrement", f(self.free_decrement), 1e-3, 1e3, "0.001 to 1000")?;
        within("decay", f(self.decay), 0.5, 1.0, "0.5 to 1")?;
        within("limit", f(self.limit), 1.0, 1e6, "1 to 1000000")?;
        within("band_min_m", f(self.band_min_m), 0.0, 2.0, "0 to 2")?;
        within("band_max_m", f(self.band_max_m), 0.0, 2.5, "0 to 2.5")?;
        check(
            self.band_max_m > self.band_min_m,
            "band_max_m",
            f(self.band_max_m),
            "above band_min_m",
        )?;
        within("mark_range_m", f(self.mark_range_m), 0.1, 20.0, "0.1 to 20")?;
        within("clear_range_m", f(self.clear_range_m), 0.1, 20.0, "0.1 to 20")?;
        within("clear_margin", f(self.clear_margin), 0.0, 0.9, "0 to 0.9")?;
        within("min_confidence", f(self.min_confidence), 0.0, 1.0, "0 to 1")?;
        within("stride_u", self.stride_u as f64, 1.0, 64.0, "1 to 64")?;
        within("stride_v", self.stride_v as f64, 1.0, 64.0, "1 to 64")?;
        within("min_points", f64::from(self.min_points), 1.0, 1000.0, "1 to 1000")?;
        within("outlier_share", f(self.outlier_share), 0.0, 0.49, "0 to 0.49")?;
        within("over_the_top_weight", f(self.over_the_top_weight), 0.0, 1.0, "0 to 1")?;
        within("lidar_range_m", f(self.lidar_range_m), 0.1, 30.0, "0.1 to 30")?;
        within("collision_width_m", self.collision_width_m, 0.0, 2.0, "0 to 2")?;
        within("collision_log_odds", f(self.collision_log_odds), 1e-3, 1e6, "0.001 to 1000000")?;
        check(self.cells_beyond_reach() >= 0.0, "side_cells", self.side_cells as f64, REACH)
    }

    /// How far from the window's middle the robot may be, cells: the longest range in front of it is always inside.
    pub(super) fn follow_cells(&self) -> i32 {
        (self.cells_beyond_reach() as i32)
            .min(i32::try_from(self.recenter_cells).unwrap_or(i32::MAX))
    }

    /// From a range that starts in the window's middle to the window's edge.
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
    fn the_robot_stays_so_far_from_the_edge_that_the_longest_range_is_inside() {
        assert_eq!(MapConfig::default().follow_cells(), 300);
        let small = MapConfig { side_cells: 200, ..MapConfig::default() };
        assert_eq!((small.validate(), small.follow_cells()), (Ok(()), 31));
        assert_eq!(MapConfig { recenter_cells: 20, ..small }.follow_cells(), 20);
    }
}
