use hal::{CameraModel, DepthMap, Pose2, Pose3, camera_mount};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::body::Capsule;
use crate::people::Person;
use crate::scene::{LidarResponse, Material, Scene, Texture, Triangle, Vertex};

/// A parallelogram `corner + a * u + b * v` with texture coordinates 0 to 1.
pub(crate) fn quad(corner: [f32; 3], a: [f32; 3], b: [f32; 3], material: u32) -> [Triangle; 2] {
    let [p, q, r, s] = [
        quad_vertex(0.0, 0.0, corner, a, b),
        quad_vertex(1.0, 0.0, corner, a, b),
        quad_vertex(1.0, 1.0, corner, a, b),
        quad_vertex(0.0, 1.0, corner, a, b),
    ];
    [Triangle { vertices: [p, q, r], material }, Triangle { vertices: [p, r, s], material }]
}

fn quad_vertex(u: f32, v: f32, corner: [f32; 3], a: [f32; 3], b: [f32; 3]) -> Vertex {
    Vertex {
        position_m: std::array::from_fn(|i| corner[i] + u * a[i] + v * b[i]),
        uv: [u, v],
        ambient: 1.0,
    }
}

/// The inside of a box with one corner in the origin.
pub(crate) fn room(size: [f32; 3], material: u32) -> Vec<Triangle> {
    let [x, y, z] = size;
    let mut triangles = Vec::new();
    for far in [[0.0; 3], size] {
        let sign = if far[0] > 0.0 { -1.0_f32 } else { 1.0 };
        let edges = [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
        let [along_x, along_y, along_z] = edges.map(|edge| edge.map(|c| c * sign));
        triangles.extend(quad(far, along_x, along_y, material));
        triangles.extend(quad(far, along_y, along_z, material));
        triangles.extend(quad(far, along_z, along_x, material));
    }
    triangles
}

pub(crate) fn plain(base_color: [f32; 3]) -> Material {
    Material {
        name: "plain".into(),
        base_color,
        texture: None,
        alpha_cutoff: None,
        emissive: [0.0; 3],
        lidar: LidarResponse::Diffuse,
    }
}

fn textured(alpha_cutoff: Option<f32>) -> Material {
    Material { texture: Some(0), alpha_cutoff, ..plain([1.0; 3]) }
}

/// Texels that differ from all their neighbours, none brighter than the shoulder of the tone curve.
fn noise_texture(width: u32, height: u32) -> Texture {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let rgba = (0..width * height)
        .flat_map(|_| [rng.random_range(0..230), rng.random_range(0..230), 90, 255]);
    Texture { width, height, rgba: rgba.collect() }
}

fn photograph(
    scene: &Scene,
    camera: &CameraModel,
    pose: &Pose3,
    light: &Lighting,
) -> (Vec<u8>, DepthMap) {
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    Renderer::new(scene).render(camera, pose, &[], light, &mut rgb, &mut depth);
    (rgb, depth)
}

/// A camera 0.8 m above the floor.
fn standing(x_m: f64, y_m: f64, yaw_rad: f64, pitch_down_rad: f64) -> Pose3 {
    Pose2::new(x_m, y_m, yaw_rad).to_pose3() * camera_mount(0.0, 0.8, pitch_down_rad)
}

fn wide() -> CameraModel {
    CameraModel::pinhole(160, 48, std::f64::consts::FRAC_PI_2)
}

#[test]
fn a_plane_has_the_depth_that_geometry_gives_it() {
    // The wall y = 3, seen from several positions and angles.
    let scene = Scene {
        triangles: quad([-50.0, 3.0, -50.0], [100.0, 0.0, 0.0], [0.0, 0.0, 100.0], 0).into(),
        materials: vec![plain([0.5; 3])],
        textures: vec![],
    };
    let camera = wide();
    for (x, y, yaw, pitch) in [
        (0.0, 0.0, 90.0, 0.0),
        (1.0, 2.5, 60.0, 10.0),
        (-2.0, -4.0, 130.0, -15.0),
        (0.3, 2.9, 45.0, 0.0),
    ] {
        let pose = standing(x, y, f64::to_radians(yaw), f64::to_radians(pitch));
        let (_, depth) = photograph(&scene, &camera, &pose, &Lighting::default());
        let mut compared = 0;
        for (v, u) in (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| (v, u))) {
            let ray = pose.rotation * camera.ray(u as f64, v as f64);
            let expected = (3.0 - pose.translation.y) / ray.y;
            if expected > 0.0 && expected < 20.0 {
                let got = f64::from(depth.get(u, v).unwrap());
                assert!((got / expected - 1.0).abs() < 2e-5, "({u}, {v}): {got} for {expected}");
                compared += 1;
            }
        }
        assert!(compared > 3000, "only {compared} pixels show the wall");
    }
}

#[test]
fn a_quad_seen_head_on_shows_its_texels() {
    // 32 x 24 texels, one per pixel: at a depth of f metres, a pixel is 1 m wide.
    let width = 32;
    let height = 24;
    let focal = 16.0;
    let texture = noise_texture(width, height);
    let camera = CameraModel::pinhole(width as usize, height as usize, std::f64::consts::FRAC_PI_2);
    assert!((camera.fx - focal).abs() < 1e-9);
    let w = width as f32;
    let h = height as f32;
    // The identity pose looks along z with x right and y down, as the texture does.
    let scene = Scene {
        triangles: quad([-w / 2.0, -h / 2.0, focal as f32], [w, 0.0, 0.0], [0.0, h, 0.0], 0).into(),
        materials: vec![textured(None)],
        textures: vec![texture.clone()],
    };
    let (rgb, _) = photograph(&scene, &camera, &Pose3::identity(), &Lighting::flat());
    for (shown, texel) in rgb.chunks_exact(3).zip(texture.rgba.chunks_exact(4)) {
        for channel in 0..3 {
            assert!(shown[channel].abs_diff(texel[channel]) <= 2, "{shown:?} for {texel:?}");
        }
    }
}

#[test]
fn a_distant_texture_appears_as_its_average() {
    // 256 texels per pixel: a checkerboard of black and white must become grey, not noise.
    let rgba = (0..256 * 256)
        .flat_map(|i| if (i / 256 + i) % 2 == 0 { [0, 0, 0, 255] } else { [220, 220, 220, 255] });
    let scene = Scene {
        triangles: quad([-16.0, -16.0, 16.0], [32.0, 0.0, 0.0], [0.0, 32.0, 0.0], 0)
            .map(|t| Triangle {
                vertices: t.vertices.map(|v| Vertex { uv: [v.uv[0] * 32.0, v.uv[1] * 32.0], ..v }),
                ..t
            })
            .into(),
        materials: vec![textured(None)],
        textures: vec![Texture { width: 256, height: 256, rgba: rgba.collect() }],
    };
    let camera = CameraModel::pinhole(32, 32, std::f64::consts::FRAC_PI_2);
    let (rgb, _) = photograph(&scene, &camera, &Pose3::identity(), &Lighting::flat());
    let expected = light::linear_to_srgb(light::srgb_to_linear(220) / 2.0);
    assert!(rgb.iter().all(|&byte| byte.abs_diff(expected) <= 2), "{:?}", &rgb[..12]);
}

#[test]
fn rotating_the_camera_moves_the_image_by_the_homography() {
    // A camera that only rotates sees the same light along the same rays. The test compares pixels
    // that map close to pixel centres.
    let scene = Scene {
        triangles: room([8.0, 6.0, 2.6], 0),
        materials: vec![textured(None)],
        textures: vec![noise_texture(8, 8)], // coarse texels: filtering does not matter
    };
    let renderer = Renderer::new(&scene);
    let camera = CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2);
    let poses = [standing(3.0, 2.0, 0.3, 0.0), standing(3.0, 2.0, 0.5, 0.1)];
    let [first, second] = poses.map(|pose| {
        let mut rgb = Vec::new();
        let mut depth = DepthMap::none(0, 0);
        renderer.render(&camera, &pose, &[], &Lighting::default(), &mut rgb, &mut depth);
        rgb
    });
    let mut compared = 0_u32;
    let mut sum = 0_u32;
    for (v, u) in (0..96).flat_map(|v| (0..320).map(move |u| (v, u))) {
        let ray = poses[1].rotation.inverse()
            * (poses[0].rotation * camera.ray(f64::from(u), f64::from(v)));
        let Some((x, y)) = camera.project(&Point3::from(ray)) else { continue };
        if is_near_pixel_center(x)
            && is_near_pixel_center(y)
            && (0.0..319.5).contains(&x)
            && (0.0..95.5).contains(&y)
        {
            let a = (v * 320 + u) as usize * 3;
            let b = (y.round() as usize * 320 + x.round() as usize) * 3;
            sum += (0..3).map(|c| u32::from(first[a + c].abs_diff(second[b + c]))).max().unwrap();
            compared += 1;
        }
    }
    assert!(compared > 100, "{compared} pixels compared");
    assert!(
        f64::from(sum) / f64::from(compared) < 1.5,
        "differ by {} on average",
        f64::from(sum) / f64::from(compared)
    );
}

fn is_near_pixel_center(s: f64) -> bool {
    (s - s.round()).abs() < 0.05
}

#[test]
fn camera_and_rays_pass_through_holes_in_a_texture() {
    // The left half is opaque, the right half is a hole; a wall is behind it.
    let rgba = [[200, 200, 200, 255], [200, 200, 200, 0]].concat();
    let mut scene = Scene {
        triangles: quad([-1.0, -1.0, 1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 0).into(),
        materials: vec![textured(Some(0.5)), plain([0.5; 3])],
        textures: vec![Texture { width: 2, height: 1, rgba }],
    };
    scene.triangles.extend(quad([-9.0, -9.0, 4.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0], 1));
    let camera = CameraModel::pinhole(32, 32, std::f64::consts::FRAC_PI_2);
    let (_, depth) = photograph(&scene, &camera, &Pose3::identity(), &Lighting::default());
    assert!((depth.get(12, 16).unwrap() - 1.0).abs() < 1e-5);
    assert!((depth.get(22, 16).unwrap() - 4.0).abs() < 1e-5);
    let renderer = Renderer::new(&scene);
    assert!(
        (renderer.cast([-0.3, 0.0, 0.0], [0.0, 0.0, 1.0], 10.0, &[]).unwrap() - 1.0).abs() < 1e-6
    );
    assert!(
        (renderer.cast([0.3, 0.0, 0.0], [0.0, 0.0, 1.0], 10.0, &[]).unwrap() - 4.0).abs() < 1e-6
    );
}

#[test]
fn an_empty_scene_has_depth_zero_and_no_distances() {
    let renderer = Renderer::new(&Scene::default());
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    renderer.render(&wide(), &Pose3::identity(), &[], &Lighting::default(), &mut rgb, &mut depth);
    assert!(depth.values().iter().all(|&d| d == 0.0));
    assert_eq!(renderer.cast([0.0; 3], [1.0, 0.0, 0.0], 100.0, &[]), None);
}

#[test]
fn a_ray_ends_at_its_limit_and_needs_a_direction() {
    let scene = Scene {
        triangles: room([4.0, 4.0, 2.0], 0),
        materials: vec![plain([0.5; 3])],
        textures: vec![],
    };
    let renderer = Renderer::new(&scene);
    let origin = [1.0, 2.0, 1.0];
    assert!((renderer.cast(origin, [5.0, 0.0, 0.0], 10.0, &[]).unwrap() - 3.0).abs() < 1e-6);
    assert_eq!(renderer.cast(origin, [5.0, 0.0, 0.0], 2.9, &[]), None);
    assert_eq!(renderer.cast(origin, [0.0; 3], 10.0, &[]), None);
    assert_eq!(renderer.cast(origin, [f64::NAN, 0.0, 0.0], 10.0, &[]), None);
}

#[test]
fn a_person_hides_the_wall_at_the_depth_of_the_body() {
    let scene = Scene {
        triangles: room([8.0, 6.0, 2.6], 0),
        materials: vec![plain([0.5; 3])],
        textures: vec![],
    };
    let renderer = Renderer::new(&scene);
    let bodies = Person::standing(4.0, 3.0).body();
    let pose = Pose2::new(1.0, 3.0, 0.0).to_pose3() * camera_mount(0.0, 1.1, 0.0);
    let camera = CameraModel::pinhole(161, 97, std::f64::consts::FRAC_PI_2);
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    renderer.render(&camera, &pose, &bodies, &Lighting::default(), &mut rgb, &mut depth);
    // At a height of 1.1 m the ray hits the torso, a cylinder of 0.18 m radius around x = 4.
    assert!((depth.get(80, 48).unwrap() - 2.82).abs() < 1e-5);
    assert!((depth.get(105, 48).unwrap() - 7.0).abs() < 1e-4);
    assert!(
        (renderer.cast([1.0, 3.0, 1.1], [1.0, 0.0, 0.0], 30.0, &bodies).unwrap() - 2.82).abs()
            < 1e-9
    );
    // Every pixel agrees with the ray through it, so no block has overlooked a limb.
    for (v, u) in (0..97).flat_map(|v| (0..161).map(move |u| (v, u))) {
        let ray = pose.rotation * camera.ray(u as f64, v as f64);
        let origin = pose.translation.vector.into();
        let along = renderer.cast(origin, ray.into(), 50.0, &bodies).unwrap();
        let z_depth = along / ray.norm();
        let got = f64::from(depth.get(u, v).unwrap());
        assert!((got - z_depth).abs() < 2e-4 * z_depth, "({u}, {v}): {got} for {z_depth}");
    }
}

#[test]
fn images_do_not_depend_on_the_number_of_threads() {
    let scene = Scene {
        triangles: random_triangles(3, 400),
        materials: vec![textured(None)],
        textures: vec![noise_texture(16, 16)],
    };
    let renderer = Renderer::new(&scene);
    let bodies = Person::standing(3.0, 0.0).body();
    let one = render_with(1, &renderer, &bodies);
    assert!(render_with(2, &renderer, &bodies) == one && render_with(4, &renderer, &bodies) == one);
}

fn render_with(threads: usize, renderer: &Renderer, bodies: &[Capsule]) -> (Vec<u8>, DepthMap) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut rgb = Vec::new();
        let mut depth = DepthMap::none(0, 0);
        let pose = standing(0.0, 0.0, 0.2, 0.0);
        renderer.render(&wide(), &pose, bodies, &Lighting::default(), &mut rgb, &mut depth);
        (rgb, depth)
    })
}

#[test]
fn triangles_that_cannot_be_seen_are_left_out() {
    let mut triangles: Vec<_> = quad([-1.0, -1.0, 1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 0).into();
    let mut broken = triangles[0];
    broken.vertices[1].position_m[0] = f32::NAN;
    let mut flat = triangles[0];
    flat.vertices[2] = flat.vertices[0];
    triangles.extend([broken, flat, Triangle { material: 9, ..triangles[0] }]);
    let scene = Scene { triangles, materials: vec![plain([1.0; 3])], textures: vec![] };
    assert_eq!(Renderer::new(&scene).surfaces.len(), 2);
}

fn random_triangles(seed: u64, count: usize) -> Vec<Triangle> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let centre = around(5.0, [0.0; 3], &mut rng);
            let vertices = [(); 3].map(|()| Vertex {
                position_m: around(1.0, centre, &mut rng),
                uv: [centre[0], centre[1]],
                ambient: 1.0,
            });
            Triangle { vertices, material: 0 }
        })
        .collect()
}

fn around(size: f32, centre: [f32; 3], rng: &mut Pcg64Mcg) -> [f32; 3] {
    centre.map(|c| c + rng.random_range(-size..size))
}

/// Möller and Trumbore (1997) in f64 over all triangles.
fn brute_force(
    triangles: &[Triangle],
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<f64> {
    triangles.iter().filter_map(|it| distance_to(it, origin, direction)).min_by(f64::total_cmp)
}

fn distance_to(t: &Triangle, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let [a, b, c] = t.vertices.map(|v| Vector3::from(v.position_m).cast::<f64>());
    let e1 = b - a;
    let e2 = c - a;
    let p = direction.cross(&e2);
    let det = e1.dot(&p);
    let s = origin - a;
    let u = s.dot(&p) / det;
    let q = s.cross(&e1);
    let v = direction.dot(&q) / det;
    let t = e2.dot(&q) / det;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0).then_some(t)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn images_and_rays_agree_with_brute_force(seed in 0..u64::MAX, yaw in -3.1..3.1, pitch in -0.5..0.5) {
        let scene = Scene { triangles: random_triangles(seed, 200), materials: vec![plain([0.5; 3])], textures: vec![] };
        let renderer = Renderer::new(&scene);
        // The size is not a multiple of the block's size in either direction.
        let camera = CameraModel::pinhole(43, 21, std::f64::consts::FRAC_PI_2);
        let pose = standing(0.1, -0.2, yaw, pitch);
        let mut rgb = Vec::new();
        let mut depth = DepthMap::none(0, 0);
        renderer.render(&camera, &pose, &[], &Lighting::default(), &mut rgb, &mut depth);
        let mut different = 0;
        for (v, u) in (0..21).flat_map(|v| (0..43).map(move |u| (v, u))) {
            let ray = pose.rotation * camera.ray(u as f64, v as f64);
            let truth = brute_force(&scene.triangles, &pose.translation.vector, &ray);
            let seen = depth.get(u, v).map(f64::from);
            let cast = renderer.cast(pose.translation.vector.into(), ray.into(), 100.0, &[]).map(|d| d / ray.norm());
            for got in [seen, cast] {
                let same = match (got, truth) {
                    (Some(a), Some(b)) => (a / b - 1.0).abs() < 1e-4,
                    (a, b) => a.is_none() && b.is_none(),
                };
                different += usize::from(!same);
            }
        }
        // Rays that graze an edge may fall on either side of it: f32 against f64.
        prop_assert!(different <= 1, "{} of {} differ", different, 2 * 43 * 21);
    }

    #[test]
    fn no_ray_slips_through_a_closed_mesh(seed in 0..u64::MAX) {
        // A height field of random bumps below the camera has shared edges everywhere, seen at all
        // angles.
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        const N: usize = 40;
        let heights: Vec<f32> = (0..=N * (N + 2)).map(|_| rng.random_range(-0.3..0.3)).collect();
        let mut triangles = Vec::new();
        for (i, j) in (0..N).flat_map(|i| (0..N).map(move |j| (i, j))) {
            let [a, b, c, d] = [bump_vertex(i, j, &heights, N), bump_vertex(i + 1, j, &heights, N), bump_vertex(i + 1, j + 1, &heights, N), bump_vertex(i, j + 1, &heights, N)];
            triangles.extend([[a, b, c], [c, d, a]].map(|vertices| Triangle { vertices, material: 0 }));
        }
        let scene = Scene { triangles, materials: vec![plain([0.5; 3])], textures: vec![] };
        let renderer = Renderer::new(&scene);
        let camera = CameraModel::pinhole(80, 80, 1.2);
        let pose = standing(0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let mut rgb = Vec::new();
        let mut depth = DepthMap::none(0, 0);
        renderer.render(&camera, &pose, &[], &Lighting::default(), &mut rgb, &mut depth);
        prop_assert!(depth.values().iter().all(|&d| d > 0.0));
        for _ in 0..2000 {
            let direction = [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), -0.8];
            prop_assert!(renderer.cast([0.0, 0.0, 0.8], direction, 10.0, &[]).is_some());
        }
    }
}

fn bump_vertex(i: usize, j: usize, heights: &[f32], n: usize) -> Vertex {
    Vertex {
        position_m: [i as f32 * 0.17 - 3.4, j as f32 * 0.17 - 3.4, heights[i * (n + 1) + j]],
        uv: [0.0; 2],
        ambient: 1.0,
    }
}

#[test]
fn motion_blur_averages_light_along_the_camera_path() {
    // The view has a bright and a dark half. Rotation across the border mixes them, standing still
    // does not.
    let mut triangles: Vec<_> =
        quad([5.0, 0.0, -20.0], [0.0, 40.0, 0.0], [0.0, 0.0, 40.0], 0).into();
    triangles.extend(quad([5.0, -40.0, -20.0], [0.0, 40.0, 0.0], [0.0, 0.0, 40.0], 1));
    let scene =
        Scene { triangles, materials: vec![plain([0.6; 3]), plain([0.1; 3])], textures: vec![] };
    let renderer = Renderer::new(&scene);
    let camera = CameraModel::pinhole(41, 9, std::f64::consts::FRAC_PI_2);
    let still = blurred_image(0.0, &renderer, &camera);
    let moving = blurred_image(0.2, &renderer, &camera);
    assert_eq!(
        [red_in_middle_row(&still, 18), red_in_middle_row(&still, 22)],
        [0.6, 0.1].map(light::linear_to_srgb)
    );
    assert!(red_in_middle_row(&moving, 20).abs_diff(light::linear_to_srgb(0.35)) < 12);
    assert_eq!(
        [red_in_middle_row(&moving, 2), red_in_middle_row(&moving, 38)],
        [0.6, 0.1].map(light::linear_to_srgb)
    );
}

#[test]
fn a_camera_that_rotates_while_it_reads_its_rows_shows_each_row_from_its_own_pose() {
    let renderer = Renderer::new(&Scene {
        triangles: room([6.0, 5.0, 2.5], 0),
        materials: vec![plain([0.5; 3])],
        textures: vec![],
    });
    let camera = wide();
    let mut rolled = DepthMap::none(0, 0);
    let mut still = DepthMap::none(0, 0);
    let mut rgb = Vec::new();
    renderer.render_rows(&camera, turned, &[], &Lighting::flat(), &mut rgb, &mut rolled);
    // The middles of the bands of eight rows.
    for (row, above) in [(3, 4.0 / 48.0), (27, 28.0 / 48.0), (47, 44.0 / 48.0)] {
        renderer.render(&camera, &turned(above), &[], &Lighting::flat(), &mut rgb, &mut still);
        for column in [0, 70, 159] {
            assert_eq!(rolled.get(column, row), still.get(column, row), "row {row}");
        }
    }
}

fn turned(above: f64) -> Pose3 {
    standing(3.0, 2.0, 0.3 * above, 0.0)
}

fn red_in_middle_row(rgb: &[u8], column: usize) -> u8 {
    rgb[(4 * 41 + column) * 3]
}

fn blurred_image(yaw_rad: f64, renderer: &Renderer, camera: &CameraModel) -> Vec<u8> {
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    renderer.render_blurred(
        camera,
        |passed, _| standing(0.0, 0.0, (2.0 * passed - 1.0) * yaw_rad, 0.0),
        8,
        &[],
        &Lighting::flat(),
        &mut rgb,
        &mut depth,
    );
    assert!((depth.get(20, 4).unwrap() - 5.0).abs() < 1e-5);
    rgb
}

#[test]
fn sun_patches_brighten_some_of_the_floor_and_stay_where_they_are() {
    let scene = Scene {
        triangles: room([8.0, 6.0, 2.6], 0),
        materials: vec![plain([0.4; 3])],
        textures: vec![],
    };
    let sun = SunPatches {
        strength: 1.0,
        direction: [0.6, 0.3, 0.7],
        size_m: [0.9, 1.4],
        spacing_m: 3.1,
    };
    let light = Lighting { sun: Some(sun), ..Lighting::default() };
    let camera = CameraModel::pinhole(200, 200, std::f64::consts::FRAC_PI_2);
    // A pixel is 2 cm wide on the floor, so moving 0.5 m forward moves the image by 25 rows.
    let (first, _) = photograph(&scene, &camera, &looking_down(4.0), &light);
    let (second, _) = photograph(&scene, &camera, &looking_down(4.5), &light);
    let expected = 0.9 * 1.4 / (3.1 * 3.1);
    assert!(
        (bright_share(&first) - expected).abs() < 0.06,
        "{} of the floor, not {expected}",
        bright_share(&first)
    );
    let same = (0..175 * 200)
        .filter(|i| {
            let (a, b) = shifted_pair(i / 200, i % 200, &first, &second);
            a.abs_diff(b) < 8
        })
        .count();
    assert!(same > 34_000, "{same} of 35000 floor points look the same");
}

fn shifted_pair(row: usize, column: usize, first: &[u8], second: &[u8]) -> (u8, u8) {
    (first[(row * 200 + column) * 3], second[((row + 25) * 200 + column) * 3])
}

fn bright_share(rgb: &[u8]) -> f64 {
    rgb.chunks_exact(3).filter(|p| p[0] > 170).count() as f64 / 40_000.0
}

fn looking_down(x: f64) -> Pose3 {
    Pose2::new(x, 3.0, 0.0).to_pose3() * camera_mount(0.0, 2.0, std::f64::consts::FRAC_PI_2)
}
