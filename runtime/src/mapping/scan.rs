//! Integration of planar LiDAR scans into the occupancy grid.

use hal::{LaserScan, Pose2, Range};

use super::grid::check_pose2;
use super::{Cell, LidarUse, MapError, OccupancyGrid, Sweep};

impl OccupancyGrid {
    /// Integrates a scan: hits within the range limit mark their cells as occupied, and the cells
    /// before a hit become free.
    ///
    /// A planar scan observes one height only. So it clears cells that only the LiDAR marked, and
    /// never those that the camera saw. "No return", "too near" and error beams carry no evidence.
    ///
    /// # Errors
    /// If the pose is not finite or out of reach, or the number of ranges differs from the number
    /// of beams.
    pub fn integrate_scan(&mut self, scan: &LaserScan, sweep: &Sweep) -> Result<(), MapError> {
        check_pose2("t_map_laser", &sweep.t_map_laser)?;
        let beams = scan.geometry.beams;
        if scan.ranges.len() != beams {
            return Err(MapError::ScanShape { ranges: scan.ranges.len(), beams });
        }
        if self.config.lidar == LidarUse::Off {
            return Ok(());
        }
        self.mark_hits(scan, sweep);
        if self.config.lidar == LidarUse::HitsAndFree {
            self.clear_to_hits(scan, sweep);
        }
        Ok(())
    }

    fn mark_hits(&mut self, scan: &LaserScan, sweep: &Sweep) {
        for (beam, range) in scan.ranges.iter().enumerate() {
            let Some(range_m) = range.hit_m() else { continue };
            if range_m > 0.0 && range_m <= self.config.lidar_range_m {
                let t_map_laser = sweep.at(scan.geometry.after_middle_s(beam));
                let angle_rad = scan.geometry.angle_rad(beam);
                let [x_m, y_m] = end_of(&t_map_laser, angle_rad, f64::from(range_m));
                let cell = self.cell_at(x_m, y_m);
                if let Some(index) = self.index(cell) {
                    self.add_evidence(cell, index, self.config.occupied_increment);
                }
            }
        }
    }

    /// Clears one line of cells for every group of neighbouring beams that are closer together than
    /// cells are. A line ends before the shortest range of its group, and is left out if one of the
    /// beams is not a hit.
    fn clear_to_hits(&mut self, scan: &LaserScan, sweep: &Sweep) {
        let limit_m = self.config.lidar_range_m;
        let cell_m = self.config.cell_m;
        let spacing_m = f64::from(limit_m) * scan.geometry.angle_increment_rad.abs();
        let group = ((0.7 * cell_m / spacing_m) as usize).clamp(1, scan.ranges.len().max(1));
        for (first, beams) in (0..).step_by(group).zip(scan.ranges.chunks(group)) {
            let shortest = beams.iter().map(|range| reach_m(*range)).fold(f32::INFINITY, f32::min);
            let reach_m = f64::from(shortest.min(limit_m)) - cell_m;
            if reach_m > 0.0 {
                let angle_rad = scan.geometry.angle_rad(first)
                    + scan.geometry.angle_increment_rad * (beams.len() - 1) as f64 / 2.0;
                let middle = first + (beams.len() - 1) / 2;
                let t_map_laser = sweep.at(scan.geometry.after_middle_s(middle));
                let end_m = end_of(&t_map_laser, angle_rad, reach_m);
                self.clear_line([t_map_laser.x_m, t_map_laser.y_m], end_m);
            }
        }
    }

    fn clear_line(&mut self, start_m: [f64; 2], end_m: [f64; 2]) {
        let free = -self.config.free_decrement;
        for cell in cells_on_line(start_m, end_m, self.config.cell_m) {
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

/// The cells that a line segment touches, from start to end (Amanatides and Woo 1987).
pub(crate) fn cells_on_line(
    start_m: [f64; 2],
    end_m: [f64; 2],
    cell_m: f64,
) -> impl Iterator<Item = Cell> {
    let mut cell = Cell::containing(start_m[0], start_m[1], cell_m);
    let end = Cell::containing(end_m[0], end_m[1], cell_m);
    let mut along_x = Crossings::new(start_m[0], end_m[0], cell.x, cell_m);
    let mut along_y = Crossings::new(start_m[1], end_m[1], cell.y, cell_m);
    // The crossings of each axis are counted, so that the line ends in the right cell in spite of
    // rounding.
    let mut left_x = (end.x - cell.x).unsigned_abs();
    let mut left_y = (end.y - cell.y).unsigned_abs();
    (0..=left_x + left_y).map(move |_| {
        let here = cell;
        if left_x > 0 && (left_y == 0 || along_x.next < along_y.next) {
            left_x -= 1;
            cell.x += along_x.step;
            along_x.next += along_x.spacing;
        } else if left_y > 0 {
            left_y -= 1;
            cell.y += along_y.step;
            along_y.next += along_y.spacing;
        }
        here
    })
}

/// The crossings of a line segment with the cell edges of one axis, as shares of the segment's
/// length.
struct Crossings {
    /// Direction of the segment along the axis: +1 or -1.
    step: i32,
    /// Where the segment crosses the next edge.
    next: f64,
    /// Distance between two crossings.
    spacing: f64,
}

impl Crossings {
    fn new(start_m: f64, end_m: f64, start_cell: i32, cell_m: f64) -> Self {
        let delta_m = end_m - start_m;
        let step = if delta_m > 0.0 { 1 } else { -1 };
        let edge_m = f64::from(start_cell + i32::from(delta_m > 0.0)) * cell_m;
        if delta_m == 0.0 {
            Self { step, next: f64::INFINITY, spacing: f64::INFINITY }
        } else {
            Self { step, next: (edge_m - start_m) / delta_m, spacing: cell_m / delta_m.abs() }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{CellState, MapConfig};
    use hal::ScanGeometry;
    use proptest::prelude::*;

    fn grid(lidar: LidarUse) -> OccupancyGrid {
        let config =
            MapConfig { side_cells: 200, recenter_cells: 20, lidar, ..MapConfig::default() };
        OccupancyGrid::new(&config).unwrap()
    }

    fn scan(range: impl Fn(usize) -> Range) -> LaserScan {
        let geometry = ScanGeometry::UTM_30LX;
        LaserScan { time_ns: 0, geometry, ranges: (0..geometry.beams).map(range).collect() }
    }

    fn update(grid: &mut OccupancyGrid, scan: &LaserScan, laser: &Pose2) {
        grid.begin_update(laser).unwrap();
        grid.integrate_scan(scan, &Sweep::at_rest(*laser)).unwrap();
        grid.finish_update();
    }

    #[test]
    fn a_ring_of_hits_is_occupied_and_free_inside() {
        let mut grid = grid(LidarUse::HitsAndFree);
        let laser = Pose2::new(0.4, -0.3, 1.0);
        update(&mut grid, &scan(|_| Range::Hit(1.2)), &laser);
        for beam in (0..1081).step_by(7) {
            let angle = ScanGeometry::UTM_30LX.angle_rad(beam);
            for (range_m, state) in [
                (0.5, CellState::Free),
                (1.1, CellState::Free),
                (1.2, CellState::Occupied),
                (1.3, CellState::Unknown),
            ] {
                let [x, y] = end_of(&laser, angle, range_m);
                assert_eq!(grid.state_at(x, y), state, "beam {beam} at {range_m} m");
            }
        }
        let behind = end_of(&laser, core::f64::consts::PI, 0.5);
        assert_eq!(
            grid.state_at(behind[0], behind[1]),
            CellState::Unknown,
            "behind is outside of the scanner's field of view"
        );
    }

    #[test]
    fn the_states_of_all_cells_at_once_are_those_of_each_cell() {
        let mut grid = grid(LidarUse::HitsAndFree);
        // The window has moved, so that its rows wrap around.
        for x_m in [0.0, 1.7, 3.1] {
            update(&mut grid, &scan(|_| Range::Hit(1.2)), &Pose2::new(x_m, -0.3, 1.0));
        }
        let known = grid.known_box().unwrap();
        let rows = known.min.y..=known.max.y;
        let cells = rows.flat_map(|y| (known.min.x..=known.max.x).map(move |x| Cell::new(x, y)));
        let one_by_one: Vec<CellState> = cells.map(|cell| grid.state(cell)).collect();
        assert_eq!(grid.known_states(), one_by_one);
        assert!(one_by_one.contains(&CellState::Occupied));
    }

    #[test]
    fn a_wall_is_straight_although_the_robot_rotates_during_the_scan() {
        let geometry = ScanGeometry::LD06;
        let twist = hal::Twist2 { linear_mps: 0.0, angular_radps: 1.0 };
        // The wall x = -1.015, in the middle of a column of cells, behind the robot.
        let ranges = (0..geometry.beams).map(|beam| {
            let bearing_rad = geometry.angle_rad(beam) + geometry.after_middle_s(beam);
            let range_m = -1.015 / bearing_rad.cos();
            if range_m > 0.0 { Range::Hit(range_m as f32) } else { Range::NoReturn }
        });
        let scan = LaserScan { time_ns: 0, geometry, ranges: ranges.collect() };
        let occupied = |sweep: &Sweep| -> Vec<i32> {
            let mut grid = grid(LidarUse::Hits);
            grid.begin_update(&Pose2::IDENTITY).unwrap();
            grid.integrate_scan(&scan, sweep).unwrap();
            grid.finish_update();
            let mut columns: Vec<i32> = grid.known_cells().map(|(cell, _)| cell.x).collect();
            columns.sort_unstable();
            columns.dedup();
            columns
        };
        let wall = Cell::containing(-1.015, 0.0, 0.03).x;
        assert_eq!(occupied(&Sweep::new(&Pose2::IDENTITY, &Pose2::IDENTITY, &twist)), [wall]);
        assert_eq!(
            occupied(&Sweep::at_rest(Pose2::IDENTITY)),
            [wall - 2, wall - 1, wall],
            "it is bent"
        );
    }

    #[test]
    fn no_return_too_near_and_errors_clear_nothing() {
        for range in [Range::NoReturn, Range::TooNear, Range::Error, Range::Hit(f32::NAN)] {
            let mut grid = grid(LidarUse::HitsAndFree);
            update(&mut grid, &scan(|_| range), &Pose2::IDENTITY);
            assert_eq!(grid.known_cells().count(), 0, "{range:?}");
        }
    }

    #[test]
    fn a_far_hit_clears_to_the_limit_and_marks_nothing() {
        let mut grid = grid(LidarUse::HitsAndFree);
        update(&mut grid, &scan(|_| Range::Hit(25.0)), &Pose2::IDENTITY);
        assert!(grid.known_cells().all(|(_, log_odds)| log_odds < 0.0));
        assert_eq!(grid.state_at(1.9, 0.0), CellState::Free);
        assert_eq!(grid.state_at(2.1, 0.0), CellState::Unknown);
    }

    #[test]
    fn the_lidar_clears_its_own_obstacles_and_not_those_of_the_camera() {
        let mut grid = grid(LidarUse::HitsAndFree);
        let by_camera = Cell::new(20, 0);
        let by_lidar = Cell::new(0, 20);
        grid.begin_update(&Pose2::IDENTITY).unwrap();
        grid.add_camera_obstacle(by_camera, 2.0, 30);
        let index = grid.index(by_lidar).unwrap();
        grid.add_evidence(by_lidar, index, 2.0);
        grid.finish_update();
        for _ in 0..10 {
            update(&mut grid, &scan(|_| Range::Hit(1.5)), &Pose2::IDENTITY);
        }
        assert_eq!(grid.state(by_camera), CellState::Occupied);
        assert_eq!(grid.state(by_lidar), CellState::Free);
    }

    #[test]
    fn the_use_of_the_lidar_can_be_chosen() {
        let hits = scan(|_| Range::Hit(1.0));
        let mut off = grid(LidarUse::Off);
        update(&mut off, &hits, &Pose2::IDENTITY);
        assert_eq!(off.known_cells().count(), 0);
        let mut only_hits = grid(LidarUse::Hits);
        update(&mut only_hits, &hits, &Pose2::IDENTITY);
        assert!(
            only_hits.known_cells().count() > 50
                && only_hits.known_cells().all(|(_, log_odds)| log_odds > 0.0)
        );
    }

    #[test]
    fn a_scan_with_missing_beams_or_a_nan_pose_is_refused() {
        let mut grid = grid(LidarUse::HitsAndFree);
        let mut short = scan(|_| Range::Hit(1.0));
        short.ranges.pop();
        let refused = grid.integrate_scan(&short, &Sweep::at_rest(Pose2::IDENTITY));
        assert_eq!(refused, Err(MapError::ScanShape { ranges: 1080, beams: 1081 }));
        let nan = Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY };
        let hits = scan(|_| Range::Hit(1.0));
        assert!(grid.integrate_scan(&hits, &Sweep::at_rest(nan)).is_err());
    }

    proptest! {
        #[test]
        fn a_line_goes_from_cell_to_neighbouring_cell(x0 in -2.0..2.0f64, y0 in -2.0..2.0f64, x1 in -2.0..2.0f64, y1 in -2.0..2.0f64) {
            let cells: Vec<Cell> = cells_on_line([x0, y0], [x1, y1], 0.03).collect();
            prop_assert_eq!(cells[0], Cell::containing(x0, y0, 0.03));
            prop_assert_eq!(cells[cells.len() - 1], Cell::containing(x1, y1, 0.03));
            let length = (x1 - x0).hypot(y1 - y0);
            for pair in cells.windows(2) {
                prop_assert_eq!(pair[0].distance2(pair[1]), 1);
            }
            for cell in &cells {
                let [cx, cy] = cell.center_m(0.03);
                let off = ((x1 - x0) * (cy - y0) - (y1 - y0) * (cx - x0)).abs() / length.max(1e-9);
                prop_assert!(length < 1e-6 || off <= 0.03 * 0.7072, "{:?} is {} m beside the line", cell, off);
            }
        }
    }
}
