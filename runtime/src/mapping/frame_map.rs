//! Single-frame maps: the occupancy of the cells in front of the camera according to one depth
//! frame.

use hal::{CameraModel, Pose3};
use serde::{Deserialize, Serialize};

use super::ground::{Ground, GroundCell};
use super::rays::{Ray, RayTable, View, used};
use super::{Cell, CellState, MapConfig, MapError};
use crate::perception::DepthEstimate;

/// The observation of one cell in one depth frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameCell {
    pub cell: Cell,
    /// Log-odds to add: positive for occupied, negative for free, never 0.
    pub evidence: f32,
    /// Metres above the floor. Of an occupied cell: its highest observed point. Of a free cell: the
    /// lowest ray that passed through it.
    pub height_m: f32,
}

impl FrameCell {
    #[must_use]
    pub fn state(&self) -> CellState {
        CellState::of(self.evidence)
    }
}

/// The cells that one depth frame observes, row by row. It is small enough to keep a history of
/// frames.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SingleFrameMap {
    /// Sorted by cell, each cell once.
    pub cells: Vec<FrameCell>,
}

impl SingleFrameMap {
    /// The state of a cell according to this frame.
    #[must_use]
    pub fn state(&self, cell: Cell) -> CellState {
        match self.cells.binary_search_by_key(&cell, |known| known.cell) {
            Ok(at) => self.cells.get(at).map_or(CellState::Unknown, FrameCell::state),
            Err(_) => CellState::Unknown,
        }
    }
}

/// Converts depth frames to [`SingleFrameMap`]s and reuses its buffers.
///
/// Pixels with enough confidence become points. Points within the height band are obstacles, and a
/// cell with enough obstacle points is occupied. A cell is free if, at its bearing, enough pixels
/// see something farther away and neither an obstacle nor a drop of this frame is in between, nor
/// floor that should be seen and is missing. Bearings are bins as wide as a used column of the image.
#[derive(Debug, Clone)]
pub struct FrameMapper {
    config: MapConfig,
    /// Number of cells from the camera's cell to the edge of the observed square.
    half: usize,
    /// Number of range bins; the last one also holds everything beyond.
    range_bins: usize,
    table: RayTable,
    cell_points: Vec<CellPoints>,
    points: Vec<ObstaclePoint>,
    buckets: Vec<Bucket>,
    bearings: Vec<Bearing>,
    free_ranges: Vec<FreeRange>,
    polar_row: Vec<PolarCell>,
    ground: Ground,
}

/// A stretch of floor without any depth ends what is free when it is longer than this, metres: the
/// wheels of a small robot are as large.
const FLOOR_GAP_M: f64 = 0.1;

/// The obstacle points in one cell.
#[derive(Debug, Clone, Copy, Default)]
struct CellPoints {
    points: u32,
    confidence: f32,
    top_m: f32,
}

/// A point in the height band that is close enough to mark its cell.
#[derive(Debug, Clone, Copy)]
struct ObstaclePoint {
    bearing: u32,
    /// Index into `cell_points`.
    cell_index: u32,
    range_m: f32,
}

/// The points of one bearing in one range bin.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    points: u16,
    /// Obstacles, and drops at the range where the floor ends.
    obstacles: u16,
    /// Rays without a depth that meet the floor's plane here.
    without_depth: u16,
    /// Slope of the lowest ray: height per range.
    lowest_slope: f32,
}

const EMPTY_BUCKET: Bucket =
    Bucket { points: 0, obstacles: 0, without_depth: 0, lowest_slope: f32::INFINITY };

/// All points of one bearing.
#[derive(Debug, Clone, Copy)]
struct Bearing {
    points: u32,
    confidence: f32,
    /// Distance of the nearest cell at this bearing that the frame marks as occupied, metres.
    nearest_occupied_m: f32,
}

const NO_POINTS: Bearing =
    Bearing { points: 0, confidence: 0.0, nearest_occupied_m: f32::INFINITY };

/// The range up to which the cells of one bearing are free.
#[derive(Debug, Clone, Copy)]
struct FreeRange {
    /// Square of the range, square metres.
    range2: f32,
    evidence: f32,
    /// Slope of the lowest ray that reaches at least this range.
    lowest_slope: f32,
}

/// A cell's polar coordinates as seen from the camera.
#[derive(Debug, Clone, Copy, Default)]
struct PolarCell {
    /// Square of the range, square metres; infinite behind the camera.
    range2: f32,
    bearing: i32,
}

impl FrameMapper {
    /// A mapper for frames of any size.
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
            range_bins: (config.clear_range_m / cell_m).ceil() as usize + 1,
            table: RayTable::default(),
            cell_points: vec![CellPoints::default(); side * side],
            points: Vec::new(),
            buckets: Vec::new(),
            bearings: Vec::new(),
            free_ranges: Vec::new(),
            polar_row: vec![PolarCell::default(); side],
            ground: Ground::new(config),
        })
    }

    /// Writes the single-frame map of `estimate`, taken at `t_odom_camera`, to `out`. The floor is
    /// at height 0 of `odom`.
    ///
    /// # Errors
    /// If the pose is not finite or out of reach, the sizes do not agree, the camera model is
    /// invalid, or the camera points straight up or down. `out` is then empty.
    pub fn map(
        &mut self,
        estimate: &DepthEstimate,
        camera: &CameraModel,
        t_odom_camera: &Pose3,
        out: &mut SingleFrameMap,
    ) -> Result<(), MapError> {
        out.cells.clear();
        self.ground.reset();
        check(estimate, camera, t_odom_camera)?;
        let view = View::new(&self.config, self.half, t_odom_camera)?;
        self.table.prepare(&self.config, camera, &view);
        self.reset();
        self.sort_pixels(estimate, &view);
        self.ground.finish();
        self.find_nearest_occupied();
        self.free_ranges.clear();
        for bearing in 0..self.bearings.len() {
            self.free_ranges.push(self.free_range(bearing));
        }
        self.write_cells(camera, &view, out);
        Ok(())
    }

    fn reset(&mut self) {
        for point in self.points.drain(..) {
            self.cell_points[point.cell_index as usize] = CellPoints::default();
        }
        self.bearings.clear();
        self.bearings.resize(self.table.bearings, NO_POINTS);
        self.buckets.clear();
        self.buckets.resize(self.table.bearings * self.range_bins, EMPTY_BUCKET);
    }

    /// Adds every usable pixel to its bearing, its range bin and, if it is an obstacle, its cell.
    fn sort_pixels(&mut self, estimate: &DepthEstimate, view: &View) {
        let config = &self.config;
        let width = estimate.depth.width();
        let cells_per_m = 1.0 / config.cell_m as f32;
        let side = 2 * self.half + 1;
        let depths = estimate
            .depth
            .values()
            .chunks_exact(width)
            .skip(config.stride_v / 2)
            .step_by(config.stride_v);
        let confidences = estimate
            .confidence
            .chunks_exact(width)
            .skip(config.stride_v / 2)
            .step_by(config.stride_v);
        let rays = self.table.rays.chunks_exact(used(width, config.stride_u).count().max(1));
        for ((depths, confidences), rays) in depths.zip(confidences).zip(rays) {
            for (u, ray) in used(width, config.stride_u).zip(rays) {
                let depth_m = depths[u];
                let confidence = confidences[u];
                // These comparisons also reject NaN.
                let usable =
                    depth_m > 0.0 && depth_m < f32::INFINITY && confidence >= config.min_confidence;
                if !usable {
                    count_without_depth(ray, config, self.range_bins, &mut self.buckets);
                    continue;
                }
                if ray.forward <= 0.0 {
                    continue;
                }
                let range_m = depth_m * ray.range;
                let height_m = view.height_m + depth_m * ray.rise;
                let is_in_band = height_m >= config.band_min_m && height_m <= config.band_max_m;
                let is_obstacle = is_in_band && self.ground.is_obstacle(ray, range_m, confidence);
                let is_drop = self.ground.add(ray, view, depth_m, confidence);
                if let Some(bearing_points) = self.bearings.get_mut(ray.bearing as usize) {
                    bearing_points.points += 1;
                    bearing_points.confidence += confidence;
                    // A ray that leaves the height band before its point has not observed the band
                    // beyond that range.
                    let seen_m = range_m.min(ray.leaves_band_m);
                    let interval =
                        ((seen_m * cells_per_m) as i32 as usize).min(self.range_bins - 1);
                    let bucket =
                        &mut self.buckets[ray.bearing as usize * self.range_bins + interval];
                    bucket.points = bucket.points.saturating_add(1);
                    bucket.obstacles =
                        bucket.obstacles.saturating_add(u16::from(is_obstacle || is_drop));
                    bucket.lowest_slope = bucket.lowest_slope.min(ray.slope);
                }
                if is_obstacle && range_m <= config.mark_range_m {
                    let forward_m = depth_m * ray.forward;
                    let right_m = depth_m * ray.right;
                    let x = (view.x_m + forward_m * view.heading[0] + right_m * view.heading[1])
                        * cells_per_m;
                    let y = (view.y_m + forward_m * view.heading[1] - right_m * view.heading[0])
                        * cells_per_m;
                    let index = y as i32 as usize * side + x as i32 as usize;
                    let in_cell = &mut self.cell_points[index];
                    in_cell.points += 1;
                    in_cell.confidence += confidence;
                    in_cell.top_m = in_cell.top_m.max(height_m);
                    self.points.push(ObstaclePoint {
                        bearing: ray.bearing,
                        cell_index: index as u32,
                        range_m,
                    });
                }
            }
        }
    }

    /// Sets for every bearing the distance of the nearest cell with enough points to be occupied.
    fn find_nearest_occupied(&mut self) {
        for point in &self.points {
            if self.cell_points[point.cell_index as usize].points
                >= u32::from(self.config.min_points)
                && let Some(bearing) = self.bearings.get_mut(point.bearing as usize)
            {
                bearing.nearest_occupied_m = bearing.nearest_occupied_m.min(point.range_m);
            }
        }
    }

    /// Decides up to which range a bearing is free: up to the range that enough points reach, but
    /// less than the range of enough obstacle points.
    fn free_range(&self, bearing: usize) -> FreeRange {
        let config = &self.config;
        let bearing_points = &self.bearings[bearing];
        let buckets = &self.buckets[bearing * self.range_bins..(bearing + 1) * self.range_bins];
        let enough = u32::from(config.min_points)
            .max((config.outlier_share * bearing_points.points as f32).ceil() as u32);
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
        // Points in the last bin make the whole clear range observed.
        let seen_m = match last_seen {
            None => 0.0,
            Some(interval) if interval + 1 == self.range_bins => config.clear_range_m,
            Some(interval) => (interval as f64 * config.cell_m) as f32,
        };
        let seen_m = seen_m.min(self.missing_floor_m(buckets));
        let obstacle_m = match first_obstacle {
            Some(interval) if interval + 1 < self.range_bins => {
                (interval as f64 * config.cell_m) as f32
            }
            _ => f32::INFINITY,
        };
        let free_m = seen_m
            .min(obstacle_m.min(bearing_points.nearest_occupied_m) * (1.0 - config.clear_margin));
        let reached = (free_m / config.cell_m as f32) as usize;
        let mean_confidence = bearing_points.confidence / bearing_points.points.max(1) as f32;
        FreeRange {
            range2: free_m * free_m,
            evidence: -config.free_decrement * mean_confidence.max(f32::MIN_POSITIVE),
            lowest_slope: buckets
                .iter()
                .skip(reached)
                .fold(f32::INFINITY, |lowest, bucket| lowest.min(bucket.lowest_slope)),
        }
    }

    /// Range of the nearest stretch of a bearing in which the floor should be seen and no ray has a
    /// depth; infinite if there is none.
    fn missing_floor_m(&self, buckets: &[Bucket]) -> f32 {
        let mut first = None;
        let mut missing = 0;
        for (interval, bucket) in buckets.iter().enumerate() {
            if bucket.points > 0 {
                first = None;
                missing = 0;
            } else if bucket.without_depth > 0 {
                let first = *first.get_or_insert(interval);
                missing += u32::from(bucket.without_depth);
                let stretch_m = (interval - first) as f64 * self.config.cell_m;
                if missing >= u32::from(self.config.min_points) && stretch_m >= FLOOR_GAP_M {
                    return (first as f64 * self.config.cell_m) as f32;
                }
            }
        }
        f32::INFINITY
    }

    /// The cells in which the last frame saw a drop or the floor.
    pub(super) fn ground(&self) -> &[GroundCell] {
        self.ground.seen()
    }

    /// Writes every known cell of the square to `out`, row by row.
    fn write_cells(&mut self, camera: &CameraModel, view: &View, out: &mut SingleFrameMap) {
        let side = 2 * self.half + 1;
        let min_points = u32::from(self.config.min_points);
        for y in 0..side {
            self.fill_polar_row(camera, view, y);
            let cell_points = &self.cell_points[y * side..(y + 1) * side];
            for (x, (in_cell, polar)) in cell_points.iter().zip(&self.polar_row).enumerate() {
                let cell = view.corner.offset(x as i32, y as i32);
                if in_cell.points >= min_points {
                    let mean_confidence = in_cell.confidence / in_cell.points as f32;
                    let evidence =
                        self.config.occupied_increment * mean_confidence.max(f32::MIN_POSITIVE);
                    out.cells.push(FrameCell { cell, evidence, height_m: in_cell.top_m });
                } else if let Some(free) = self.free_ranges.get(polar.bearing as usize)
                    && polar.range2 < free.range2
                {
                    let height_m =
                        (view.height_m + polar.range2.sqrt() * free.lowest_slope).max(0.0);
                    out.cells.push(FrameCell { cell, evidence: free.evidence, height_m });
                }
            }
        }
    }

    /// Fills `polar_row` for row `y` of the square. The loop has no branches, so that the compiler
    /// can vectorise it.
    fn fill_polar_row(&mut self, camera: &CameraModel, view: &View, y: usize) {
        let cell_m = self.config.cell_m as f32;
        let per_bearing = 1.0 / self.config.stride_u as f32;
        let focal = camera.fx as f32 * per_bearing;
        // The conversion to an integer rounds towards 0. Adding 1 here and subtracting it below
        // keeps cells to the left of the first bin out of that bin.
        let center = (camera.cx as f32 + 0.5) * per_bearing + 1.0;
        let dy = (y as f32 + 0.5) * cell_m - view.y_m;
        let [hx, hy] = view.heading;
        for (x, polar) in self.polar_row.iter_mut().enumerate() {
            let dx = (x as i32 as f32 + 0.5) * cell_m - view.x_m;
            let forward_m = dx * hx + dy * hy;
            let right_m = dx * hy - dy * hx;
            polar.range2 = if forward_m > 0.0 { dx * dx + dy * dy } else { f32::INFINITY };
            // Beside the camera the quotient grows without bound. Any value outside of the image is
            // correct there.
            polar.bearing = (center + focal * right_m / forward_m).max(-1e6) as i32 - 1;
        }
    }
}

/// Counts a ray without a depth where it meets the floor within the clear range.
fn count_without_depth(ray: &Ray, config: &MapConfig, range_bins: usize, buckets: &mut [Bucket]) {
    let meets_floor =
        ray.forward > 0.0 && ray.slope < 0.0 && ray.leaves_band_m < config.clear_range_m;
    if meets_floor {
        let interval = ((ray.leaves_band_m / config.cell_m as f32) as usize).min(range_bins - 1);
        let at = (ray.bearing as usize).saturating_mul(range_bins).saturating_add(interval);
        if let Some(bucket) = buckets.get_mut(at) {
            bucket.without_depth = bucket.without_depth.saturating_add(1);
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
