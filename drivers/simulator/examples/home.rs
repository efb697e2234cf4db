//! Draws built-in homes: plan from above, camera views of every room, and how much contrast each
//! kind of surface has.
//!
//! `cargo run -p simulator --example home -- OUT [KIND [SEED [TEXTURE [moved]]]]`

use std::error::Error;
use std::path::Path;

use hal::{CameraModel, DepthMap, Pose3};
use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};
use simulator::homes::{Home, HomeKind, HomeOptions, Room, build};
use simulator::render::{Lighting, Renderer};
use simulator::scene::{Material, Scene};

const CAMERA_HEIGHT_M: f64 = 0.8;
/// The names of the kinds of surface, in the order of [`simulator::homes::Surface`].
const CLASSES: [&str; 8] =
    ["floor", "ceiling", "wall", "opening", "fixture", "furniture", "outside", "cable"];

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let out = args.next().unwrap_or_else(|| "target/homes".to_owned());
    let kind: Option<HomeKind> = args.next().map(|k| k.parse()).transpose()?;
    let seed: u64 = args.next().map_or(Ok(1), |s| s.parse())?;
    let texture: f32 = args.next().map_or(Ok(HomeOptions::TEXTURE), |s| s.parse())?;
    let moved = args.next().is_some_and(|m| m == "moved");
    std::fs::create_dir_all(&out)?;
    for kind in kind.map_or(HomeKind::ALL.to_vec(), |k| vec![k]) {
        draw(kind, &HomeOptions { texture, moved, ..HomeOptions::new(seed) }, Path::new(&out))?;
    }
    Ok(())
}

fn draw(kind: HomeKind, options: &HomeOptions, out: &Path) -> Result<(), Box<dyn Error>> {
    let start = std::time::Instant::now();
    let home = build(kind, options);
    let elapsed = start.elapsed();
    let area: f32 = home.rooms.iter().map(|r| r.rect.area_m2()).sum();
    let bytes: usize = home.scene.textures.iter().map(|t| t.rgba.len()).sum();
    println!(
        "{kind} {}: {} rooms, {area:.0} m2, {} pieces, {} triangles, {} materials, {} textures of {:.1} MB, {elapsed:.2?}",
        options.seed,
        home.rooms.len(),
        home.furniture.len(),
        home.scene.triangles.len(),
        home.scene.materials.len(),
        home.scene.textures.len(),
        bytes as f64 / 1e6
    );
    let name = format!("{kind}-{}", options.seed);
    plan(&home)?.save(out.join(format!("{name}-plan.png")))?;
    views(&home, &out.join(format!("{name}-views.png")))
}

/// Draws the plan from above: everything below 2.1 m.
fn plan(home: &Home) -> Result<image::RgbImage, Box<dyn Error>> {
    const PER_M: f32 = 60.0;
    let far = home
        .rooms
        .iter()
        .fold([0.0_f32; 2], |m, r| [m[0].max(r.rect.max[0]), m[1].max(r.rect.max[1])]);
    let size = far.map(|f| ((f + 0.4) * PER_M) as usize);
    let mut plan_image =
        image::RgbImage::from_pixel(size[0] as u32, size[1] as u32, image::Rgb([40; 3]));
    let mut height = vec![-1.0_f32; size[0] * size[1]];
    for triangle in &home.scene.triangles {
        let p = triangle.vertices.map(|v| v.position_m);
        if p.iter().any(|p| p[2] > 2.3) {
            continue;
        }
        let material = &home.scene.materials[triangle.material as usize];
        let q = p.map(|p| [(p[0] + 0.2) * PER_M, size[1] as f32 - (p[1] + 0.2) * PER_M]);
        let area =
            (q[1][0] - q[0][0]) * (q[2][1] - q[0][1]) - (q[2][0] - q[0][0]) * (q[1][1] - q[0][1]);
        if area.abs() < 1e-6 {
            continue;
        }
        for y in pixel_range(1, q, size) {
            for x in pixel_range(0, q, size) {
                let c = [x as f32 + 0.5, y as f32 + 0.5];
                let w = [
                    edge_weight(q[1], q[2], c, area),
                    edge_weight(q[2], q[0], c, area),
                    edge_weight(q[0], q[1], c, area),
                ];
                let z: f32 = (0..3).map(|i| w[i] * p[i][2]).sum();
                if w.iter().any(|w| *w < 0.0) || z <= height[y * size[0] + x] {
                    continue;
                }
                height[y * size[0] + x] = z;
                let light: f32 = (0..3).map(|i| w[i] * triangle.vertices[i].ambient).sum();
                let color = material
                    .base_color
                    .map(|c| ((c * 0.7 * light).powf(1.0 / 2.2) * 255.0).min(255.0) as u8);
                plan_image.put_pixel(x as u32, y as u32, image::Rgb(color));
            }
        }
    }
    Ok(plan_image)
}

fn edge_weight(a: [f32; 2], b: [f32; 2], c: [f32; 2], area: f32) -> f32 {
    ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])) / area
}

fn pixel_range(axis: usize, q: [[f32; 2]; 3], size: [usize; 2]) -> std::ops::Range<usize> {
    let low = q.iter().map(|q| q[axis]).fold(f32::MAX, f32::min).max(0.0) as usize;
    let high = q.iter().map(|q| q[axis]).fold(0.0, f32::max).ceil() as usize;
    low..high.min(size[axis])
}

fn pose(at: [f64; 2], yaw: f64) -> Pose3 {
    let forward = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
    let right = Vector3::new(yaw.sin(), -yaw.cos(), 0.0);
    let rotation = Rotation3::from_basis_unchecked(&[right, -Vector3::z(), forward]);
    Pose3::from_parts(
        Translation3::new(at[0], at[1], CAMERA_HEIGHT_M),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// The pose in a room, away from its furniture, from which a camera sees farthest.
fn best_view(home: &Home, index: usize, room: &Room, renderer: &Renderer) -> Pose3 {
    let [x0, y0] = room.rect.min;
    let [w, d] = room.rect.size();
    let mut best = (0.0, pose(room.rect.center().map(f64::from), 0.0));
    for i in 0..96 {
        let at = [
            x0 + w * (0.1 + 0.8 * quasi_random(0.618, i)),
            y0 + d * (0.1 + 0.8 * quasi_random(0.755, i)),
        ];
        if home.furniture.iter().any(|f| f.room == index && f.rect.distance_m(at) < 0.3) {
            continue;
        }
        let at = at.map(f64::from);
        let yaw = std::f64::consts::TAU * f64::from(quasi_random(0.37, i));
        let score: f64 = (-4..=4)
            .map(|k| {
                let a = yaw + 0.17 * f64::from(k);
                let origin = [at[0], at[1], 0.7];
                renderer.cast(origin, [a.cos(), a.sin(), 0.0], 20.0, &[]).unwrap_or(0.0).min(4.0)
            })
            .sum();
        if score > best.0 {
            best = (score, pose(at, yaw));
        }
    }
    best.1
}

fn quasi_random(step: f32, i: i32) -> f32 {
    (0.5 + step * i as f32).fract()
}

fn views(home: &Home, path: &Path) -> Result<(), Box<dyn Error>> {
    let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
    let renderer = Renderer::new(&home.scene);
    let classes = Renderer::new(&labelled(home));
    let rows = home.rooms.len().div_ceil(2) as u32;
    let mut sheet = image::RgbImage::new(1284, rows * 196);
    let mut contrast = Contrast::default();
    for (index, room) in home.rooms.iter().enumerate() {
        let at = best_view(home, index, room, &renderer);
        let mut rgb = Vec::new();
        let mut labels = Vec::new();
        let mut depth = DepthMap::none(640, 192);
        classes.render(&camera, &at, &[], &Lighting::flat(), &mut labels, &mut depth);
        renderer.render(&camera, &at, &[], &Lighting::default(), &mut rgb, &mut depth);
        contrast.add(&rgb, &labels, depth.values());
        let single = path.with_extension(format!("{}.png", room.name));
        image::save_buffer(single, &rgb, 640, 192, image::ColorType::Rgb8)?;
        let left = (index as u32 % 2) * 644;
        for (i, pixel) in rgb.chunks_exact(3).enumerate() {
            let x = i as u32 % 640 + left;
            let y = i as u32 / 640 + index as u32 / 2 * 196;
            sheet.put_pixel(x, y, image::Rgb([pixel[0], pixel[1], pixel[2]]));
        }
    }
    sheet.save(path)?;
    contrast.print();
    Ok(())
}

/// The scene with the same shapes, each in a grey that encodes its kind of surface.
fn labelled(home: &Home) -> Scene {
    let mut scene = home.scene.clone();
    for (triangle, surface) in scene.triangles.iter_mut().zip(&home.surfaces) {
        triangle.material = *surface as u32;
        triangle.vertices.iter_mut().for_each(|v| v.ambient = 0.0);
    }
    scene.materials = (0..CLASSES.len() as u32).map(glowing_material).collect();
    scene
}

fn glowing_material(i: u32) -> Material {
    Material {
        name: String::new(),
        base_color: [0.0; 3],
        texture: None,
        alpha_cutoff: None,
        emissive: [(i + 1) as f32 * 0.08; 3],
        lidar: simulator::scene::LidarResponse::Diffuse,
    }
}

/// Standard deviations of brightness in blocks of 16x16 pixels that show one kind of surface at one
/// range of distances.
#[derive(Default)]
struct Contrast {
    blocks: Vec<(u8, f32, f64)>,
}

impl Contrast {
    fn add(&mut self, rgb: &[u8], labels: &[u8], depth: &[f32]) {
        const B: usize = 16;
        for (by, bx) in (0..192 / B).flat_map(|y| (0..640 / B).map(move |x| (y, x))) {
            let cells: Vec<usize> =
                (0..B * B).map(|k| (by * B + k / B) * 640 + bx * B + k % B).collect();
            let label = labels[cells[0] * 3];
            if cells.iter().any(|c| labels[c * 3] != label) {
                continue;
            }
            let z = cells.iter().map(|c| depth[*c]).sum::<f32>() / cells.len() as f32;
            self.blocks.push((
                label,
                z,
                deviation_from_plane(&cells.iter().map(|c| luma(*c, rgb)).collect::<Vec<_>>(), B),
            ));
        }
    }

    fn print(&self) {
        let mut labels: Vec<u8> = self.blocks.iter().map(|b| b.0).collect();
        labels.sort_unstable();
        labels.dedup();
        for label in labels {
            let class = (0..7)
                .min_by_key(|i| (displayed_glow(*i) - f64::from(label)).abs() as u32)
                .unwrap_or(0);
            print!("  {:9}", CLASSES[class]);
            for (near, far) in [(0.3, 1.0), (1.0, 1.6), (1.6, 2.4), (2.4, 4.0), (4.0, 8.0)] {
                let mut all: Vec<f64> = self
                    .blocks
                    .iter()
                    .filter(|b| b.0 == label && b.1 >= near && b.1 < far)
                    .map(|b| b.2)
                    .collect();
                all.sort_by(f64::total_cmp);
                match all.len() {
                    0..8 => print!("  {near}-{far} m: -"),
                    n => print!(
                        "  {near}-{far} m: {:.1} ({:.1}..{:.1})",
                        all[n / 2],
                        all[n / 10],
                        all[n * 9 / 10]
                    ),
                }
            }
            println!();
        }
    }
}

fn luma(c: usize, rgb: &[u8]) -> f64 {
    0.299 * f64::from(rgb[c * 3])
        + 0.587 * f64::from(rgb[c * 3 + 1])
        + 0.114 * f64::from(rgb[c * 3 + 2])
}

/// As `labelled` glows, through sRGB coding.
fn displayed_glow(i: usize) -> f64 {
    ((i + 1) as f64 * 0.08).powf(1.0 / 2.2) * 255.0
}

/// Standard deviation from the best-fitting plane. A light gradient is not texture.
fn deviation_from_plane(values: &[f64], width: usize) -> f64 {
    let n = values.len() as f64;
    let middle = (width as f64 - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / n;
    let spread: f64 =
        (0..values.len()).map(|i| offset_from_center(i, width, middle).0.powi(2)).sum();
    let slope_x = values
        .iter()
        .enumerate()
        .map(|(i, v)| v * offset_from_center(i, width, middle).0)
        .sum::<f64>()
        / spread;
    let slope_y = values
        .iter()
        .enumerate()
        .map(|(i, v)| v * offset_from_center(i, width, middle).1)
        .sum::<f64>()
        / spread;
    let rest: f64 = values
        .iter()
        .enumerate()
        .map(|(i, v)| {
            let (x, y) = offset_from_center(i, width, middle);
            (v - mean - slope_x * x - slope_y * y).powi(2)
        })
        .sum();
    (rest / n).sqrt()
}

fn offset_from_center(i: usize, width: usize, middle: f64) -> (f64, f64) {
    ((i % width) as f64 - middle, (i / width) as f64 - middle)
}
