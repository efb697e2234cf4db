use super::*;
use crate::perception::census::CensusImage;
use crate::perception::sweep::Reference;
use crate::perception::test_scene::noise;
use crate::perception::{CoarseConfig, CoarseDepth};
use hal::{CameraMount, ImageView, PixelFormat};
use nalgebra::{Point3, Vector3};

/// The wall ahead of the start.
const WALL_M: f64 = 6.0;
/// Period of the floor's pattern.
const TILE_M: f64 = 0.25;
/// Where the tiles end, ahead of the start. The floor behind is lower by [`DROP_M`].
const EDGE_M: f64 = 2.2;
const DROP_M: f64 = 1.0;

fn camera() -> CameraModel {
    CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
}

/// The camera of the default robot, ahead of the start.
fn pose(ahead_m: f64) -> Pose3 {
    Pose3::translation(ahead_m, 0.0, 0.0) * CameraMount::default().t_base_camera()
}

/// Where a ray from the camera meets the plane z = `height_m`.
fn meet(t_odom_camera: &Pose3, ray: &Vector3<f64>, height_m: f64) -> Point3<f64> {
    let origin = t_odom_camera.translation.vector;
    Point3::from(origin + ray * ((height_m - origin.z) / ray.z))
}

/// Tiles that are all alike.
fn tiles(point: &Point3<f64>) -> f64 {
    let along = (point.x / TILE_M).rem_euclid(1.0);
    let across = (point.y / TILE_M).rem_euclid(1.0);
    let is_joint = along < 0.2 || across < 0.2;
    if is_joint { 40.0 } else { 130.0 + 30.0 * along - 20.0 * across }
}

fn noisy(point: &Point3<f64>) -> f64 {
    80.0 * noise(point, 0.2, 1) + 60.0 * noise(point, 0.05, 2)
}

/// Brightness along a ray: tiles up to the edge, then a lower floor that is not tiled, and the wall.
fn shade(t_odom_camera: &Pose3, ray: &Vector3<f64>) -> f64 {
    if ray.z < 0.0 {
        let floor = meet(t_odom_camera, ray, 0.0);
        if floor.x < EDGE_M {
            return tiles(&floor);
        }
        let lower = meet(t_odom_camera, ray, -DROP_M);
        if lower.x < WALL_M {
            return noisy(&lower);
        }
    }
    let origin = t_odom_camera.translation.vector;
    let wall = origin + ray * ((WALL_M - origin.x) / ray.x);
    noisy(&Point3::new(wall.y, wall.z, 0.0))
}

fn render(t_odom_camera: &Pose3) -> Vec<u8> {
    let camera = camera();
    let mut image = Vec::with_capacity(camera.width * camera.height);
    for v in 0..camera.height {
        for u in 0..camera.width {
            // Sixteen samples per pixel, against aliasing.
            let sum: f64 = (0..16)
                .map(|sample| {
                    let u = u as f64 - 0.375 + 0.25 * f64::from(sample % 4);
                    let v = v as f64 - 0.375 + 0.25 * f64::from(sample / 4);
                    shade(t_odom_camera, &(t_odom_camera.rotation * camera.ray(u, v)))
                })
                .sum();
            image.push((sum / 16.0) as u8);
        }
    }
    image
}

/// Share of the pixels with depth whose depth is behind the floor, between two places on the floor, metres ahead of the start.
fn share_behind(has_floor: bool, [from_m, to_m]: [f64; 2]) -> f64 {
    let camera = camera();
    let mut engine =
        CoarseDepth::new(CoarseConfig::default(), camera).unwrap().with_floor(has_floor);
    for step in 0..14 {
        let at = pose(0.03 * f64::from(step));
        let image = render(&at);
        let frame =
            ImageView::new(camera.width, camera.height, PixelFormat::Gray8, &image).unwrap();
        let _ = engine.estimate(frame, &at);
    }
    let at = pose(0.03 * 13.0);
    let floor = FloorPlane::new(&at, &camera).unwrap();
    let mut pixels = 0;
    let mut behind = 0;
    for (index, depth_m) in engine.last().depth.values().iter().enumerate() {
        let u = (index % camera.width) as f32;
        let v = (index / camera.width) as f32;
        let ray = at.rotation * camera.ray(f64::from(u), f64::from(v));
        let is_between =
            ray.z < 0.0 && (from_m..to_m).contains(&meet(&at, &ray, 0.0).x) && *depth_m > 0.0;
        pixels += u32::from(is_between);
        let is_behind = FloorPlane::is_behind(floor.inverse_depth(u, v), 1.0 / depth_m);
        behind += u32::from(is_between && is_behind);
    }
    assert!(pixels > 500, "{pixels} pixels with depth");
    f64::from(behind) / f64::from(pixels)
}

#[test]
fn its_inverse_depth_is_that_of_the_points_where_rays_meet_the_floor() {
    let camera = camera();
    let at = pose(1.0);
    let floor = FloorPlane::new(&at, &camera).unwrap();
    for (u, v) in [(0.0, 95.0), (160.0, 60.0), (300.0, 80.0)] {
        let point = meet(&at, &(at.rotation * camera.ray(u, v)), 0.0);
        let depth_m = (at.inverse() * point).z;
        let inverse_depth = floor.inverse_depth(u as f32, v as f32);
        assert!((f64::from(inverse_depth) * depth_m - 1.0).abs() < 1e-4, "{u} {v}");
    }
    assert!(floor.inverse_depth(160.0, 0.0) < 0.0, "the ray goes up");
}

#[test]
fn a_camera_on_the_floor_or_below_it_sees_no_floor() {
    for height_m in [0.0, -0.5, f64::NAN] {
        assert!(FloorPlane::new(&Pose3::translation(0.0, 0.0, height_m), &camera()).is_none());
    }
}

#[test]
fn a_patch_that_is_laid_down_moves_as_its_points_on_the_floor_do() {
    let camera = camera();
    let now = pose(0.3);
    let before = pose(0.0);
    let mut census = CensusImage::default();
    census.width = camera.width;
    census.height = camera.height;
    let reference = Reference::new(&census, &(before.inverse() * now), &camera);
    let floor = FloorPlane::new(&now, &camera).unwrap();
    let (u, v) = (200.0, 70.0);
    let point = reference.observe(u, v, floor.inverse_depth(u, v)).unwrap();
    let patch = floor.lay_down(reference.observe_patch(point));
    let seen = |u: f64, v: f64| {
        let point = meet(&now, &(now.rotation * camera.ray(u, v)), 0.0);
        camera.project(&(before.inverse() * point)).unwrap()
    };
    let here = seen(200.0, 70.0);
    for (along, there) in [(patch.along_u, seen(200.1, 70.0)), (patch.along_v, seen(200.0, 70.1))] {
        assert!((f64::from(along[0]) - 10.0 * (there.0 - here.0)).abs() < 0.02);
        assert!((f64::from(along[1]) - 10.0 * (there.1 - here.1)).abs() < 0.02);
    }
}

#[test]
fn tiles_that_match_a_period_too_far_are_no_drop() {
    let before_edge_m = [1.5, 2.0];
    let without = share_behind(false, before_edge_m);
    let with = share_behind(true, before_edge_m);
    assert!(without > 0.9 && with < 0.1, "{without} {with}");
}

#[test]
fn the_drop_behind_the_tiles_stays_a_drop() {
    let share = share_behind(true, [2.5, 3.5]);
    assert!(share > 0.99, "{share}");
}
