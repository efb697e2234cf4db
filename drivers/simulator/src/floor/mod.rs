//! Free space of a world: floor detection, the area that the robot can reach, and collision-checked
//! motion.

mod components;
mod distance;
mod grid;
mod level;
mod motion;
mod obstacles;
mod plan;
mod polygon;
mod raster;

pub use grid::Grid;
pub use level::find_floor;
pub use motion::{Body, Disc, Moved};
pub use plan::FloorPlan;

use crate::scene::Triangle;

/// The robot dimensions that determine its free space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// Radius of the round base, metres.
    pub radius_m: f64,
    /// Objects higher than this above the floor do not block the robot, metres.
    pub height_m: f64,
}

impl Default for Footprint {
    /// The default robot, 0.1 m higher than its camera.
    fn default() -> Self {
        Self { radius_m: hal::RobotDescription::default().footprint_radius_m, height_m: 0.9 }
    }
}

/// Side of a cell, metres.
const RESOLUTION_M: f64 = 0.05;

/// Height differences up to this can be driven over, metres: carpets, thresholds, waves of a
/// scanned floor.
const STEP_M: f64 = 0.06;

/// Smaller pieces of free space are ignored, square metres (of positions of the robot's centre).
const LEAST_FREE_M2: f64 = 0.05;

type Corners = [[f64; 3]; 3];

fn corners(triangle: &Triangle) -> Corners {
    triangle.vertices.map(|v| v.position_m.map(f64::from))
}

/// Area seen from above and cosine of the slope (0 for a triangle without area).
fn seen_from_above(corners: &Corners) -> (f64, f64) {
    let [a, b, c] = corners;
    let u: [f64; 3] = std::array::from_fn(|i| b[i] - a[i]);
    let v: [f64; 3] = std::array::from_fn(|i| c[i] - a[i]);
    let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = normal.iter().map(|c| c * c).sum::<f64>().sqrt();
    (normal[2].abs() / 2.0, if length > 0.0 { normal[2].abs() / length } else { 0.0 })
}

#[cfg(test)]
mod tests;
