//! The simulator: rendering, laser scans, and preparation of a scene.

use hal::{CameraModel, DepthMap, LaserScan, Pose2, Pose3, ScanGeometry, camera_mount};
use obvhs::{BvhBuildParams, cwbvh::builder::build_cwbvh_from_tris, ray::Ray, ray::RayHit};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use simulator::laser::{self, LaserModel};
use simulator::nuisance::Nuisances;
use simulator::render::{Lighting, Renderer};
use simulator::scene::{LidarResponse, Material, Scene, Texture, Triangle, Vertex};

use crate::report::{Row, time, time_against};

const AREA: &str = "simulator";
const HALL_M: [f32; 3] = [12.0, 9.0, 2.6];
const VIEWS: usize = 24;

/// Measures a furnished hall of 200,000 triangles.
///
/// # Errors
/// This function returns no errors.
pub fn rows() -> anyhow::Result<Vec<Row>> {
    let scene = hall();
    let count = scene.triangles.len();
    let renderer = Renderer::new(&scene);
    let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
    let views: Vec<Pose3> = (0..VIEWS).map(view).collect();
    let light = Lighting::default();
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    let rays = SingleRays::new(&scene);
    let (ours, peer) = time_against(
        7,
        || {
            for pose in &views {
                renderer.render(&camera, pose, &[], &light, &mut rgb, &mut depth);
            }
        },
        || views.iter().map(|pose| rays.depth(&camera, pose)).sum::<f32>(),
    );
    let images = Row::per_second(
        AREA,
        format!("RGB + depth 640x192, {count} triangles"),
        VIEWS as f64,
        ours,
    )
    .peer("obvhs CWBVH, one ray per pixel, depth only", VIEWS as f64 / peer.median)
    .goal(40.0, 100.0)
    .note(format!("{} threads", rayon::current_num_threads()));

    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut scan = LaserScan::empty(ScanGeometry::UTM_30LX);
    let t_world_laser = Pose2::new(6.0, 4.5, 0.3).to_pose3() * Pose3::translation(0.0, 0.0, 0.2);
    let scans = time(51, || {
        laser::scan(
            &renderer,
            |_| t_world_laser,
            &[],
            &LaserModel::UTM_30LX,
            &mut rng,
            0,
            &mut scan,
        );
    });
    let mut image = vec![128; 640 * 192 * 3];
    let noise = time(51, || Nuisances::default().add_sensor_noise(&mut rng, &mut image));
    Ok(vec![
        images,
        Row::seconds(AREA, "laser scan, 1081 beams", scans),
        Row::seconds(AREA, "sensor noise 640x192", noise),
        Row::seconds(
            AREA,
            format!("hierarchy and mip chains, {count} triangles"),
            time(3, || Renderer::new(&scene)),
        ),
    ])
}

/// Camera poses 0.8 m above the floor on a circle, facing in all directions.
pub(crate) fn view(index: usize) -> Pose3 {
    let angle = index as f64 / VIEWS as f64 * std::f64::consts::TAU;
    let x = 6.0 + 2.5 * angle.cos();
    let y = 4.5 + 2.0 * angle.sin();
    Pose2::new(x, y, 5.0 * angle).to_pose3() * camera_mount(0.0, 0.8, 0.0)
}

/// Depth of the same image with one ray per pixel and obvhs's own traversal.
struct SingleRays {
    bvh: obvhs::cwbvh::CwBvh,
    triangles: Vec<obvhs::rt_triangle::RtTriangle>,
}

impl SingleRays {
    fn new(scene: &Scene) -> Self {
        let boxed: Vec<_> = scene
            .triangles
            .iter()
            .map(|t| {
                let [v0, v1, v2] = t.vertices.map(|v| v.position_m.into());
                obvhs::triangle::Triangle { v0, v1, v2 }
            })
            .collect();
        let bvh = build_cwbvh_from_tris(
            &boxed,
            BvhBuildParams::medium_build(),
            &mut std::time::Duration::default(),
        );
        let triangles =
            bvh.primitive_indices.iter().map(|&i| (&boxed[i as usize]).into()).collect();
        Self { bvh, triangles }
    }

    fn depth(&self, camera: &CameraModel, pose: &Pose3) -> f32 {
        (0..camera.height).into_par_iter().map(|v| self.row_depth(camera, pose, v)).sum()
    }

    /// Sum of the depths of row `v`.
    fn row_depth(&self, camera: &CameraModel, pose: &Pose3, v: usize) -> f32 {
        let origin = <[f32; 3]>::from(pose.translation.vector.cast::<f32>()).into();
        let depths = (0..camera.width).map(|u| {
            let direction = pose.rotation * camera.ray(u as f64, v as f64);
            let direction = <[f32; 3]>::from(direction.cast::<f32>()).into();
            let mut hit = RayHit::none();
            self.bvh.ray_traverse(Ray::new_inf(origin, direction), &mut hit, |ray, i| {
                self.triangles[i].intersect(ray)
            });
            if hit.t.is_finite() { hit.t } else { 0.0 }
        });
        depths.sum()
    }
}

/// Floor, walls and ceiling in tiles of 8 cm, and a hundred ellipsoids of a thousand triangles each.
pub(crate) fn hall() -> Scene {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut triangles = Vec::new();
    let [x, y, z] = HALL_M;
    for (corner, a, b, material) in [
        ([0.0; 3], [x, 0.0, 0.0], [0.0, y, 0.0], 0),
        ([0.0, 0.0, z], [x, 0.0, 0.0], [0.0, y, 0.0], 1),
        ([0.0; 3], [x, 0.0, 0.0], [0.0, 0.0, z], 1),
        ([0.0, y, 0.0], [x, 0.0, 0.0], [0.0, 0.0, z], 1),
        ([0.0; 3], [0.0, y, 0.0], [0.0, 0.0, z], 2),
        ([x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z], 2),
    ] {
        patch(&mut triangles, material, tiles(a), tiles(b), |u, v| {
            std::array::from_fn(|i| corner[i] + u * a[i] + v * b[i])
        });
    }
    for ball in 0..100 {
        let centre: [f32; 3] = std::array::from_fn(|i| rng.random_range(0.05..0.95) * HALL_M[i]);
        let radius = rng.random_range(0.1..0.4);
        patch(&mut triangles, ball % 3, 32, 16, |u, v| {
            let (sin, cos) = (u * std::f32::consts::TAU).sin_cos();
            let (s, c) = (v * std::f32::consts::PI).sin_cos();
            [centre[0] + radius * s * cos, centre[1] + radius * s * sin, centre[2] + radius * c]
        });
    }
    let textures = (0..3).map(|_| Texture {
        width: 1024,
        height: 1024,
        rgba: (0..1024 * 1024)
            .flat_map(|_| [rng.random_range(90..220), rng.random_range(90..200), 120, 255])
            .collect(),
    });
    let materials = (0..3).map(|texture| Material {
        name: String::new(),
        base_color: [1.0; 3],
        texture: Some(texture),
        alpha_cutoff: None,
        emissive: [0.0; 3],
        lidar: LidarResponse::default(),
    });
    let textures = textures.collect();
    Scene { triangles, materials: materials.collect(), textures }
}

/// Number of tiles along an edge.
fn tiles(edge: [f32; 3]) -> usize {
    (edge.iter().sum::<f32>() / 0.08) as usize
}

/// Adds a surface over the unit square, in `columns` x `rows` pairs of triangles.
fn patch(
    out: &mut Vec<Triangle>,
    material: u32,
    columns: usize,
    rows: usize,
    at: impl Fn(f32, f32) -> [f32; 3],
) {
    for (i, j) in (0..columns).flat_map(|i| (0..rows).map(move |j| (i, j))) {
        let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
        let [a, b, c, d] = corners.map(|(i, j)| {
            let u = i as f32 / columns as f32;
            let v = j as f32 / rows as f32;
            Vertex { position_m: at(u, v), uv: [u * 4.0, v * 2.0], ambient: 0.9 }
        });
        out.extend([[a, b, c], [a, c, d]].map(|vertices| Triangle { vertices, material }));
    }
}
