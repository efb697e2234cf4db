//! The costmap: where the robot's centre may be, and what driving there costs.

use super::config::{ConfigError, PlanConfig};
use super::distance::{Distances, FAR};
use super::keep_out::KeepOut;
use crate::mapping::{Cell, CellBox, OccupancyGrid};
use crate::snapshot::remembers;
use crate::task::AreaChange;

/// Weight of a free cell far from obstacles. Weights are integers in quarters of this cost.
pub(super) const FREE: u8 = 4;
/// The largest weight: 15 times the cost of free floor.
pub(super) const HEAVIEST: u8 = 60;
/// Weight of a cell that is never entered.
pub(super) const BLOCKED: u8 = 0;
/// Flags in the weight of a cell on level ground along its row (first) or column (second): in each
/// of the three rows (columns) of the 3x3 cells around it all weights are equal, and none is larger
/// than that of the cell. A path that drives straight along the row (column) has no reason to leave
/// it there. Both flags are set where all 9 weights are equal.
pub(super) const LEVEL: [u8; 2] = [0x80, 0x40];
/// Drops are stairs where they fill a square of cells that reaches this far on each side of the middle one. Single cells and thin rows
/// of drops are mostly errors of the depth, and a margin around them would close passages.
const STAIRS_CELLS: usize = 2;
/// The bits of the weight without the flags.
pub(super) const WEIGHT: u8 = 0x3f;

/// The cost weight of every cell in and around the known part of the map: 1 on free floor, more
/// near obstacles and on unknown floor, and [not passable](Self::is_passable) within the
/// footprint's radius of an obstacle.
#[derive(Debug, Clone)]
pub struct Costmap {
    config: PlanConfig,
    keep_out: KeepOut,
    pub(super) cell_m: f64,
    pub(super) cells: CellBox,
    /// Columns in memory: the box and one blocked cell on either side, so that searches need no
    /// bounds checks.
    pub(super) stride: usize,
    pub(super) weights: Vec<u8>,
    levels: Vec<u8>,
    /// Squared distance to the nearest obstacle, in cells.
    clearance2: Vec<u16>,
    distances: Distances,
    drop_distances: Distances,
    /// Buffers for one row: values of the map, and squared distances to drops.
    row_values: Vec<f32>,
    row_drops: Vec<u16>,
    all_drops: Vec<bool>,
    /// Weights of a free and of an unknown cell, indexed by the squared distance to the nearest
    /// obstacle.
    tables: [Vec<u8>; 2],
    /// The squared distance to an obstacle that a squared distance to a drop counts as, in cells.
    drop_table: Vec<u16>,
}

impl Costmap {
    /// A costmap without passable cells.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(config: &PlanConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        let mut costmap = Self {
            config: config.clone(),
            keep_out: KeepOut::new(config.keep_out_m.clone(), config.keep_in_m.clone()),
            cell_m: 1.0,
            cells: CellBox::of(Cell::default()),
            stride: 3,
            weights: Vec::new(),
            levels: Vec::new(),
            clearance2: Vec::new(),
            distances: Distances::default(),
            drop_distances: Distances::default(),
            row_values: Vec::new(),
            row_drops: Vec::new(),
            all_drops: Vec::new(),
            tables: [Vec::new(), Vec::new()],
            drop_table: Vec::new(),
        };
        costmap.reset(CellBox::of(Cell::default()), 1.0);
        Ok(costmap)
    }

    /// A costmap with given weights from 1.0 (free floor) to 15; `None` is never entered. For tests
    /// and other planners.
    #[must_use]
    pub fn from_weights(
        cells: CellBox,
        cell_m: f64,
        mut weight: impl FnMut(Cell) -> Option<f64>,
    ) -> Self {
        let mut costmap = Self {
            config: PlanConfig::default(),
            keep_out: KeepOut::default(),
            cell_m,
            cells,
            stride: 0,
            weights: Vec::new(),
            levels: Vec::new(),
            clearance2: Vec::new(),
            distances: Distances::default(),
            drop_distances: Distances::default(),
            row_values: Vec::new(),
            row_drops: Vec::new(),
            all_drops: Vec::new(),
            tables: [Vec::new(), Vec::new()],
            drop_table: Vec::new(),
        };
        costmap.reset(cells, cell_m);
        for y in cells.min.y..=cells.max.y {
            for x in cells.min.x..=cells.max.x {
                let cell = Cell::new(x, y);
                if let Some(index) = costmap.index(cell) {
                    costmap.weights[index] = weight(cell).map_or(BLOCKED, quantised);
                    costmap.clearance2[index] =
                        if costmap.weights[index] == BLOCKED { 0 } else { FAR };
                }
            }
        }
        costmap.mark_level();
        costmap
    }

    fn reset(&mut self, cells: CellBox, cell_m: f64) {
        self.cells = cells;
        self.cell_m = cell_m;
        self.stride = cells.width() + 2;
        let size = self.stride * (cells.height() + 2);
        self.weights.clear();
        self.weights.resize(size, BLOCKED);
        self.clearance2.clear();
        self.clearance2.resize(size, 0);
    }

    /// Recomputes all weights from the map.
    pub fn update(&mut self, grid: &OccupancyGrid) {
        self.update_with_doubt(grid, 0.0);
    }

    /// Recomputes all weights; occupied cells with at most `doubtful_log_odds` count as unknown.
    pub fn update_with_doubt(&mut self, grid: &OccupancyGrid, doubtful_log_odds: f32) {
        let doubtful = grid.row_value(doubtful_log_odds);
        let padding = (self.config.padding_m / grid.cell_m()).ceil() as i32;
        let known =
            grid.known_box().and_then(|known| known.grown(padding).intersection(grid.window()));
        let cells = known.unwrap_or(CellBox::of(grid.window().min));
        self.reset(cells, grid.cell_m());
        let reach = self.make_tables();
        let width = cells.width();
        let height = cells.height();
        self.distances.reset(width, height);
        let mut values = core::mem::take(&mut self.row_values);
        for row in 0..height {
            self.read_row(grid, cells, row, doubtful, &mut values);
            self.distances.set_row(row, values.iter().map(|value| *value > doubtful), reach);
        }
        let has_stairs = self.find_stairs(grid, cells);
        let mut near_drops = core::mem::take(&mut self.row_drops);
        near_drops.resize(width, FAR);
        for row in 0..height {
            self.read_row(grid, cells, row, doubtful, &mut values);
            let start = (row + 1) * self.stride + 1;
            let clearance2 = &mut self.clearance2[start..start + width];
            self.distances.row(row, reach, clearance2);
            if has_stairs {
                self.drop_distances.row(row, reach_of(&self.drop_table), &mut near_drops);
                for (clearance2, drop2) in clearance2.iter_mut().zip(&near_drops) {
                    let counts = self.drop_table.get(usize::from(*drop2)).unwrap_or(&FAR);
                    *clearance2 = (*clearance2).min(*counts);
                }
            }
            let weights = &mut self.weights[start..start + width];
            for ((weight, clearance2), value) in weights.iter_mut().zip(clearance2).zip(&values) {
                let is_unknown = *value == 0.0 || (*value > 0.0 && *value <= doubtful);
                let table = &self.tables[usize::from(is_unknown)];
                // The last entry is for everything beyond the reach.
                *weight = table[usize::from(*clearance2).min(table.len() - 1)];
            }
        }
        self.row_drops = near_drops;
        self.row_values = values;
        self.mark_level();
    }

    /// Looks for stairs in the map: cells around which all cells up to [`STAIRS_CELLS`] away hold drops. Returns whether there are any.
    fn find_stairs(&mut self, grid: &OccupancyGrid, cells: CellBox) -> bool {
        let reach = reach_of(&self.drop_table);
        let border = core::iter::repeat_n(false, STAIRS_CELLS);
        let mut all_drops = core::mem::take(&mut self.all_drops);
        let mut has_stairs = false;
        for (row, y) in (cells.min.y..=cells.max.y).enumerate() {
            if !columns_of_drops(grid, cells, y, &mut all_drops) {
                continue;
            }
            if !has_stairs {
                self.drop_distances.reset(cells.width(), cells.height());
                has_stairs = true;
            }
            let around = all_drops.windows(2 * STAIRS_CELLS + 1);
            let inner = around.map(|around| !around.contains(&false));
            let stairs = border.clone().chain(inner).chain(border.clone());
            self.drop_distances.set_row(row, stairs, reach);
        }
        self.all_drops = all_drops;
        has_stairs
    }

    /// Reads one row of `cells` from the map into `values`. Closed cells, and drops where obstacles count as doubtful, are
    /// occupied beyond doubt.
    fn read_row(
        &self,
        grid: &OccupancyGrid,
        cells: CellBox,
        row: usize,
        doubtful: f32,
        values: &mut Vec<f32>,
    ) {
        let y = cells.min.y + row as i32;
        let (left, right) = grid.row(y, cells.min.x, cells.width());
        values.clear();
        values.extend_from_slice(left);
        values.extend_from_slice(right);
        if doubtful > 0.0
            && let Some(drops) = grid.drops_in_row(y, cells.min.x, cells.width())
        {
            for (value, _) in values.iter_mut().zip(drops).filter(|(_, is_drop)| *is_drop) {
                *value = f32::INFINITY;
            }
        }
        self.keep_out.write_row(cells, y, grid.cell_m(), f32::INFINITY, values);
    }

    /// The areas that a person has closed, and those that the robot must not leave.
    #[must_use]
    pub fn keep_out(&self) -> &KeepOut {
        &self.keep_out
    }

    /// Closes or opens areas from the next update on.
    pub fn change_areas(&mut self, change: AreaChange) {
        self.keep_out.change(change);
    }

    /// Sets the [`LEVEL`] flags, which let searches skip cells.
    fn mark_level(&mut self) {
        let stride = self.stride;
        let weights = &self.weights;
        self.levels.clear();
        self.levels.resize(weights.len(), 0);
        for start in (stride..weights.len().saturating_sub(stride)).step_by(stride) {
            let inner = start + 1..start + stride - 1;
            let out = &mut self.levels[inner.clone()];
            let row = |from: usize| &weights[from..from + inner.len()];
            let here = row(inner.start);
            for (out, here) in out.iter_mut().zip(here) {
                *out = if *here == BLOCKED { 0 } else { LEVEL[0] | LEVEL[1] };
            }
            // Compares one pair of neighbours for all cells of the row at a time, so that the
            // compiler can vectorise it.
            for (level, along, aside) in [(LEVEL[0], 1, stride), (LEVEL[1], stride, 1)] {
                for middle in [inner.start - aside, inner.start, inner.start + aside] {
                    let pairs = row(middle - along).iter().zip(row(middle + along));
                    for (((out, here), middle), (one, other)) in
                        out.iter_mut().zip(here).zip(row(middle)).zip(pairs)
                    {
                        let same = (one == middle) & (other == middle) & (middle <= here);
                        *out &= if same { 0xff } else { !level };
                    }
                }
            }
        }
        for (weight, level) in self.weights.iter_mut().zip(&self.levels) {
            *weight |= level;
        }
    }

    /// Fills the weight tables; returns the distance up to which obstacles change weights, in
    /// cells.
    fn make_tables(&mut self) -> u16 {
        let config = &self.config;
        let hard_m = config.footprint_radius_m + config.margin_m;
        let soft_m = config.inflation_radius_m.max(hard_m);
        let reach = (soft_m / self.cell_m).ceil().min(100.0) as u16;
        for (table, base) in self.tables.iter_mut().zip([1.0, config.unknown_cost]) {
            table.clear();
            for distance2 in 0..=u32::from(reach) * u32::from(reach) {
                let distance_m = f64::from(distance2).sqrt() * self.cell_m;
                // An occupied cell is blocked even for a robot without extent.
                let blocked = distance2 == 0 || distance_m <= hard_m;
                let nearness =
                    ((soft_m - distance_m) / (soft_m - hard_m).max(1e-9)).clamp(0.0, 1.0);
                let weight = quantised(base + config.inflation_cost * nearness * nearness);
                table.push(if blocked { BLOCKED } else { weight });
            }
            table.push(quantised(base));
        }
        self.make_drop_table(hard_m, soft_m);
        reach
    }

    /// A drop counts as nearer than it is by `drop_margin_m`. Within the distance that is blocked the scale is smaller instead, so
    /// that a robot which stands there finds the direction away from the drop, and never one over it.
    fn make_drop_table(&mut self, hard_m: f64, soft_m: f64) {
        // Distances are those to the middle of a square of drops.
        let margin_m = self.config.drop_margin_m + STAIRS_CELLS as f64 * self.cell_m;
        let reach = ((soft_m + margin_m) / self.cell_m).ceil().min(200.0) as u32;
        let scale = hard_m / (hard_m + margin_m).max(1e-9);
        self.drop_table.clear();
        self.drop_table.extend((0..=reach * reach).map(|distance2| {
            let distance_m = f64::from(distance2).sqrt() * self.cell_m;
            let counts_m = (distance_m - margin_m).max(distance_m.min(hard_m + margin_m) * scale);
            let counts2 = (counts_m / self.cell_m).powi(2) as u16;
            // Beside a drop is not in it.
            let least = u16::from(distance2 > 0 && hard_m >= self.cell_m);
            counts2.max(least)
        }));
    }

    #[inline]
    pub(super) fn index(&self, cell: Cell) -> Option<usize> {
        self.cells.contains(cell).then(|| {
            let x = (cell.x - self.cells.min.x) as usize;
            let y = (cell.y - self.cells.min.y) as usize;
            (y + 1) * self.stride + x + 1
        })
    }

    #[inline]
    pub(super) fn cell(&self, index: usize) -> Cell {
        let x = (index % self.stride) as i32 - 1;
        let y = (index / self.stride) as i32 - 1;
        self.cells.min.offset(x, y)
    }

    /// The cells that this costmap covers. Cells outside are never entered.
    #[must_use]
    pub fn cells(&self) -> CellBox {
        self.cells
    }

    /// Edge length of a cell, metres.
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Cost of one metre in this cell, in metres of free floor; `None` where the robot must not
    /// drive.
    #[must_use]
    pub fn weight(&self, cell: Cell) -> Option<f64> {
        let weight =
            self.index(cell).and_then(|index| self.weights.get(index).copied()).unwrap_or(BLOCKED)
                & WEIGHT;
        (weight != BLOCKED).then(|| f64::from(weight) / f64::from(FREE))
    }

    /// Whether the robot's centre may be in this cell.
    #[must_use]
    pub fn is_passable(&self, cell: Cell) -> bool {
        self.weight(cell).is_some()
    }

    /// Distance to the nearest obstacle, metres; `None` if there is none within the inflation
    /// radius. Stairs count as nearer than they are, by the planner's margin from them.
    #[must_use]
    pub fn clearance_m(&self, cell: Cell) -> Option<f64> {
        let clearance2 = self.clearance2(self.index(cell)?);
        (clearance2 != FAR).then(|| f64::from(clearance2).sqrt() * self.cell_m)
    }

    pub(super) fn clearance2(&self, index: usize) -> u16 {
        self.clearance2.get(index).copied().unwrap_or(0)
    }

    /// The passable cell nearest to `cell`, at most `radius_m` away; of several equally near ones,
    /// the first in row order.
    #[must_use]
    pub fn nearest_passable(&self, cell: Cell, radius_m: f64) -> Option<Cell> {
        self.nearest(cell, radius_m, |near| self.is_passable(near))
    }

    /// The nearest cell that `is_suitable`, at most `radius_m` away from `cell`; of several equally
    /// near ones, the first in row order.
    pub(super) fn nearest(
        &self,
        cell: Cell,
        radius_m: f64,
        is_suitable: impl Fn(Cell) -> bool,
    ) -> Option<Cell> {
        let radius = radius_m / self.cell_m;
        let reach = radius.clamp(0.0, 1000.0) as i32;
        let around = CellBox::of(cell).grown(reach).intersection(self.cells)?;
        let mut best: Option<(i64, Cell)> = None;
        for y in around.min.y..=around.max.y {
            for x in around.min.x..=around.max.x {
                let near = Cell::new(x, y);
                let distance2 = near.distance2(cell);
                let nearer = best.is_none_or(|(so_far, _)| distance2 < so_far);
                if nearer && distance2 as f64 <= radius * radius && is_suitable(near) {
                    best = Some((distance2, near));
                }
            }
        }
        best.map(|(_, cell)| cell)
    }
}

/// The weight in quarters of the cost of free floor.
fn quantised(weight: f64) -> u8 {
    (weight * f64::from(FREE)).round().clamp(f64::from(FREE), f64::from(HEAVIEST)) as u8
}

// All other fields are computed again before they are used.
remembers!(Costmap: keep_out);

/// Marks the columns in which this row and those up to [`STAIRS_CELLS`] beside it hold drops. Returns whether each of the rows has some.
fn columns_of_drops(
    grid: &OccupancyGrid,
    cells: CellBox,
    y: i32,
    all_drops: &mut Vec<bool>,
) -> bool {
    all_drops.clear();
    all_drops.resize(cells.width(), true);
    let beside = STAIRS_CELLS as i32;
    for near_y in y - beside..=y + beside {
        let Some(drops) = grid.drops_in_row(near_y, cells.min.x, cells.width()) else {
            return false;
        };
        for (all, drop) in all_drops.iter_mut().zip(drops) {
            *all &= drop;
        }
    }
    true
}

/// The largest distance in a table of squared distances that begins with 0.
fn reach_of(table: &[u16]) -> u16 {
    table.len().saturating_sub(1).isqrt() as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{MapConfig, Sweep};
    use crate::planning::{NoPath, Planner};
    use hal::{LaserScan, Pose2, Range, ScanGeometry};

    /// A map of one scan: free floor within a ring of hits at 1.5 m, and unknown behind the robot.
    fn ring() -> OccupancyGrid {
        let mut grid = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let geometry = ScanGeometry::UTM_30LX;
        let scan =
            LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(1.5); geometry.beams] };
        grid.begin_update(&Pose2::IDENTITY).unwrap();
        grid.integrate_scan(&scan, &Sweep::at_rest(Pose2::IDENTITY)).unwrap();
        grid.finish_update();
        grid
    }

    fn costmap(grid: &OccupancyGrid) -> Costmap {
        // Small enough that the cost has several steps between the obstacle and free floor.
        let config = PlanConfig {
            footprint_radius_m: 0.12,
            inflation_radius_m: 0.24,
            ..PlanConfig::default()
        };
        let mut costmap = Costmap::new(&config).unwrap();
        costmap.update(grid);
        costmap
    }

    #[test]
    fn cost_rises_towards_an_obstacle_until_the_cell_is_blocked() {
        let grid = ring();
        let costmap = costmap(&grid);
        let weights: Vec<Option<f64>> = (0..=50)
            .map(|x| costmap.weight(grid.cell_at(f64::from(x) * 0.03 + 0.001, 0.001)))
            .collect();
        assert_eq!(weights[10], Some(1.0));
        // The hits lie at 1.5 m: cells are blocked from 0.14 m before them and cost more from 0.24
        // m before them.
        let blocked = weights.iter().position(Option::is_none).unwrap();
        assert!((45..=46).contains(&blocked), "{weights:?}");
        let expensive = weights.iter().position(|weight| *weight > Some(1.0)).unwrap();
        assert!((42..=43).contains(&expensive), "{weights:?}");
        assert!(
            weights[expensive..blocked].windows(2).all(|pair| pair[0] < pair[1]),
            "{weights:?}"
        );
        assert!(weights[blocked..].iter().all(Option::is_none));
    }

    #[test]
    fn unknown_floor_is_passable_at_the_configured_cost() {
        let grid = ring();
        let costmap = costmap(&grid);
        // Behind the robot is outside of the scanner's field of view.
        assert_eq!(costmap.weight(grid.cell_at(-1.0, 0.0)), Some(4.0));
        assert_eq!(costmap.weight(grid.cell_at(-4.0, 0.0)), None, "beyond the padding");
    }

    #[test]
    fn a_closed_area_is_an_obstacle_for_the_planner_and_not_for_the_map() {
        let grid = ring();
        let strip = vec![[0.6, -2.0], [0.7, -2.0], [0.7, 2.0], [0.6, 2.0]];
        let config = PlanConfig {
            footprint_radius_m: 0.12,
            keep_out_m: vec![strip],
            ..PlanConfig::default()
        };
        let mut costmap = Costmap::new(&config).unwrap();
        // However doubtful obstacles may be.
        costmap.update_with_doubt(&grid, 1000.0);
        let here = grid.cell_at(0.0, 0.0);
        let beyond = grid.cell_at(1.0, 0.0);
        assert_eq!(costmap.weight(grid.cell_at(0.65, 0.3)), None);
        assert_eq!(costmap.weight(grid.cell_at(0.5, 0.3)), None, "the robot's body stays outside");
        assert!(costmap.is_passable(here) && costmap.is_passable(beyond));
        let planned = Planner::new(1_000_000).plan(&costmap, here, beyond).map(<[Cell]>::len);
        assert_eq!(planned, Err(NoPath::Unreachable));
        assert!(grid.log_odds(grid.cell_at(0.65, 0.3)) < 0.0);
    }

    #[test]
    fn with_doubt_obstacles_seen_once_count_as_unknown_and_those_seen_often_stay_blocked() {
        let mut grid = ring();
        let wall = grid.cell_at(1.501, 0.001);
        let mut costmap = costmap(&grid);
        costmap.update_with_doubt(&grid, 5.0);
        assert_eq!(costmap.weight(wall), Some(4.0));
        costmap.update_with_doubt(&grid, 0.5);
        assert_eq!(costmap.weight(wall), None);
        let geometry = ScanGeometry::UTM_30LX;
        let scan =
            LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(1.5); geometry.beams] };
        for _ in 0..10 {
            grid.begin_update(&Pose2::IDENTITY).unwrap();
            grid.integrate_scan(&scan, &Sweep::at_rest(Pose2::IDENTITY)).unwrap();
            grid.finish_update();
        }
        costmap.update_with_doubt(&grid, 5.0);
        assert_eq!(costmap.weight(wall), None);
    }

    #[test]
    fn a_robot_too_close_to_an_obstacle_drives_away_from_it_first() {
        let grid = ring();
        let costmap = costmap(&grid);
        let start = grid.cell_at(1.41, 0.0);
        assert!(!costmap.is_passable(start));
        let mut planner = Planner::new(1_000_000);
        let path = planner.plan(&costmap, start, grid.cell_at(0.0, 0.9)).unwrap();
        assert_eq!(path[0], start);
        let clearances: Vec<f64> =
            path.iter().map_while(|cell| costmap.clearance_m(*cell)).collect();
        let inside = path.iter().take_while(|cell| !costmap.is_passable(**cell)).count();
        assert!((1..=4).contains(&inside), "{inside} cells to leave");
        assert!(clearances[..=inside].windows(2).all(|pair| pair[0] <= pair[1]), "{clearances:?}");
        let steps = path.windows(2).map(|pair| pair[0].distance2(pair[1]));
        assert!(steps.into_iter().all(|step| step == 1 || step == 2), "the path is connected");
    }

    #[test]
    fn leaving_an_obstacle_does_not_lead_through_a_wall() {
        // A path from a start close to the outside of the ring must not come out inside of it.
        let grid = ring();
        let costmap = costmap(&grid);
        let outside = grid.cell_at(1.56, 0.0);
        let mut planner = Planner::new(1_000_000);
        let path = planner.plan(&costmap, outside, grid.cell_at(1.8, 0.0)).unwrap();
        assert!(path.iter().all(|cell| cell.x >= outside.x));
        assert_eq!(
            planner.plan(&costmap, grid.cell_at(9.0, 9.0), outside),
            Err(NoPath::StartBlocked)
        );
    }

    #[test]
    fn the_nearest_passable_cell_is_found_within_the_radius() {
        let grid = ring();
        let costmap = costmap(&grid);
        let wall = grid.cell_at(1.5, 0.0);
        let near = costmap.nearest_passable(wall, 0.3).unwrap();
        assert!(costmap.is_passable(near) && near.distance2(wall) <= 26);
        assert_eq!(costmap.nearest_passable(wall, 0.1), None);
    }

    #[test]
    fn an_empty_map_has_a_costmap_without_paths() {
        let grid = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let costmap = costmap(&grid);
        let mut planner = Planner::new(100);
        assert_eq!(
            planner.plan(&costmap, Cell::new(0, 0), Cell::new(5, 5)),
            Err(NoPath::StartBlocked)
        );
    }
}
