use super::*;
use crate::perception::census::CensusImage;
use crate::perception::sweep::Reference;
use crate::perception::test_scene::noise;
use crate::perception::{CoarseConfig, CoarseDepth, DepthEstimate};
use hal::{CameraMount, ImageView, PixelFormat};
use nalgebra::{Point3, Vector3};

/// The wall ahead of the start.
const WALL_M: f64 = 6.0;
/// Period of the floor's pattern.
const TILE_M: f64 = 0.25;
/// Where the upper floor ends, ahead of the start.
const EDGE_M: f64 = 2.2;
/// Frames of a drive, and the distance from one to the next.
const FRAMES: u32 = 14;
const STEP_M: f64 = 0.03;

/// A floor, a lower floor behind its edge, and the wall.
#[derive(Clone, Copy)]
struct Scene {
    upper: fn(&Point3<f64>) -> f64,
    drop_m: f64,
}

const TILES_BEFORE_STAIRS: Scene = Scene { upper: tiles, drop_m: 1.0 };

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

impl Scene {
    /// Brightness along a ray.
    fn shade(&self, t_odom_camera: &Pose3, ray: &Vector3<f64>) -> f64 {
        if ray.z < 0.0 {
            let floor = meet(t_odom_camera, ray, 0.0);
            if floor.x < EDGE_M {
                return (self.upper)(&floor);
            }
            let lower = meet(t_odom_camera, ray, -self.drop_m);
            if lower.x < WALL_M {
                return noisy(&lower);
            }
        }
        let origin = t_odom_camera.translation.vector;
        let wall = origin + ray * ((WALL_M - origin.x) / ray.x);
        noisy(&Point3::new(wall.y, wall.z, 0.0))
    }

    fn render(&self, t_odom_camera: &Pose3) -> Vec<u8> {
        let camera = camera();
        let mut image = Vec::with_capacity(camera.width * camera.height);
        for v in 0..camera.height {
            for u in 0..camera.width {
                // Sixteen samples per pixel, against aliasing.
                let sum: f64 = (0..16)
                    .map(|sample| {
                        let u = u as f64 - 0.375 + 0.25 * f64::from(sample % 4);
                        let v = v as f64 - 0.375 + 0.25 * f64::from(sample / 4);
                        self.shade(t_odom_camera, &(t_odom_camera.rotation * camera.ray(u, v)))
                    })
                    .sum();
                image.push((sum / 16.0) as u8);
            }
        }
        image
    }

    /// What a robot sees at the end of a drive towards the edge. It believes that its camera is rotated by `error`.
    fn drive(self, has_floor: bool, error: Pose3) -> Seen {
        let camera = camera();
        let config = CoarseConfig::default();
        let mut engine = CoarseDepth::new(config, camera).unwrap().with_floor(has_floor);
        for frame in 0..FRAMES {
            let at = pose(STEP_M * f64::from(frame));
            let image = self.render(&at);
            let frame =
                ImageView::new(camera.width, camera.height, PixelFormat::Gray8, &image).unwrap();
            let _ = engine.estimate(frame, &(at * error));
        }
        Seen(engine.last().clone())
    }
}

struct Seen(DepthEstimate);

impl Seen {
    /// Shares of the pixels between two places on the plane of the floor, metres ahead of the start: with depth, and with depth that is
    /// clearly behind the floor.
    fn shares(&self, [from_m, to_m]: [f64; 2]) -> [f64; 2] {
        let camera = camera();
        let at = pose(STEP_M * f64::from(FRAMES - 1));
        let floor = FloorPlane::new(&at, &camera).unwrap();
        let mut pixels = 0;
        let mut known = 0;
        let mut behind = 0;
        for (index, depth_m) in self.0.depth.values().iter().enumerate() {
            let u = (index % camera.width) as f32;
            let v = (index / camera.width) as f32;
            let ray = at.rotation * camera.ray(f64::from(u), f64::from(v));
            if ray.z < 0.0 && (from_m..to_m).contains(&meet(&at, &ray, 0.0).x) {
                pixels += 1;
                known += u32::from(*depth_m > 0.0);
                behind += u32::from(*depth_m > 0.0 && floor.is_before(u, v, 1.0 / depth_m));
            }
        }
        [known, behind].map(|count| f64::from(count) / f64::from(pixels))
    }
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
    assert!(!floor.is_before(160.0, 0.0, 0.05), "no floor is before what is above the horizon");
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
    let tiles_m = [1.5, 2.0];
    let [_, without] = TILES_BEFORE_STAIRS.drive(false, Pose3::identity()).shares(tiles_m);
    let [_, with] = TILES_BEFORE_STAIRS.drive(true, Pose3::identity()).shares(tiles_m);
    assert!(without > 0.5 && with < 0.1, "{without} {with}");
}

#[test]
fn the_drop_behind_the_tiles_stays_a_drop() {
    let stairs_m = [2.3, 3.5];
    let [_, without] = TILES_BEFORE_STAIRS.drive(false, Pose3::identity()).shares(stairs_m);
    let [_, with] = TILES_BEFORE_STAIRS.drive(true, Pose3::identity()).shares(stairs_m);
    assert!(without > 0.8 && with > 0.95 * without, "{without} {with}");
}

#[test]
fn most_of_a_step_of_17_cm_stays_a_drop() {
    let step = Scene { upper: noisy, drop_m: 0.17 };
    let behind_edge_m = [2.3, 3.5];
    let [_, without] = step.drive(false, Pose3::identity()).shares(behind_edge_m);
    let [_, with] = step.drive(true, Pose3::identity()).shares(behind_edge_m);
    assert!(without > 0.9 && with > 0.75 * without, "{without} {with}");
}

#[test]
fn a_camera_that_is_mounted_1_degree_wrong_loses_no_floor() {
    let error = Pose3::rotation(Vector3::x() * 1_f64.to_radians());
    let scene = Scene { upper: noisy, drop_m: 1.0 };
    let [without, _] = scene.drive(false, error).shares([1.3, 2.1]);
    let [with, _] = scene.drive(true, error).shares([1.3, 2.1]);
    assert!(without > 0.5 && with > 0.95 * without, "{without} {with}");
}
