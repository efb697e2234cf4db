//! What a depth frame tells the grid where the LiDAR measures surfaces, too.
//!
//! A camera sees what stands above and below the plane of the scan, and a scan knows better where. An obstacle of the camera whose distance
//! agrees with that of a surface, as far as the confidence of its depth can tell, is part of what stands at that surface. Behind a surface
//! the camera sees what is higher than the surface; but a plain wall looks more distant than it is, and then there would be free floor
//! behind it, and another wall.

use hal::{CameraModel, Pose3};

use super::ground::{is_larger, log_error};
use super::surfaces::{Surface, Surfaces};
use super::{Cell, FrameCell, LidarUse, OccupancyGrid, SingleFrameMap};

/// An obstacle that is still in the image at this distance from the camera, metres, can wait behind a surface until the robot is
/// there. What is lower has to be marked from afar.
const NEAR_M: f64 = 0.5;

/// What the ray to the highest point of a cell does at a surface of the scan.
struct Crossing {
    /// Distance of the cell from the camera as a multiple of that of the surface.
    factor: f64,
    /// Height of the ray at the surface, metres.
    ray_m: f64,
}

impl OccupancyGrid {
    /// Adds the evidence of a single-frame map.
    ///
    /// An obstacle that agrees with a surface of the scan is marked there. Cells behind a surface become neither free nor occupied by
    /// what the camera still sees from near by, or sees through the surface. What is so low that it leaves the image when the robot
    /// comes near, such as a table top behind a box, is marked: it would not be seen again.
    pub(super) fn add_frame(
        &mut self,
        frame: &SingleFrameMap,
        surfaces: &Surfaces,
        camera: &CameraModel,
        t_odom_camera: &Pose3,
    ) {
        let lowest_near_m = lowest_near_m(camera, t_odom_camera);
        for seen in &frame.cells {
            let surface = surfaces.toward(self.center_m(seen.cell));
            match surface.filter(|_| self.config.lidar != LidarUse::Off) {
                None => self.add_cell(seen),
                Some(surface) if seen.evidence > 0.0 => {
                    let crossing = self.crossing(seen, &surface, t_odom_camera);
                    self.add_obstacle(seen, &surface, &crossing, lowest_near_m);
                }
                Some(surface) if !self.is_behind(&surface) => self.add_cell(seen),
                Some(_) => {}
            }
        }
    }

    /// Adds an obstacle in whose direction the scan measured a surface.
    fn add_obstacle(
        &mut self,
        seen: &FrameCell,
        surface: &Surface,
        crossing: &Crossing,
        lowest_near_m: f64,
    ) {
        let is_seen_from_near = f64::from(seen.height_m) > lowest_near_m;
        if self.is_at_surface(seen, crossing) {
            let at = self.cell_at(surface.point_m[0], surface.point_m[1]);
            self.add_camera_obstacle(at, seen.evidence, in_cm(crossing.ray_m));
        } else if !self.is_behind(surface)
            || !(is_seen_from_near || self.is_through(surface, crossing))
        {
            self.add_cell(seen);
        }
    }

    fn add_cell(&mut self, seen: &FrameCell) {
        let Some(index) = self.window.index(seen.cell) else { return };
        let height_cm = in_cm(f64::from(seen.height_m));
        if seen.evidence > 0.0 {
            self.add_camera_obstacle(seen.cell, seen.evidence, height_cm);
        } else if !self.holds_drop(index) {
            let over_the_top = self.stored[index] > 0.0 && height_cm > self.top_cm[index];
            let weight = if over_the_top { self.config.over_the_top_weight } else { 1.0 };
            self.add_evidence(seen.cell, index, seen.evidence * weight);
        }
    }

    fn crossing(&self, seen: &FrameCell, surface: &Surface, t_odom_camera: &Pose3) -> Crossing {
        let camera_m = &t_odom_camera.translation.vector;
        let [cell_x_m, cell_y_m] = self.center_m(seen.cell);
        let [surface_x_m, surface_y_m] = surface.point_m;
        let to_cell_m = (cell_x_m - camera_m.x).hypot(cell_y_m - camera_m.y);
        let to_surface_m = (surface_x_m - camera_m.x).hypot(surface_y_m - camera_m.y);
        let factor = to_cell_m / to_surface_m;
        let ray_m = camera_m.z + (f64::from(seen.height_m) - camera_m.z) / factor;
        Crossing { factor, ray_m }
    }

    /// Whether a place is so far behind a surface that noise does not explain it.
    fn is_behind(&self, surface: &Surface) -> bool {
        surface.behind_m > f64::from(self.config.behind_hit_m)
    }

    /// Whether an obstacle is as far away as the surface, within the error that the confidence of its depth admits.
    fn is_at_surface(&self, seen: &FrameCell, crossing: &Crossing) -> bool {
        let confidence = seen.evidence / self.config.occupied_increment;
        let factor = crossing.factor.max(crossing.factor.recip()) as f32;
        factor.is_finite() && !is_larger(factor, confidence, log_error(self.config.apart_certainty))
    }

    /// Whether the ray goes through an obstacle that the map holds at the surface.
    fn is_through(&self, surface: &Surface, crossing: &Crossing) -> bool {
        let [x_m, y_m] = surface.point_m;
        let at = self.cell_at(x_m, y_m);
        let mut around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| at.offset(dx, dy)));
        around.any(|cell| self.obstacle_top_m(cell) >= crossing.ray_m)
    }

    /// Height of the obstacle in a cell according to the camera, metres; 0 if there is none.
    fn obstacle_top_m(&self, cell: Cell) -> f64 {
        match self.window.index(cell) {
            Some(index) if self.stored[index] > 0.0 && !self.holds_drop(index) => {
                f64::from(self.top_cm[index]) / 100.0
            }
            _ => 0.0,
        }
    }
}

/// A height as cells keep it, centimetres.
fn in_cm(height_m: f64) -> u8 {
    (height_m * 100.0).clamp(1.0, 254.0) as u8
}

/// Height of the lowest ray in the middle of the image at [`NEAR_M`] from the camera, metres above the floor.
fn lowest_near_m(camera: &CameraModel, t_odom_camera: &Pose3) -> f64 {
    let lowest = camera.ray(camera.width as f64 / 2.0, camera.height as f64 - 1.0);
    let ray = t_odom_camera.rotation * lowest;
    t_odom_camera.translation.vector.z + NEAR_M * ray.z / ray.x.hypot(ray.y)
}
