//! A textured plane whose images and depth are known exactly.

use hal::{CameraModel, Pose3};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// The plane `z = DISTANCE_M + SLOPE * x` of the world.
const DISTANCE_M: f64 = 2.5;
const SLOPE: f64 = 0.3;

/// The pose of a camera at `position_m` that is rotated to its right by `yaw_rad`.
pub fn pose(position_m: [f64; 3], yaw_rad: f64) -> Pose3 {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad);
    Pose3::from_parts(Translation3::from(position_m), rotation)
}

/// True z-depth of a pixel, metres.
pub fn depth_m(camera: &CameraModel, t_world_camera: &Pose3, u: f64, v: f64) -> f64 {
    let origin = t_world_camera.translation.vector;
    let ray = t_world_camera.rotation * camera.ray(u, v);
    (DISTANCE_M + SLOPE * origin.x - origin.z) / (ray.z - SLOPE * ray.x)
}

/// A grey image of the plane with an exposure of `gain` and `offset`.
pub fn render(camera: &CameraModel, t_world_camera: &Pose3, gain: f64, offset: f64) -> Vec<u8> {
    let mut image = Vec::with_capacity(camera.width * camera.height);
    for v in 0..camera.height {
        for u in 0..camera.width {
            let mut sum = 0.0;
            // Four samples per pixel, against aliasing.
            for (du, dv) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
                let u = u as f64 + du;
                let v = v as f64 + dv;
                let point =
                    t_world_camera * camera.unproject(u, v, depth_m(camera, t_world_camera, u, v));
                sum += texture(&point);
            }
            image.push((sum / 4.0 * gain + offset).clamp(0.0, 255.0) as u8);
        }
    }
    image
}

/// Smooth noise at three scales, 0 to 160.
fn texture(point: &Point3<f64>) -> f64 {
    160.0 * (0.5 * noise(point, 0.25, 1) + 0.3 * noise(point, 0.1, 2) + 0.2 * noise(point, 0.05, 3))
}

/// Noise on a grid of cells of `cell_m`, 0 to 1.
pub fn noise(point: &Point3<f64>, cell_m: f64, seed: u32) -> f64 {
    let x = point.x / cell_m;
    let y = point.y / cell_m;
    let i = x.floor();
    let j = y.floor();
    let fx = smooth(x - i);
    let fy = smooth(y - j);
    let [left, right] = [i as i32, (i + 1.0) as i32];
    let [top, bottom] = [j as i32, (j + 1.0) as i32];
    let upper = hash(left, top, seed) * (1.0 - fx) + hash(right, top, seed) * fx;
    let lower = hash(left, bottom, seed) * (1.0 - fx) + hash(right, bottom, seed) * fx;
    upper * (1.0 - fy) + lower * fy
}

fn smooth(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

fn hash(i: i32, j: i32, seed: u32) -> f64 {
    let mut h = (i as u32).wrapping_mul(0x9E37_79B1)
        ^ (j as u32).wrapping_mul(0x85EB_CA77)
        ^ seed.wrapping_mul(0xC2B2_AE3D);
    for _ in 0..2 {
        h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    }
    f64::from(h >> 8) / f64::from(1 << 24)
}
