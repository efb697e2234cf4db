//! What one depth picture says about the cells in front of the camera.

use hal::{CameraModel, Pose3};
use serde::{Deserialize, Serialize};

use super::rays::{RayTable, View, used};
use super::{Cell, CellState, MapConfig, MapError};
use crate::perception::DepthEstimate;

/// What one picture says of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameCell {
    /// The cell.
    pub cell: Cell,
    /// Log-odds to add: positive for occupied, negative for free, never 0.
    pub evidence: f32,
    /// Occupied: the highest point seen, metres above the floor. Free: the height of the lowest ray that passed.
    pub height_m: f32,
}

impl FrameCell {
    /// Free or occupied.
    #[must_use]
    pub fn state(&self) -> CellState {
        CellState::of(self.evidence)
    }
}

/// The cells that one picture knows, row by row. Small enough to keep a history of them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SingleFrameMap {
    /// Sorted by cell, each cell once.
    pub cells: Vec<FrameCell>,
}

impl SingleFrameMap {
    /// What the picture says of a cell.
    #[must_use]
    pub fn state(&self, cell: Cell) -> CellState {
        match self.cells.binary_search_by_key(&cell, |known| known.cell) {
            Ok(at) => self.cells.get(at).map_or(CellState::Unknown, FrameCell::state),
            Err(_) => CellState::Unknown,
        }
    }
}

/// Turns depth pictures into [`SingleFrameMap`]s; owns the memory that this needs.
///
/// Pixels with enough confidence become points. Points within the height band are obstacles; a cell with enough of them is
/// occupied. A cell is free when, at its bearing, enough pixels look at something further away and no obstacle of this
/// picture stands in between. Bearings are bins as wide as a used column of the picture.
#[derive(Debug, Clone)]
pub struct FrameMapper {
    config: MapConfig,
    /// Cells from the camera to the edge of the square that can be seen.
    half: usize,
    /// Ranges that are told apart; the last bucket also holds everything beyond.
    ranges: usize,
    table: RayTable,
    slots: Vec<Slot>,
    points: Vec<ObstaclePoint>,
    buckets: Vec<Bucket>,
    bearings: Vec<Bearing>,
    fans: Vec<Fan>,
    line: Vec<Aim>,
}

/// The obstacle points in one cell of the square.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    points: u32,
    confidence: f32,
    top_m: f32,
}

/// A point in the height band, near enough to mark its cell.
#[derive(Debug, Clone, Copy)]
struct ObstaclePoint {
    bearing: u32,
    slot: u32,
    range_m: f32,
}

/// The points of one bearing in one interval of range.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    points: u16,
    obstacles: u16,
    /// Slope of the lowest ray.
    lowest: f32,
}

const EMPTY: Bucket = Bucket { points: 0, obstacles: 0, lowest: f32::INFINITY };

/// All points of one bearing.
#[derive(Debug, Clone, Copy)]
struct Bearing {
    points: u32,
    confidence: f32,
    /// Distance of the nearest cell that this picture marks occupied, metres.
    confirmed_m: f32,
}

const BLIND: Bearing = Bearing { points: 0, confidence: 0.0, confirmed_m: f32::INFINITY };

/// What one bearing says of the cells along it.
#[derive(Debug, Clone, Copy)]
struct Fan {
    /// Square of the range up to which they are free, square metres.
    free2: f32,
    evidence: f32,
    /// Slope of the lowest ray that reaches that far.
    lowest: f32,
}

/// Where a cell lies, seen from the camera.
#[derive(Debug, Clone, Copy, Default)]
struct Aim {
    /// Square of its range, infinite behind the camera, square metres.
    range2: f32,
    bearing: i32,
}

impl FrameMapper {
    /// A mapper for pictures of any size.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(config: &MapConfig) -> Result<Self, MapError> {
        config.validate()?;
        let cell_m = config.cell_m as f32;
        let half = (config.mark_range_m.max(config.clear_range_m) / cell_m).ceil() as usize + 1;
        let side = 2 * half + 1;
        Ok(Self {
            config: config.clone(),
            half,
            ranges: (config.clear_range_m / cell_m).ceil() as usize + 1,
            table: RayTable::default(),
            slots: vec![Slot::default(); side * side],
            points: Vec::new(),
            buckets: Vec::new(),
            bearings: Vec::new(),
            fans: Vec::new(),
            line: vec![Aim::default(); side],
        })
    }

    /// Writes what `estimate`, taken at `t_odom_camera`, says into `out`. The floor is at height 0 of `odom`.
    ///
    /// # Errors
    /// When the pose is not finite or out of reach, the sizes do not agree, the camera is not sound or looks straight up or
    /// down. `out` is then empty.
    pub fn map(
        &mut self,
        estimate: &DepthEstimate,
        camera: &CameraModel,
        t_odom_camera: &Pose3,
        out: &mut SingleFrameMap,
    ) -> Result<(), MapError> {
        out.cells.clear();
        check(estimate, camera, t_odom_camera)?;
        let view = View::new(&self.config, self.half, t_odom_camera)?;
        self.table.prepare(&self.config, camera, &view);
        self.reset();
        self.collect(estimate, &view);
        self.confirm();
        self.fans.clear();
        for bearing in 0..self.bearings.len() {
            self.fans.push(self.fan(bearing));
        }
        self.emit(camera, &view, out);
        Ok(())
    }

    fn reset(&mut self) {
        for point in self.points.drain(..) {
            self.slots[point.slot as usize] = Slot::default();
        }
        self.bearings.clear();
        self.bearings.resize(self.table.bearings, BLIND);
        self.buckets.clear();
        self.buckets.resize(self.table.bearings * self.ranges, EMPTY);
    }

    /// Sorts every usable pixel into its bearing, range and, if it is an obstacle, cell.
    fn collect(&mut self, estimate: &DepthEstimate, view: &View) {
        let config = &self.config;
        let width = estimate.depth.width();
        let per_cell = 1.0 / config.cell_m as f32;
        let side = 2 * self.half + 1;
        let depths = estimate
            .depth
            .values()
            .chunks_exact(width)
            .skip(config.stride_v / 2)
            .step_by(config.stride_v);
        let trusts = estimate
            .confidence
            .chunks_exact(width)
            .skip(config.stride_v / 2)
            .step_by(config.stride_v);
        let rays = self.table.rays.chunks_exact(used(width, config.stride_u).count().max(1));
        for ((depths, trusts), rays) in depths.zip(trusts).zip(rays) {
            for (u, ray) in used(width, config.stride_u).zip(rays) {
                let (depth_m, confidence) = (depths[u], trusts[u]);
                // Also refuses NaN.
                let usable =
                    depth_m > 0.0 && depth_m < f32::INFINITY && confidence >= config.min_confidence;
                if !usable || ray.forward <= 0.0 {
                    continue;
                }
                let range_m = depth_m * ray.range;
                let height_m = view.height_m + depth_m * ray.rise;
                let is_obstacle = height_m >= config.band_min_m && height_m <= config.band_max_m;
                if let Some(of_bearing) = self.bearings.get_mut(ray.bearing as usize) {
                    of_bearing.points += 1;
                    of_bearing.confidence += confidence;
                    // A ray that leaves the band before its point says nothing about the band behind.
                    let seen_m = range_m.min(ray.leaves_band_m);
                    let interval = ((seen_m * per_cell) as i32 as usize).min(self.ranges - 1);
                    let bucket = &mut self.buckets[ray.bearing as usize * self.ranges + interval];
                    bucket.points = bucket.points.saturating_add(1);
                    bucket.obstacles = bucket.obstacles.saturating_add(u16::from(is_obstacle));
                    bucket.lowest = bucket.lowest.min(ray.slope);
                }
                if is_obstacle && range_m <= config.mark_range_m {
                    let (forward_m, right_m) = (depth_m * ray.forward, depth_m * ray.right);
                    let x = (view.x_m + forward_m * view.heading[0] + right_m * view.heading[1])
                        * per_cell;
                    let y = (view.y_m + forward_m * view.heading[1] - right_m * view.heading[0])
                        * per_cell;
                    let index = y as i32 as usize * side + x as i32 as usize;
                    let slot = &mut self.slots[index];
                    slot.points += 1;
                    slot.confidence += confidence;
                    slot.top_m = slot.top_m.max(height_m);
                    self.points.push(ObstaclePoint {
                        bearing: ray.bearing,
                        slot: index as u32,
                        range_m,
                    });
                }
            }
        }
    }

    /// Tells every bearing of the nearest cell on it that has enough points to be occupied.
    fn confirm(&mut self) {
        for point in &self.points {
            if self.slots[point.slot as usize].points >= u32::from(self.config.min_points)
                && let Some(bearing) = self.bearings.get_mut(point.bearing as usize)
            {
                bearing.confirmed_m = bearing.confirmed_m.min(point.range_m);
            }
        }
    }

    /// Decides how far a bearing is free: as far as enough points were seen, and not as far as enough obstacle points.
    fn fan(&self, bearing: usize) -> Fan {
        let config = &self.config;
        let of_bearing = &self.bearings[bearing];
        let buckets = &self.buckets[bearing * self.ranges..(bearing + 1) * self.ranges];
        let enough = u32::from(config.min_points)
            .max((config.outlier_share * of_bearing.points as f32).ceil() as u32);
        let start_m = |interval: usize| (interval as f64 * config.cell_m) as f32;

        let mut points = 0;
        let last_seen = buckets.iter().rposition(|bucket| {
            points += u32::from(bucket.points);
            points >= enough
        });
        let mut obstacles = 0;
        let first_obstacle = buckets.iter().position(|bucket| {
            obstacles += u32::from(bucket.obstacles);
            obstacles >= enough
        });
        // Seen to the last bucket is seen to the end of the clear range.
        let seen_m = match last_seen {
            None => 0.0,
            Some(interval) if interval + 1 == self.ranges => config.clear_range_m,
            Some(interval) => start_m(interval),
        };
        let obstacle_m = match first_obstacle {
            Some(interval) if interval + 1 < self.ranges => start_m(interval),
            _ => f32::INFINITY,
        };
        let free_m =
            seen_m.min(obstacle_m.min(of_bearing.confirmed_m) * (1.0 - config.clear_margin));
        let reached = (free_m / config.cell_m as f32) as usize;
        let trust = of_bearing.confidence / of_bearing.points.max(1) as f32;
        Fan {
            free2: free_m * free_m,
            evidence: -config.free_decrement * trust.max(f32::MIN_POSITIVE),
            lowest: buckets
                .iter()
                .skip(reached)
                .fold(f32::INFINITY, |lowest, bucket| lowest.min(bucket.lowest)),
        }
    }

    /// Writes every cell of the square that is known, row by row.
    fn emit(&mut self, camera: &CameraModel, view: &View, out: &mut SingleFrameMap) {
        let side = 2 * self.half + 1;
        let min_points = u32::from(self.config.min_points);
        for y in 0..side {
            self.aim(camera, view, y);
            let slots = &self.slots[y * side..(y + 1) * side];
            for (x, (slot, aim)) in slots.iter().zip(&self.line).enumerate() {
                let cell = view.corner.offset(x as i32, y as i32);
                if slot.points >= min_points {
                    let trust = slot.confidence / slot.points as f32;
                    let evidence = self.config.occupied_increment * trust.max(f32::MIN_POSITIVE);
                    out.cells.push(FrameCell { cell, evidence, height_m: slot.top_m });
                } else if let Some(fan) = self.fans.get(aim.bearing as usize)
                    && aim.range2 < fan.free2
                {
                    let height_m = (view.height_m + aim.range2.sqrt() * fan.lowest).max(0.0);
                    out.cells.push(FrameCell { cell, evidence: fan.evidence, height_m });
                }
            }
        }
    }

    /// Fills `line` for row `y` of the square; without branches, so that it is done several cells at a time.
    fn aim(&mut self, camera: &CameraModel, view: &View, y: usize) {
        let cell_m = self.config.cell_m as f32;
        let per_bearing = 1.0 / self.config.stride_u as f32;
        let focal = camera.fx as f32 * per_bearing;
        // One more than the bearing, so that what is left of the first one rounds to 0 and not up to it.
        let center = (camera.cx as f32 + 0.5) * per_bearing + 1.0;
        let dy = (y as f32 + 0.5) * cell_m - view.y_m;
        let [hx, hy] = view.heading;
        for (x, aim) in self.line.iter_mut().enumerate() {
            let dx = (x as i32 as f32 + 0.5) * cell_m - view.x_m;
            let forward_m = dx * hx + dy * hy;
            let right_m = dx * hy - dy * hx;
            aim.range2 = if forward_m > 0.0 { dx * dx + dy * dy } else { f32::INFINITY };
            // Beside the camera this grows without bound; what lies outside of the picture may be anywhere outside.
            aim.bearing = (center + focal * right_m / forward_m).max(-1e6) as i32 - 1;
        }
    }
}

fn check(
    estimate: &DepthEstimate,
    camera: &CameraModel,
    t_odom_camera: &Pose3,
) -> Result<(), MapError> {
    let depth = (estimate.depth.width(), estimate.depth.height());
    let confidence = estimate.confidence.len();
    if !camera.is_sound() {
        return Err(MapError::CameraModel);
    }
    if depth != (camera.width, camera.height) || confidence != depth.0 * depth.1 {
        return Err(MapError::SizeMismatch {
            depth,
            confidence,
            camera: (camera.width, camera.height),
        });
    }
    super::grid::check_pose3("t_odom_camera", t_odom_camera)
}
