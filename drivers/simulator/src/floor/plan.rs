//! The free space of one storey.

use std::sync::Arc;

use hal::Pose2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::components::{Components, cells_along};
use super::distance::distance_to;
use super::grid::Grid;
use super::obstacles::Obstacles;
use super::polygon::Polygon;
use super::raster::{Raster, obstacle, region};
use super::{Corners, Footprint, LEAST_FREE_M2, corners};
use crate::scene::Scene;

/// Surfaces up to this height above the floor may appear in a map, metres: maps mark obstacles up to
/// 1.4 m, and depth is not exact.
const SURFACES_M: f64 = 1.5;

/// Initial radius of the search for the nearest surface, metres.
const FIRST_REACH_M: f64 = 0.1;

/// Free space of a world whose floor is at z = 0.
///
/// Queries about positions use a raster of 5 cm cells; motion and the freedom of a cell's centre
/// use the exact shapes.
#[derive(Debug, Clone)]
pub struct FloorPlan {
    pub(super) footprint: Footprint,
    /// What blocks the robot.
    pub(super) obstacles: Arc<Obstacles>,
    /// Where the floor ends, also behind walls.
    pub(super) edges: Arc<Obstacles>,
    /// Edges over which a robot can fall: no wall stands before them.
    drops: Arc<Obstacles>,
    /// Everything that a robot can map as an obstacle.
    surfaces: Arc<Obstacles>,
    raster: Raster,
    /// Lower bound of the distance from a cell's centre to the nearest obstacle, metres. It is
    /// exact where the raster cannot decide whether the robot fits.
    clearance_m: Vec<f32>,
    components: Components,
    /// Component of free space in which the robot drives.
    home: u32,
    reachable_floor: Vec<bool>,
}

impl FloorPlan {
    /// Computes the free space of a world whose floor is at z = 0. The largest enclosed component
    /// becomes the reachable one.
    ///
    /// # Errors
    /// Describes the criterion that no surface met, for
    /// [`SceneError::NoFloor`](crate::error::SceneError::NoFloor).
    pub fn new(scene: &Scene, footprint: &Footprint) -> Result<Self, String> {
        let triangles: Vec<Corners> = scene.triangles.iter().map(corners).collect();
        let raster = Raster::new(&triangles, region(&triangles), 0.0, footprint.height_m);
        let obstacles = obstacles(&triangles, &raster, footprint.height_m);
        let edges = edges(&raster, |_| true);
        let drops = edges_without_wall(&raster);
        let clearance_m = clearance(&raster, [&obstacles, &edges], footprint.radius_m);
        let components =
            Components::new(&raster, |cell| f64::from(clearance_m[cell]) >= footprint.radius_m);
        let Some((home, _)) = components.best(&raster, LEAST_FREE_M2) else {
            let radius = footprint.radius_m;
            return Err(format!(
                "the floor at height 0 has no free space for a robot of {radius} m radius"
            ));
        };
        let obstacles = Arc::new(obstacles);
        let surfaces = Arc::new(Obstacles::new(
            raster.grid,
            &triangles.iter().filter_map(|t| obstacle(t, 0.0, SURFACES_M)).collect::<Vec<_>>(),
        ));
        let reachable_floor = Vec::new();
        let mut plan = Self {
            footprint: *footprint,
            obstacles,
            edges: Arc::new(edges),
            drops: Arc::new(drops),
            surfaces,
            raster,
            clearance_m,
            components,
            home,
            reachable_floor,
        };
        plan.find_reachable_floor();
        Ok(plan)
    }

    /// The same plan with the component of free space around a position as the reachable one;
    /// `None` where the position is not free.
    #[must_use]
    pub fn around(&self, x_m: f64, y_m: f64) -> Option<Self> {
        let label = self.components.label[self.grid().index(x_m, y_m)?];
        if label == 0 {
            return None;
        }
        let mut plan = Self { home: label, ..self.clone() };
        plan.find_reachable_floor();
        Some(plan)
    }

    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.raster.grid
    }

    /// Robot dimensions for which the plan was computed.
    #[must_use]
    pub fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// Whether there is floor at a position.
    #[must_use]
    pub fn is_supported(&self, x_m: f64, y_m: f64) -> bool {
        self.at(x_m, y_m).is_some_and(|cell| self.raster.supported[cell])
    }

    /// Whether an obstacle between 6 cm and the robot's height touches the cell of a position.
    #[must_use]
    pub fn is_blocked(&self, x_m: f64, y_m: f64) -> bool {
        self.at(x_m, y_m).is_some_and(|cell| self.raster.blocked[cell])
    }

    /// Whether the robot can stand with its centre in the centre of a position's cell.
    #[must_use]
    pub fn is_free(&self, x_m: f64, y_m: f64) -> bool {
        self.at(x_m, y_m).is_some_and(|cell| self.components.label[cell] != 0)
    }

    /// Whether the position is free and the robot can drive there.
    #[must_use]
    pub fn is_reachable(&self, x_m: f64, y_m: f64) -> bool {
        self.at(x_m, y_m).is_some_and(|cell| self.components.label[cell] == self.home)
    }

    /// Whether the position is floor that the robot can cover with its base. This is the area to be
    /// mapped.
    #[must_use]
    pub fn is_reachable_floor(&self, x_m: f64, y_m: f64) -> bool {
        self.at(x_m, y_m).is_some_and(|cell| self.reachable_floor[cell])
    }

    /// Centres of the cells of the reachable floor, metres: the denominator of coverage.
    pub fn reachable_floor(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.reachable_floor
            .iter()
            .enumerate()
            .filter(|(_, is)| **is)
            .map(|(cell, _)| self.grid().center(cell))
    }

    /// Area of the reachable floor, square metres.
    #[must_use]
    pub fn reachable_floor_m2(&self) -> f64 {
        self.reachable_floor().count() as f64 * self.grid().resolution_m.powi(2)
    }

    /// Centres of the cells that the robot's centre can reach, metres.
    pub fn reachable(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.home_cells().iter().map(|&cell| self.grid().center(cell as usize))
    }

    /// The reachable position nearest to a position, metres.
    #[must_use]
    pub fn nearest_free(&self, x_m: f64, y_m: f64) -> [f64; 2] {
        self.reachable()
            .min_by(|a, b| squared_distance(a, x_m, y_m).total_cmp(&squared_distance(b, x_m, y_m)))
            .unwrap_or([x_m, y_m])
    }

    /// Distance from the centre of a position's cell to the nearest obstacle, metres. It may be up
    /// to 4 cm below the true distance and is 0 off the floor.
    #[must_use]
    pub fn clearance_m(&self, x_m: f64, y_m: f64) -> f64 {
        self.at(x_m, y_m).map_or(0.0, |cell| f64::from(self.clearance_m[cell]))
    }

    /// The point of any surface between 6 cm and 1.5 m above the floor that is nearest to a
    /// position, with its distance, if that is less than `limit_m`; metres. Unlike an obstacle of
    /// the robot, a surface may be higher than the robot, and the edge of the floor is none.
    #[must_use]
    pub fn nearest_surface(&self, x_m: f64, y_m: f64, limit_m: f64) -> Option<([f64; 2], f64)> {
        // Most points are near a surface, and the cost grows with the square of the reach.
        let mut reach_m = limit_m.min(FIRST_REACH_M);
        loop {
            let found = self.surfaces.nearest([x_m, y_m], reach_m);
            if found.is_some() || reach_m >= limit_m {
                return found;
            }
            reach_m = limit_m.min(2.0 * reach_m);
        }
    }

    /// Distance from a position to the nearest edge over which a robot can fall, if that is less
    /// than `limit_m`; metres. An edge is known to half a cell (2.5 cm).
    #[must_use]
    pub fn drop_distance_m(&self, x_m: f64, y_m: f64, limit_m: f64) -> Option<f64> {
        self.drops.nearest([x_m, y_m], limit_m).map(|(_, distance_m)| distance_m)
    }

    /// A reachable pose with uniformly distributed position and heading, determined by the seed.
    #[must_use]
    pub fn random_pose(&self, seed: u64) -> Pose2 {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let cells = self.home_cells();
        let [x, y] = self.grid().center(cells[rng.random_range(0..cells.len())] as usize);
        Pose2::new(x, y, rng.random_range(-std::f64::consts::PI..std::f64::consts::PI))
    }

    /// A start pose, determined by the seed. The position is among the tenth of the reachable
    /// positions that are farthest from obstacles, and the heading points to where the view is open
    /// the farthest.
    #[must_use]
    pub fn start_pose(&self, seed: u64) -> Pose2 {
        let mut cells = self.home_cells().to_vec();
        cells.sort_by(|a, b| {
            let clearance_a = self.clearance_m[*a as usize];
            let clearance_b = self.clearance_m[*b as usize];
            clearance_b.total_cmp(&clearance_a).then(a.cmp(b))
        });
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let cell = cells[rng.random_range(0..cells.len().div_ceil(10))] as usize;
        let headings = (0..32).map(|i| f64::from(i) * std::f64::consts::TAU / 32.0);
        // Takes the first of several best headings; `max_by_key` would take the last.
        let (_, yaw) = headings.fold((0, 0.0), |best, yaw| {
            let length = open_cells(yaw, &self.raster, cell);
            if length > best.0 { (length, yaw) } else { best }
        });
        let [x, y] = self.grid().center(cell);
        Pose2::new(x, y, yaw)
    }

    fn at(&self, x_m: f64, y_m: f64) -> Option<usize> {
        self.grid().index(x_m, y_m)
    }

    fn home_cells(&self) -> &[u32] {
        &self.components.cells[self.home as usize]
    }

    fn find_reachable_floor(&mut self) {
        let to_home = distance_to(self.grid(), |cell| self.components.label[cell] == self.home);
        let radius = self.footprint.radius_m as f32;
        self.reachable_floor = (0..self.grid().cells())
            .map(|cell| !self.raster.is_obstacle(cell) && to_home[cell] <= radius)
            .collect();
    }
}

/// Number of free cells in a direction until the next obstacle.
fn open_cells(yaw: f64, raster: &Raster, cell: usize) -> usize {
    cells_along(raster, cell, yaw).take_while(|&along| !raster.is_obstacle(along)).count()
}

fn squared_distance(p: &[f64; 2], x_m: f64, y_m: f64) -> f64 {
    (p[0] - x_m).powi(2) + (p[1] - y_m).powi(2)
}

/// Obstacles between the step height and the robot's height.
fn obstacles(triangles: &[Corners], raster: &Raster, height_m: f64) -> Obstacles {
    let shapes: Vec<Polygon> =
        triangles.iter().filter_map(|t| obstacle(t, 0.0, height_m)).collect();
    Obstacles::new(raster.grid, &shapes)
}

/// The cells without floor beside the floor, as far as `counts` says so.
fn edges(raster: &Raster, counts: impl Fn(usize) -> bool) -> Obstacles {
    let grid = raster.grid;
    let half = grid.resolution_m / 2.0;
    let shapes: Vec<Polygon> = (0..grid.cells())
        .filter(|&cell| !raster.supported[cell] && counts(cell))
        .filter(|&cell| grid.neighbours(cell).any(|next| raster.supported[next]))
        .map(|cell| {
            let center = grid.center(cell);
            Polygon::rectangle(center.map(|c| c - half), center.map(|c| c + half))
        })
        .collect();
    Obstacles::new(grid, &shapes)
}

/// The edges beside floor that no wall touches.
fn edges_without_wall(raster: &Raster) -> Obstacles {
    edges(raster, |cell| {
        !raster.blocked[cell]
            && raster.grid.sides(cell).any(|next| raster.supported[next] && !raster.blocked[next])
    })
}

/// Distance from the centre of every cell to the nearest obstacle: a lower bound from the raster,
/// and exact where the raster cannot decide whether the robot fits.
fn clearance(raster: &Raster, obstacles: [&Obstacles; 2], radius_m: f64) -> Vec<f32> {
    let grid = raster.grid;
    let half = grid.half_diagonal_m();
    let between_centers = distance_to(&grid, |cell| raster.is_obstacle(cell));
    let mut clearance_m: Vec<f32> =
        between_centers.iter().map(|d| (d - half as f32).max(0.0)).collect();
    clearance_m.par_iter_mut().enumerate().for_each(|(cell, clearance)| {
        let may_fit = f64::from(*clearance) + 2.0 * half >= radius_m;
        if !raster.is_obstacle(cell) && may_fit && f64::from(*clearance) < radius_m {
            let limit = radius_m + half;
            let nearest = obstacles.map(|shapes| shapes.nearest(grid.center(cell), limit));
            let exact = nearest
                .into_iter()
                .flatten()
                .fold(limit, |least, (_, distance)| least.min(distance));
            *clearance = exact as f32;
        }
    });
    clearance_m
}
