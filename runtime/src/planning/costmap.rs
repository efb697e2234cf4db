//! Where the robot may drive, and what it costs.

use super::config::{ConfigError, PlanConfig};
use super::distance::{Distances, FAR};
use crate::mapping::{Cell, CellBox, OccupancyGrid};

/// Weight of a free cell far from everything; weights count in quarters of it.
pub(super) const FREE: u8 = 4;
/// The largest weight.
pub(super) const HEAVIEST: u8 = 60;
/// Never entered.
pub(super) const BLOCKED: u8 = 0;
/// Set in the weight of a cell on which a robot that drives along the row or column, either way, has no reason to turn: in each
/// of the three rows (columns) of the 3x3 cells around it all weights are the same, and none is larger than that of the cell.
/// Both are set where all 9 weights are the same.
pub(super) const LEVEL: [u8; 2] = [0x80, 0x40];
/// The weight itself.
pub(super) const WEIGHT: u8 = 0x3f;

/// The weight of every cell around what is known: [`BLOCKED`](Self::is_passable) within the footprint's radius of an
/// obstacle, more than 1 near obstacles and in the unknown, 1 on free floor.
#[derive(Debug, Clone)]
pub struct Costmap {
    config: PlanConfig,
    pub(super) cell_m: f64,
    pub(super) cells: CellBox,
    /// Columns in memory: the box and a blocked cell on either side, so that searches need not look where they are.
    pub(super) stride: usize,
    pub(super) weights: Vec<u8>,
    levels: Vec<u8>,
    /// Squared distance to the nearest obstacle, cells.
    clearance2: Vec<u16>,
    distances: Distances,
    /// One row of the map.
    values: Vec<f32>,
    /// Weight of a free and of an unknown cell by squared distance to an obstacle.
    tables: [Vec<u8>; 2],
}

impl Costmap {
    /// A costmap of nothing.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(config: &PlanConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        let mut costmap = Self {
            config: config.clone(),
            cell_m: 1.0,
            cells: CellBox::of(Cell::default()),
            stride: 3,
            weights: Vec::new(),
            levels: Vec::new(),
            clearance2: Vec::new(),
            distances: Distances::default(),
            values: Vec::new(),
            tables: [Vec::new(), Vec::new()],
        };
        costmap.reset(CellBox::of(Cell::default()), 1.0);
        Ok(costmap)
    }

    /// A costmap with given weights: `None` is never entered, 1.0 is free floor, up to 15. For tests and other planners.
    #[must_use]
    pub fn from_weights(
        cells: CellBox,
        cell_m: f64,
        mut weight: impl FnMut(Cell) -> Option<f64>,
    ) -> Self {
        let mut costmap = Self {
            config: PlanConfig::default(),
            cell_m,
            cells,
            stride: 0,
            weights: Vec::new(),
            levels: Vec::new(),
            clearance2: Vec::new(),
            distances: Distances::default(),
            values: Vec::new(),
            tables: [Vec::new(), Vec::new()],
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

    /// Reads the map anew.
    pub fn update(&mut self, grid: &OccupancyGrid) {
        self.update_doubting(grid, 0.0);
    }

    /// Reads the map anew; what was marked with at most `doubt` log-odds left counts as unknown.
    pub fn update_doubting(&mut self, grid: &OccupancyGrid, doubt: f32) {
        let doubt = grid.row_value(doubt);
        let padding = (self.config.padding_m / grid.cell_m()).ceil() as i32;
        let known =
            grid.known_box().and_then(|known| known.grown(padding).intersection(grid.window()));
        let cells = known.unwrap_or(CellBox::of(grid.window().min));
        self.reset(cells, grid.cell_m());
        let reach = self.make_tables();
        let (width, height) = (cells.width(), cells.height());
        self.distances.reset(width, height);
        let mut values = core::mem::take(&mut self.values);
        let read_row = |row: usize, values: &mut Vec<f32>| {
            let (left, right) = grid.row(cells.min.y + row as i32, cells.min.x, width);
            values.clear();
            values.extend_from_slice(left);
            values.extend_from_slice(right);
        };
        for row in 0..height {
            read_row(row, &mut values);
            self.distances.set_row(row, values.iter().map(|value| *value > doubt), reach);
        }
        for row in 0..height {
            read_row(row, &mut values);
            let start = (row + 1) * self.stride + 1;
            let clearance2 = &mut self.clearance2[start..start + width];
            self.distances.row(row, reach, clearance2);
            let weights = &mut self.weights[start..start + width];
            for ((weight, clearance2), value) in weights.iter_mut().zip(clearance2).zip(&values) {
                let is_unknown = *value == 0.0 || (*value > 0.0 && *value <= doubt);
                let table = &self.tables[usize::from(is_unknown)];
                // The last entry stands for everything beyond the reach.
                *weight = table[usize::from(*clearance2).min(table.len() - 1)];
            }
        }
        self.values = values;
        self.mark_level();
    }

    /// Finds the cells on level ground, where searches have an easy time.
    fn mark_level(&mut self) {
        let (stride, weights) = (self.stride, &self.weights);
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
            // One pair of neighbours of all cells of the row at a time: that is done many cells at once.
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

    /// Fills the weight tables; returns how far obstacles reach, cells.
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
        reach
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

    /// The cells that this costmap speaks of. What is outside is never entered.
    #[must_use]
    pub fn cells(&self) -> CellBox {
        self.cells
    }

    /// Side of a cell, metres.
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Cost of a metre in this cell, in metres of free floor; `None` where the robot must not go.
    #[must_use]
    pub fn weight(&self, cell: Cell) -> Option<f64> {
        let weight =
            self.index(cell).and_then(|index| self.weights.get(index).copied()).unwrap_or(BLOCKED)
                & WEIGHT;
        (weight != BLOCKED).then(|| f64::from(weight) / f64::from(FREE))
    }

    /// Whether the robot's middle may be in this cell.
    #[must_use]
    pub fn is_passable(&self, cell: Cell) -> bool {
        self.weight(cell).is_some()
    }

    /// Distance to the nearest obstacle, metres; `None` when there is none within the inflation radius.
    #[must_use]
    pub fn clearance_m(&self, cell: Cell) -> Option<f64> {
        let clearance2 = self.clearance2(self.index(cell)?);
        (clearance2 != FAR).then(|| f64::from(clearance2).sqrt() * self.cell_m)
    }

    pub(super) fn clearance2(&self, index: usize) -> u16 {
        self.clearance2.get(index).copied().unwrap_or(0)
    }

    /// The passable cell nearest to `cell`, at most `radius_m` away; of several, the first row by row.
    #[must_use]
    pub fn nearest_passable(&self, cell: Cell, radius_m: f64) -> Option<Cell> {
        self.nearest(cell, radius_m, |near| self.is_passable(near))
    }

    /// The cell nearest to `cell` that is `wanted`, at most `radius_m` away.
    pub(super) fn nearest(
        &self,
        cell: Cell,
        radius_m: f64,
        wanted: impl Fn(Cell) -> bool,
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
                if nearer && distance2 as f64 <= radius * radius && wanted(near) {
                    best = Some((distance2, near));
                }
            }
        }
        best.map(|(_, cell)| cell)
    }
}

fn quantised(weight: f64) -> u8 {
    (weight * f64::from(FREE)).round().clamp(f64::from(FREE), f64::from(HEAVIEST)) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::MapConfig;
    use crate::planning::{NoPath, Planner};
    use hal::{LaserScan, Pose2, Range, ScanGeometry};

    /// A map made with a scan: free within a ring of hits of 1.5 m, open behind.
    fn ring() -> OccupancyGrid {
        let mut grid = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let geometry = ScanGeometry::UTM_30LX;
        let scan =
            LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(1.5); geometry.beams] };
        grid.begin_update(&Pose2::IDENTITY).unwrap();
        grid.integrate_scan(&scan, &Pose2::IDENTITY).unwrap();
        grid.finish_update();
        grid
    }

    fn costmap(grid: &OccupancyGrid) -> Costmap {
        // Small enough that the cost has several steps between the obstacle and free floor.
        let config = PlanConfig { footprint_radius_m: 0.12, ..PlanConfig::default() };
        let mut costmap = Costmap::new(&config).unwrap();
        costmap.update(grid);
        costmap
    }

    #[test]
    fn cost_rises_towards_an_obstacle_until_it_is_closed() {
        let grid = ring();
        let costmap = costmap(&grid);
        let weights: Vec<Option<f64>> = (0..=50)
            .map(|x| costmap.weight(grid.cell_at(f64::from(x) * 0.03 + 0.001, 0.001)))
            .collect();
        assert_eq!(weights[10], Some(1.0));
        // Hits at 1.5 m: closed from 0.14 m before, dearer from 0.24 m before.
        let closed = weights.iter().position(Option::is_none).unwrap();
        assert!((45..=46).contains(&closed), "{weights:?}");
        let dearer = weights.iter().position(|weight| *weight > Some(1.0)).unwrap();
        assert!((42..=43).contains(&dearer), "{weights:?}");
        assert!(weights[dearer..closed].windows(2).all(|pair| pair[0] < pair[1]), "{weights:?}");
        assert!(weights[closed..].iter().all(Option::is_none));
    }

    #[test]
    fn the_unknown_is_passable_at_its_price() {
        let grid = ring();
        let costmap = costmap(&grid);
        // Behind the robot, where the scanner does not look.
        assert_eq!(costmap.weight(grid.cell_at(-1.0, 0.0)), Some(4.0));
        assert_eq!(costmap.weight(grid.cell_at(-4.0, 0.0)), None, "beyond the padding");
    }

    #[test]
    fn who_doubts_takes_marks_that_were_seen_once_for_unknown_and_believes_those_seen_often() {
        let mut grid = ring();
        let wall = grid.cell_at(1.501, 0.001);
        let mut costmap = costmap(&grid);
        costmap.update_doubting(&grid, 5.0);
        assert_eq!(costmap.weight(wall), Some(4.0));
        costmap.update_doubting(&grid, 0.5);
        assert_eq!(costmap.weight(wall), None);
        let geometry = ScanGeometry::UTM_30LX;
        let scan =
            LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(1.5); geometry.beams] };
        for _ in 0..10 {
            grid.begin_update(&Pose2::IDENTITY).unwrap();
            grid.integrate_scan(&scan, &Pose2::IDENTITY).unwrap();
            grid.finish_update();
        }
        costmap.update_doubting(&grid, 5.0);
        assert_eq!(costmap.weight(wall), None);
    }

    #[test]
    fn a_robot_too_near_to_an_obstacle_drives_away_from_it_first() {
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
        // A robot pressed to the outside of the ring must not come out inside.
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
    fn an_empty_map_has_a_costmap_without_a_way() {
        let grid = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let costmap = costmap(&grid);
        let mut planner = Planner::new(100);
        assert_eq!(
            planner.plan(&costmap, Cell::new(0, 0), Cell::new(5, 5)),
            Err(NoPath::StartBlocked)
        );
    }
}
