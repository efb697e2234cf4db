//! A textured plane whose pictures and depth are known exactly.

use hal::{CameraModel, Pose3};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// The plane `z = DISTANCE_M + SLOPE * x` of the world.
const DISTANCE_M: f64 = 2.5;
const SLOPE: f64 = 0.3;

/// A small camera with 90 degrees.
pub fn camera() -> CameraModel {
    CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2)
}

/// A camera in the world, turned to its right by `yaw_rad`.
pub fn pose(position_m: [f64; 3], yaw_rad: f64) -> Pose3 {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad);
    Pose3::from_parts(Translation3::from(position_m), turn)
}

/// True z-depth of a pixel of [`camera`].
pub fn slanted_depth_m(t_world_camera: &Pose3, u: f64, v: f64) -> f64 {
    depth_m(&camera(), t_world_camera, u, v)
}

/// True z-depth of a pixel.
pub fn depth_m(camera: &CameraModel, t_world_camera: &Pose3, u: f64, v: f64) -> f64 {
    let origin = t_world_camera.translation.vector;
    let ray = t_world_camera.rotation * camera.ray(u, v);
    (DISTANCE_M + SLOPE * origin.x - origin.z) / (ray.z - SLOPE * ray.x)
}

/// A grey picture of the plane; `gain` and `offset` are those of the exposure.
pub fn render(camera: &CameraModel, t_world_camera: &Pose3, gain: f64, offset: f64) -> Vec<u8> {
    let mut picture = Vec::with_capacity(camera.width * camera.height);
    for v in 0..camera.height {
        for u in 0..camera.width {
            let mut sum = 0.0;
            // Four samples for one pixel, against aliasing.
            for (du, dv) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
                let (u, v) = (u as f64 + du, v as f64 + dv);
                let point =
                    t_world_camera * camera.unproject(u, v, depth_m(camera, t_world_camera, u, v));
                sum += texture(&point);
            }
            picture.push((sum / 4.0 * gain + offset).clamp(0.0, 255.0) as u8);
        }
    }
    picture
}

/// Smooth noise in three sizes, 0 to 160.
fn texture(point: &Point3<f64>) -> f64 {
    let noise = |cell_m: f64, seed: u32| {
        let (x, y) = (point.x / cell_m, point.y / cell_m);
        let (i, j) = (x.floor(), y.floor());
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        let (fx, fy) = (smooth(x - i), smooth(y - j));
        let corner = |di: f64, dj: f64| hash((i + di) as i32, (j + dj) as i32, seed);
        let upper = corner(0.0, 0.0) * (1.0 - fx) + corner(1.0, 0.0) * fx;
        let lower = corner(0.0, 1.0) * (1.0 - fx) + corner(1.0, 1.0) * fx;
        upper * (1.0 - fy) + lower * fy
    };
    160.0 * (0.5 * noise(0.25, 1) + 0.3 * noise(0.1, 2) + 0.2 * noise(0.05, 3))
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
