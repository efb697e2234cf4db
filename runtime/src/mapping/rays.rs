//! Where the pixels of a camera look, seen from above.

use hal::{CameraModel, Pose3};

use super::{Cell, MapConfig, MapError};

/// The bearing of rays that leave the picture's fan sideways, as rays of a tilted camera may.
const NO_BEARING: u32 = u32::MAX;
/// Directions and heights are rounded to this many steps per unit, so that a camera that only turns and drives keeps its
/// table: 1e-6 of a distance of 20 m is nothing.
const STEPS_PER_UNIT: f64 = 1_048_576.0;

/// A used pixel's ray, for one metre of z-depth.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    /// Along the camera's heading in the plane.
    pub forward: f32,
    /// To the right of it.
    pub right: f32,
    /// Up.
    pub rise: f32,
    /// In the plane, whatever the direction.
    pub range: f32,
    /// Height per range.
    pub slope: f32,
    /// Range at which the ray meets the floor or leaves the height band upwards, metres (not per depth).
    pub leaves_band_m: f32,
    /// Bin of its direction in the plane.
    pub bearing: u32,
}

/// The rays of all used pixels, row by row. They depend on intrinsics, tilt and height of the camera, not on where it stands.
#[derive(Debug, Clone, Default)]
pub(super) struct RayTable {
    key: Option<(CameraModel, [[i32; 3]; 3], i32)>,
    pub rays: Vec<Ray>,
    /// Bins of direction.
    pub bearings: usize,
}

impl RayTable {
    /// Makes this the table of `view`, if it is not already.
    pub fn prepare(&mut self, config: &MapConfig, camera: &CameraModel, view: &View) {
        let key = (*camera, view.axes, view.height);
        if self.key == Some(key) {
            return;
        }
        self.key = Some(key);
        self.bearings = camera.width.div_ceil(config.stride_u);
        self.rays.clear();
        for v in used(camera.height, config.stride_v) {
            for u in used(camera.width, config.stride_u) {
                self.rays.push(self.ray(config, camera, view, (u, v)));
            }
        }
    }

    fn ray(
        &self,
        config: &MapConfig,
        camera: &CameraModel,
        view: &View,
        (u, v): (usize, usize),
    ) -> Ray {
        let direction = camera.ray(u as f64, v as f64);
        let [right, down, ahead] =
            view.axes.map(|axis| axis.map(|steps| f64::from(steps) / STEPS_PER_UNIT));
        let along =
            |part: usize| right[part] * direction.x + down[part] * direction.y + ahead[part];
        let (forward, sideways, rise) = (along(0), along(1), along(2));
        let range = forward.hypot(sideways);
        let slope = rise / range;
        let height_m = f64::from(view.height) / STEPS_PER_UNIT;
        let leaves_band_m = if slope < 0.0 {
            height_m / -slope
        } else {
            (f64::from(config.band_max_m) - height_m) / slope.max(1e-9)
        };
        let bin =
            ((camera.cx + camera.fx * sideways / forward + 0.5) / config.stride_u as f64).floor();
        let in_fan = forward > 0.0 && bin >= 0.0 && bin < self.bearings as f64;
        Ray {
            forward: forward as f32,
            right: sideways as f32,
            rise: rise as f32,
            range: range as f32,
            slope: slope as f32,
            leaves_band_m: leaves_band_m.max(0.0) as f32,
            bearing: if in_fan { bin as u32 } else { NO_BEARING },
        }
    }
}

/// The used rows or columns of `size`: the middle one of each group of `stride`.
pub(super) fn used(size: usize, stride: usize) -> impl Iterator<Item = usize> {
    (stride / 2..size).step_by(stride)
}

/// A camera over a square of cells.
#[derive(Debug)]
pub(super) struct View {
    /// The square's first cell.
    pub corner: Cell,
    /// The camera in the square, metres.
    pub x_m: f32,
    pub y_m: f32,
    pub height_m: f32,
    /// Heading of the optical axis, a unit vector.
    pub heading: [f32; 2],
    /// The camera's x, y and z axis along its heading, to the right of it and up; and its height; rounded.
    axes: [[i32; 3]; 3],
    height: i32,
}

impl View {
    /// The view over the square that reaches `half` cells from the camera's own.
    pub fn new(config: &MapConfig, half: usize, t_odom_camera: &Pose3) -> Result<Self, MapError> {
        let position = t_odom_camera.translation.vector;
        let rotation = t_odom_camera.rotation.to_rotation_matrix();
        let ahead = rotation.matrix().column(2);
        let level = ahead.x.hypot(ahead.y);
        if level < 0.1 {
            return Err(MapError::CameraVertical);
        }
        let (hx, hy) = (ahead.x / level, ahead.y / level);
        let rounded = |value: f64| (value * STEPS_PER_UNIT).round() as i32;
        let axes = [0, 1, 2].map(|axis| {
            let axis = rotation.matrix().column(axis);
            [axis.x * hx + axis.y * hy, axis.x * hy - axis.y * hx, axis.z].map(rounded)
        });
        let corner = Cell::containing(position.x, position.y, config.cell_m)
            .offset(-(half as i32), -(half as i32));
        Ok(Self {
            corner,
            x_m: (position.x - f64::from(corner.x) * config.cell_m) as f32,
            y_m: (position.y - f64::from(corner.y) * config.cell_m) as f32,
            height_m: position.z as f32,
            heading: [hx as f32, hy as f32],
            axes,
            height: rounded(position.z),
        })
    }
}
