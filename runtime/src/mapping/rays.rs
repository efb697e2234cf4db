//! The rays of a camera's pixels, projected onto the floor plane.

use hal::{CameraModel, Pose3};

use super::{Cell, MapConfig, MapError};

/// Bearing of rays that lie outside of the bearing bins, as rays of a tilted camera may.
const NO_BEARING: u32 = u32::MAX;
/// Directions and heights are rounded to this many steps per unit, so that the table stays valid
/// while the camera only rotates about the vertical and moves on the floor. The rounding of 1e-6 is
/// 0.02 mm at a distance of 20 m.
const STEPS_PER_UNIT: f64 = 1_048_576.0;

/// The ray of a used pixel. Lengths are those for one metre of z-depth.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    /// Component along the camera's heading in the plane.
    pub forward: f32,
    /// Component to the right of the heading.
    pub right: f32,
    /// Vertical component, positive upwards.
    pub rise: f32,
    /// Length in the plane.
    pub range: f32,
    /// `rise / range`.
    pub slope: f32,
    /// Range at which the ray meets the floor or leaves the height band upwards, metres (not per
    /// metre of depth).
    pub leaves_band_m: f32,
    /// Index of the bearing bin, or [`NO_BEARING`].
    pub bearing: u32,
}

/// The rays of all used pixels, row by row. They depend on the camera's intrinsics, tilt and
/// height, but not on its position and heading in the plane.
#[derive(Debug, Clone, Default)]
pub(super) struct RayTable {
    key: Option<(CameraModel, [[i32; 3]; 3], i32)>,
    pub rays: Vec<Ray>,
    /// Number of bearing bins.
    pub bearings: usize,
}

impl RayTable {
    /// Recomputes the table for `view` unless it is up to date.
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
        let [forward, sideways, rise] = [0, 1, 2]
            .map(|part| right[part] * direction.x + down[part] * direction.y + ahead[part]);
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

/// The indices of the used rows or columns out of `size`: the middle one of each group of `stride`.
pub(super) fn used(size: usize, stride: usize) -> impl Iterator<Item = usize> {
    (stride / 2..size).step_by(stride)
}

fn rounded(value: f64) -> i32 {
    (value * STEPS_PER_UNIT).round() as i32
}

/// A camera pose relative to the square of cells around it.
#[derive(Debug)]
pub(super) struct View {
    /// The cell of the square with the lowest column and row.
    pub corner: Cell,
    /// Position of the camera relative to `corner`, metres.
    pub x_m: f32,
    pub y_m: f32,
    pub height_m: f32,
    /// Unit vector of the optical axis in the plane.
    pub heading: [f32; 2],
    /// The camera's x, y and z axes, each as components along the heading, to the right of it and
    /// up, in 1 / [`STEPS_PER_UNIT`].
    axes: [[i32; 3]; 3],
    height: i32,
}

impl View {
    /// The view of the square that extends `half` cells in each direction from the camera's cell.
    pub fn new(config: &MapConfig, half: usize, t_odom_camera: &Pose3) -> Result<Self, MapError> {
        let position = t_odom_camera.translation.vector;
        let rotation = t_odom_camera.rotation.to_rotation_matrix();
        let ahead = rotation.matrix().column(2);
        let level = ahead.x.hypot(ahead.y);
        if level < 0.1 {
            return Err(MapError::CameraVertical);
        }
        let hx = ahead.x / level;
        let hy = ahead.y / level;
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
