//! What one depth picture says about the cells in front of the camera.

use hal::{CameraModel, Pose3};

use super::{Cell, CellState, MapConfig, MapError};
use crate::perception::DepthEstimate;

/// What one picture says of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
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
#[derive(Debug, Clone, Default, PartialEq)]
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
    counts: Vec<u16>,
    confidences: Vec<f32>,
    tops_m: Vec<f32>,
    points: Vec<ObstaclePoint>,
    buckets: Vec<Bucket>,
    bearings: Vec<Bearing>,
    /// Ranges that are told apart; the last bucket also holds everything beyond.
    ranges: usize,
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
    /// Slope of the lowest ray, metres of height per metre of range.
    lowest: f32,
}

const EMPTY: Bucket = Bucket { points: 0, obstacles: 0, lowest: f32::INFINITY };

#[derive(Debug, Clone, Copy)]
struct Bearing {
    points: u32,
    confidence: f32,
    /// Distance of the nearest occupied cell that this picture confirms, metres.
    confirmed_m: f32,
    /// Free up to here, metres.
    free_m: f32,
    /// Slope of the lowest ray that reaches that far.
    lowest: f32,
}

const BLIND: Bearing =
    Bearing { points: 0, confidence: 0.0, confirmed_m: f32::INFINITY, free_m: 0.0, lowest: f32::INFINITY };

/// A camera over the floor: `forward` and `right` of it in the plane, heights above the floor.
struct View {
    /// Corner of the square of cells.
    corner: Cell,
    /// Camera in the square, metres.
    x_m: f32,
    y_m: f32,
    height_m: f32,
    /// Heading of the optical axis.
    heading: [f32; 2],
    /// For one metre of depth: forward, right and up, of each used column (the axis included) and each row.
    columns: Vec<[f32; 3]>,
    rows: Vec<[f32; 3]>,
    /// A slope `right / forward` in pixels: `center + focal * slope`.
    focal: f32,
    center: f32,
}

impl View {
    fn new(config: &MapConfig, half: usize, camera: &CameraModel, t_odom_camera: &Pose3) -> Result<Self, MapError> {
        let position = t_odom_camera.translation.vector;
        let rotation = t_odom_camera.rotation.to_rotation_matrix();
        let [right, down, ahead] = [0, 1, 2].map(|axis| rotation.matrix().column(axis).into_owned());
        let length = ahead.x.hypot(ahead.y);
        if length < 0.1 {
            return Err(MapError::CameraVertical);
        }
        let (hx, hy) = (ahead.x / length, ahead.y / length);
        let split =
            |v: nalgebra::Vector3<f64>| [(v.x * hx + v.y * hy) as f32, (v.x * hy - v.y * hx) as f32, v.z as f32];
        let columns = used(camera.width, config.stride_u).map(|u| split(ahead + right * camera.ray(u as f64, 0.0).x));
        let rows = used(camera.height, config.stride_v).map(|v| split(down * camera.ray(0.0, v as f64).y));
        let corner = Cell::containing(position.x, position.y, config.cell_m).offset(-(half as i32), -(half as i32));
        Ok(Self {
            corner,
            x_m: (position.x - f64::from(corner.x) * config.cell_m) as f32,
            y_m: (position.y - f64::from(corner.y) * config.cell_m) as f32,
            height_m: position.z as f32,
            heading: [hx as f32, hy as f32],
            columns: columns.collect(),
            rows: rows.collect(),
            focal: camera.fx as f32,
            center: camera.cx as f32,
        })
    }
}

/// The used rows or columns of `size`: the middle one of each group of `stride`.
fn used(size: usize, stride: usize) -> impl Iterator<Item = usize> {
    (stride / 2..size).step_by(stride)
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
        let slots = (2 * half + 1) * (2 * half + 1);
        Ok(Self {
            config: config.clone(),
            half,
            counts: vec![0; slots],
            confidences: vec![0.0; slots],
            tops_m: vec![0.0; slots],
            points: Vec::new(),
            buckets: Vec::new(),
            bearings: Vec::new(),
            ranges: (config.clear_range_m / cell_m).ceil() as usize + 1,
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
        let view = View::new(&self.config, self.half, camera, t_odom_camera)?;
        self.reset(view.columns.len().max(camera.width.div_ceil(self.config.stride_u)));
        self.collect(estimate, &view);
        self.confirm();
        for bearing in 0..self.bearings.len() {
            self.clear_up_to(bearing);
        }
        self.emit(&view, out);
        Ok(())
    }

    fn reset(&mut self, bearings: usize) {
        self.counts.fill(0);
        self.points.clear();
        self.bearings.clear();
        self.bearings.resize(bearings, BLIND);
        self.buckets.clear();
        self.buckets.resize(bearings * self.ranges, EMPTY);
    }

    /// Sorts every usable pixel into its bearing, range and, if it is an obstacle, cell.
    fn collect(&mut self, estimate: &DepthEstimate, view: &View) {
        let config = &self.config;
        let width = estimate.depth.width();
        let per_cell = 1.0 / config.cell_m as f32;
        let stride = 1.0 / config.stride_u as f32;
        let side = 2 * self.half + 1;
        let lines = estimate.depth.values().chunks_exact(width).zip(estimate.confidence.chunks_exact(width));
        let used_lines = lines.skip(config.stride_v / 2).step_by(config.stride_v);
        for ((depths, confidences), row) in used_lines.zip(&view.rows) {
            for ((u, column), _) in used(width, config.stride_u).zip(&view.columns).zip(0..) {
                let (depth_m, confidence) = (depths[u], confidences[u]);
                // Also refuses NaN.
                if !(depth_m > 0.0 && depth_m < f32::INFINITY && confidence >= config.min_confidence) {
                    continue;
                }
                let forward_m = depth_m * (column[0] + row[0]);
                let right_m = depth_m * (column[1] + row[1]);
                let rise_m = depth_m * (column[2] + row[2]);
                if forward_m <= 0.0 {
                    continue;
                }
                let range_m = (forward_m * forward_m + right_m * right_m).sqrt();
                let height_m = view.height_m + rise_m;
                let is_obstacle = height_m >= config.band_min_m && height_m <= config.band_max_m;
                // A ray that leaves the band before its point says nothing about the band behind.
                let seen_m = if height_m < 0.0 {
                    range_m * (view.height_m / -rise_m).clamp(0.0, 1.0)
                } else if height_m > config.band_max_m {
                    range_m * ((config.band_max_m - view.height_m) / rise_m).clamp(0.0, 1.0)
                } else {
                    range_m
                };
                let pixel = view.center + view.focal * right_m / forward_m + 0.5;
                let bearing = (pixel * stride).floor();
                let bearing = if bearing >= 0.0 { bearing as usize } else { usize::MAX };
                if let Some(of_bearing) = self.bearings.get_mut(bearing) {
                    of_bearing.points += 1;
                    of_bearing.confidence += confidence;
                    let interval = ((seen_m * per_cell) as usize).min(self.ranges - 1);
                    let bucket = &mut self.buckets[bearing * self.ranges + interval];
                    bucket.points = bucket.points.saturating_add(1);
                    bucket.obstacles = bucket.obstacles.saturating_add(u16::from(is_obstacle));
                    bucket.lowest = bucket.lowest.min(rise_m / range_m);
                }
                if is_obstacle && range_m <= config.mark_range_m {
                    let x = (view.x_m + forward_m * view.heading[0] + right_m * view.heading[1]) * per_cell;
                    let y = (view.y_m + forward_m * view.heading[1] - right_m * view.heading[0]) * per_cell;
                    let slot = y as usize * side + x as usize;
                    let first = self.counts[slot] == 0;
                    self.counts[slot] = self.counts[slot].saturating_add(1);
                    self.confidences[slot] = if first { confidence } else { self.confidences[slot] + confidence };
                    self.tops_m[slot] = if first { height_m } else { self.tops_m[slot].max(height_m) };
                    self.points.push(ObstaclePoint { bearing: bearing as u32, slot: slot as u32, range_m });
                }
            }
        }
    }

    /// Tells every bearing of the nearest cell on it that has enough points to be occupied.
    fn confirm(&mut self) {
        for point in &self.points {
            if self.counts[point.slot as usize] >= self.config.min_points
                && let Some(bearing) = self.bearings.get_mut(point.bearing as usize)
            {
                bearing.confirmed_m = bearing.confirmed_m.min(point.range_m);
            }
        }
    }

    /// Decides how far a bearing is free: as far as enough points were seen, and not as far as enough obstacle points.
    fn clear_up_to(&mut self, bearing: usize) {
        let config = &self.config;
        let of_bearing = &mut self.bearings[bearing];
        let buckets = &self.buckets[bearing * self.ranges..(bearing + 1) * self.ranges];
        let enough = u32::from(config.min_points).max((config.outlier_share * of_bearing.points as f32).ceil() as u32);
        let start_m = |interval: usize| (interval as f64 * config.cell_m) as f32;

        let mut obstacles = 0;
        let first_obstacle = buckets.iter().position(|bucket| {
            obstacles += u32::from(bucket.obstacles);
            obstacles >= enough
        });
        let mut points = 0;
        let last_seen = buckets.iter().rposition(|bucket| {
            points += u32::from(bucket.points);
            points >= enough
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
        let blocked_m = obstacle_m.min(of_bearing.confirmed_m) * (1.0 - config.clear_margin);
        of_bearing.free_m = seen_m.min(blocked_m);
        let reached = (of_bearing.free_m / config.cell_m as f32) as usize;
        of_bearing.lowest = buckets.iter().skip(reached).fold(f32::INFINITY, |lowest, b| lowest.min(b.lowest));
    }

    /// Writes every cell of the square that is known, row by row.
    fn emit(&self, view: &View, out: &mut SingleFrameMap) {
        let config = &self.config;
        let cell_m = config.cell_m as f32;
        let side = 2 * self.half + 1;
        let stride = 1.0 / config.stride_u as f32;
        let clear2 = config.clear_range_m * config.clear_range_m;
        for y in 0..side {
            let dy = (y as f32 + 0.5) * cell_m - view.y_m;
            for x in 0..side {
                let slot = y * side + x;
                let cell = view.corner.offset(x as i32, y as i32);
                if self.counts[slot] >= config.min_points {
                    let trust = self.confidences[slot] / f32::from(self.counts[slot]);
                    let evidence = config.occupied_increment * trust.max(f32::MIN_POSITIVE);
                    out.cells.push(FrameCell { cell, evidence, height_m: self.tops_m[slot] });
                    continue;
                }
                let dx = (x as f32 + 0.5) * cell_m - view.x_m;
                let forward_m = dx * view.heading[0] + dy * view.heading[1];
                let range2 = dx * dx + dy * dy;
                if forward_m <= 0.0 || range2 > clear2 {
                    continue;
                }
                let right_m = dx * view.heading[1] - dy * view.heading[0];
                let bearing = (view.center + view.focal * right_m / forward_m + 0.5) * stride;
                if bearing < 0.0 {
                    continue;
                }
                let Some(of_bearing) = self.bearings.get(bearing as usize) else { continue };
                if range2 <= of_bearing.free_m * of_bearing.free_m {
                    let trust = of_bearing.confidence / of_bearing.points.max(1) as f32;
                    let evidence = -config.free_decrement * trust.max(f32::MIN_POSITIVE);
                    let height_m = (view.height_m + range2.sqrt() * of_bearing.lowest).max(0.0);
                    out.cells.push(FrameCell { cell, evidence, height_m });
                }
            }
        }
    }
}

fn check(estimate: &DepthEstimate, camera: &CameraModel, t_odom_camera: &Pose3) -> Result<(), MapError> {
    let depth = (estimate.depth.width(), estimate.depth.height());
    let confidence = estimate.confidence.len();
    if !camera.is_sound() {
        return Err(MapError::CameraModel);
    }
    if depth != (camera.width, camera.height) || confidence != depth.0 * depth.1 {
        return Err(MapError::SizeMismatch { depth, confidence, camera: (camera.width, camera.height) });
    }
    super::grid::check_pose3("t_odom_camera", t_odom_camera)
}
