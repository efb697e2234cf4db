//! Renders colour and depth images of a scene and casts single rays.
//!
//! The camera is a pinhole. The depth of a pixel is that of the ray through its centre; its colour
//! is filtered over the pixel's footprint. All light is diffuse, so a surface has the same colour
//! from every direction.

mod ambient;
mod bvh;
mod facet;
mod light;
mod surface;
#[cfg(test)]
pub(crate) mod tests;
mod texture;
mod tile;

use hal::{CameraModel, DepthMap, Pose3};
use multiversion::multiversion;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::body::Capsule;
use crate::scene::{LidarResponse, Material, Scene};
pub use ambient::{AmbientOptions, bake_ambient};
use bvh::{Bvh, Corners, V3};
use facet::Facet;
use light::ToneCurve;
pub use light::{Lighting, SunPatches, Window};
use surface::Surface;
use texture::{Footprint, MipChain};
use tile::{Block, NOTHING, SIZE, View};

/// A scene prepared for rendering. It is immutable and can be shared between threads.
///
/// The renderer copies all data, so the [`Scene`] can be dropped after [`Renderer::new`].
#[derive(Debug)]
pub struct Renderer {
    bvh: Bvh,
    /// The surfaces, in the order of the triangles of the hierarchy.
    surfaces: Vec<Surface>,
    materials: Vec<Material>,
    textures: Vec<Option<MipChain>>,
    tone: ToneCurve,
}

/// The first surface or body that a ray hits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    pub distance_m: f64,
    /// Unit normal on the side of the ray's origin.
    pub normal: [f64; 3],
    /// Reflectance of the surface, 0 to 1 (luminance of its colour).
    pub reflectance: f32,
    pub lidar: LidarResponse,
}

impl Renderer {
    /// Builds the hierarchy and the mip chains. Triangles without area, with a corner that is not
    /// finite or with a material that does not exist are left out, as are textures whose byte count
    /// does not match their size.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let visible: Vec<_> = scene
            .triangles
            .iter()
            .filter(|t| (t.material as usize) < scene.materials.len())
            .filter_map(|t| Some((t, Surface::new(t)?)))
            .collect();
        let corners: Vec<_> = visible
            .iter()
            .map(|(t, _)| Corners {
                points: t.vertices.map(|v| v.position_m.into()),
                has_holes: scene.materials[t.material as usize].alpha_cutoff.is_some(),
            })
            .collect();
        let (bvh, order) = Bvh::build(&corners);
        Self {
            bvh,
            surfaces: order.iter().map(|&i| visible[i as usize].1).collect(),
            materials: scene.materials.clone(),
            textures: scene.textures.par_iter().map(MipChain::new).collect(),
            tone: ToneCurve::new(),
        }
    }

    /// Renders RGB8 (sRGB) into `rgb`, which is resized to `width * height * 3` bytes, and z-depth
    /// into `depth`, metres, 0 where nothing is seen within 200 m. The camera's distortion is
    /// ignored. The result does not depend on the number of threads.
    pub fn render(
        &self,
        camera: &CameraModel,
        t_world_camera: &Pose3,
        bodies: &[Capsule],
        light: &Lighting,
        rgb: &mut Vec<u8>,
        depth: &mut DepthMap,
    ) {
        self.render_rows(camera, |_| *t_world_camera, bodies, light, rgb, depth);
    }

    /// Like [`Renderer::render`], for a camera that moves while it reads its rows.
    /// `t_world_camera` takes the share of the rows above, 0 to 1. Eight rows have one pose.
    pub fn render_rows(
        &self,
        camera: &CameraModel,
        t_world_camera: impl Fn(f64) -> Pose3 + Sync,
        bodies: &[Capsule],
        light: &Lighting,
        rgb: &mut Vec<u8>,
        depth: &mut DepthMap,
    ) {
        let width = camera.width;
        let height = camera.height;
        rgb.resize(width * height * 3, 0);
        if (depth.width(), depth.height()) != (width, height) {
            *depth = DepthMap::none(width, height);
        }
        if width == 0 || height == 0 {
            return;
        }
        rgb.par_chunks_mut(width * SIZE * 3)
            .zip(depth.values_mut().par_chunks_mut(width * SIZE))
            .enumerate()
            .for_each_init(Vec::new, |stack, (band, (rgb, depth))| {
                let middle = (band * SIZE) as f64 + SIZE as f64 / 2.0;
                let above = (middle / height as f64).min(1.0);
                let view = view(camera, &t_world_camera(above));
                let mut out = Out { left: 0, width, rgb, depth };
                render_band(self, &view, light, bodies, band * SIZE, stack, &mut out);
            });
    }

    /// Like [`Renderer::render_rows`], with motion blur: averages the light of `samples` views at
    /// evenly spaced moments. `t_world_camera` takes the share of the exposure that has passed and
    /// the share of the rows above, both 0 to 1. The depth is that of the middle of the exposure.
    pub fn render_blurred(
        &self,
        camera: &CameraModel,
        t_world_camera: impl Fn(f64, f64) -> Pose3 + Sync,
        samples: usize,
        bodies: &[Capsule],
        light: &Lighting,
        rgb: &mut Vec<u8>,
        depth: &mut DepthMap,
    ) {
        let mut sum = vec![0.0; camera.width * camera.height * 3];
        let linear: Vec<f32> = (0..=255).map(light::srgb_to_linear).collect();
        for sample in 0..samples {
            let passed = (sample as f64 + 0.5) / samples as f64;
            self.render_rows(
                camera,
                |above| t_world_camera(passed, above),
                bodies,
                light,
                rgb,
                depth,
            );
            for (sum, byte) in sum.iter_mut().zip(rgb.iter()) {
                *sum += linear[*byte as usize];
            }
        }
        self.render_rows(camera, |above| t_world_camera(0.5, above), bodies, light, rgb, depth);
        if samples > 0 {
            for (sum, byte) in sum.iter().zip(rgb.iter_mut()) {
                *byte = light::linear_to_srgb(sum / samples as f32);
            }
        }
    }

    /// Distance along a ray to the first surface or body, metres; `None` when there is none
    /// within `max_m` or the direction (of any length) is zero or not finite.
    #[must_use]
    pub fn cast(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        max_m: f64,
        bodies: &[Capsule],
    ) -> Option<f64> {
        self.hit(origin, direction, max_m, bodies, false).map(|hit| hit.distance_m)
    }

    /// Like [`Renderer::cast`], with the normal and reflectance of the surface. The ray may pass
    /// clear glass.
    #[must_use]
    pub fn hit(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        max_m: f64,
        bodies: &[Capsule],
        passes_glass: bool,
    ) -> Option<Hit> {
        let direction = Vector3::from(direction)
            .try_normalize(0.0)
            .filter(|d| d.iter().all(|c| c.is_finite()))?;
        let origin = Vector3::from(origin);
        let wall =
            self.bvh.nearest(origin.cast(), direction.cast(), max_m as f32, |triangle, t| {
                if passes_glass && self.lidar_response(triangle) == LidarResponse::Glass {
                    return false;
                }
                !self.bvh.triangles[triangle as usize].has_holes
                    || !self.is_hole(triangle, &(origin + direction * f64::from(t)).cast())
            });
        let wall = wall.map(|(t, triangle)| self.describe(triangle, &origin, &direction, t));
        let body = bodies.iter().filter_map(|part| {
            let distance_m = part.entry(&origin, &direction).filter(|t| *t <= max_m)?;
            let normal = part.normal(&(origin + direction * distance_m)).into();
            let reflectance = luminance(part.color);
            Some(Hit { distance_m, normal, reflectance, lidar: LidarResponse::Diffuse })
        });
        body.chain(wall).min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
    }

    fn describe(
        &self,
        triangle: u32,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        t: f32,
    ) -> Hit {
        let surface = &self.surfaces[triangle as usize];
        let normal = surface.normal.cast::<f64>();
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let material = &self.materials[surface.material as usize];
        let mut reflectance = luminance(material.base_color);
        if let Some(texture) = self.texture(material) {
            let offset = (origin + direction * f64::from(t)).cast() - surface.origin;
            let footprint =
                Footprint { uv: surface.uv(&offset), per_column: [0.0; 2], per_row: [0.0; 2] };
            let [r, g, b, _] = texture.sample(&footprint);
            reflectance *= luminance([r, g, b]);
        }
        let lidar = material.lidar;
        Hit { distance_m: f64::from(t), normal: normal.into(), reflectance, lidar }
    }

    fn lidar_response(&self, triangle: u32) -> LidarResponse {
        self.materials[self.surfaces[triangle as usize].material as usize].lidar
    }

    fn texture(&self, material: &Material) -> Option<&MipChain> {
        self.textures.get(material.texture? as usize)?.as_ref()
    }

    /// Whether the texture has a hole at this point of a triangle.
    fn is_hole(&self, triangle: u32, point: &V3) -> bool {
        let surface = &self.surfaces[triangle as usize];
        let material = &self.materials[surface.material as usize];
        let (Some(cutoff), Some(texture)) = (material.alpha_cutoff, self.texture(material)) else {
            return false;
        };
        texture.alpha(surface.uv(&(point - surface.origin))) < cutoff
    }

    #[inline(always)]
    fn render_block(
        &self,
        view: &View,
        light: &Lighting,
        bodies: &[Capsule],
        place: (usize, usize),
        stack: &mut Vec<(u32, f32)>,
        out: &mut Out<'_>,
    ) {
        let block = tile::nearest_surfaces(&self.bvh, view, place, stack, |triangle, point| {
            self.is_hole(triangle, &(view.origin + point))
        });
        self.shade(view, light, place, &block, out);
        self.draw_bodies(view, light, place, bodies, out);
    }

    #[inline(always)]
    fn shade(
        &self,
        view: &View,
        light: &Lighting,
        (left, top): (usize, usize),
        block: &Block,
        out: &mut Out<'_>,
    ) {
        let background = self.tone.encode_colour(&light.background.map(|b| b * light.exposure));
        let mut last: Option<(u32, Facet<'_>)> = None;
        for row in 0..SIZE.min(out.rows()) {
            for column in 0..SIZE.min(out.width - left) {
                let triangle = block.triangle[row][column];
                if triangle == NOTHING {
                    out.put(row, column, background, 0.0);
                    continue;
                }
                let direction = view.direction((left + column) as f32, (top + row) as f32);
                let facet = match &last {
                    Some((of, facet)) if *of == triangle => facet,
                    _ => &last.insert((triangle, self.facet(triangle, view, light, &direction))).1,
                };
                let depth = 1.0 / block.inverse_depth[row][column];
                let colour = facet.colour(view, light, &direction, depth);
                out.put(row, column, self.tone.encode_colour(&colour), depth);
            }
        }
    }

    /// Prepares a triangle for the pixels in which it is seen, of which the first has this direction.
    #[inline(always)]
    fn facet(&self, triangle: u32, view: &View, light: &Lighting, direction: &V3) -> Facet<'_> {
        let surface = &self.surfaces[triangle as usize];
        let material = &self.materials[surface.material as usize];
        Facet::new(surface, material, self.texture(material), view, light, direction)
    }

    fn draw_bodies(
        &self,
        view: &View,
        light: &Lighting,
        (left, top): (usize, usize),
        bodies: &[Capsule],
        out: &mut Out<'_>,
    ) {
        let middle =
            view.direction(left as f32 + SIZE as f32 / 2.0, top as f32 + SIZE as f32 / 2.0);
        let spread = (view.column.norm() + view.row.norm()) * SIZE as f32;
        for part in bodies.iter().filter(|part| may_see(part, view, &middle, spread)) {
            for row in 0..SIZE.min(out.rows()) {
                for column in 0..SIZE.min(out.width - left) {
                    let direction =
                        view.direction((left + column) as f32, (top + row) as f32).cast::<f64>();
                    let origin = view.origin.cast::<f64>();
                    let Some(depth) = part.entry(&origin, &direction) else { continue };
                    let behind = out.depth_at(row, column);
                    if behind == 0.0 || (depth as f32) < behind {
                        let normal = part.normal(&(origin + direction * depth)).cast();
                        let on_surface = light.on_surface(&normal);
                        let colour = std::array::from_fn(|c| {
                            self.tone.encode(part.color[c] * on_surface[c])
                        });
                        out.put(row, column, colour, depth as f32);
                    }
                }
            }
        }
    }
}

/// Renders a row of blocks, whose first row of pixels is `top`. What it calls for every pixel is
/// inlined where that is faster, so that it is compiled for AVX2 too. Without fused
/// multiplications, because the images would be others.
#[multiversion(targets("x86_64+avx2"))]
fn render_band<'a>(
    renderer: &Renderer,
    view: &View,
    light: &Lighting,
    bodies: &[Capsule],
    top: usize,
    stack: &mut Vec<(u32, f32)>,
    out: &mut Out<'a>,
) {
    for left in (0..out.width).step_by(SIZE) {
        out.left = left;
        renderer.render_block(view, light, bodies, (left, top), stack, out);
    }
}

/// Whether a body part may be visible in a block whose centre ray is `middle` (1 m deep) and whose
/// rays end within `spread` of it.
fn may_see(part: &Capsule, view: &View, middle: &V3, spread: f32) -> bool {
    let centre = ((part.from + part.to) * 0.5).cast::<f32>() - view.origin;
    let reach = ((part.to - part.from).norm() * 0.5 + part.radius_m) as f32;
    let depth = centre.dot(&view.forward);
    let aside = (centre - middle * depth).norm();
    // Within `reach` of the centre the pyramid's width changes by the same factor again.
    depth + reach > 0.0 && aside <= reach * (1.0 + middle.norm() + spread) + spread * depth.max(0.0)
}

fn view(camera: &CameraModel, t_world_camera: &Pose3) -> View {
    let rotation = t_world_camera.rotation;
    View {
        origin: t_world_camera.translation.vector.cast(),
        corner: (rotation * camera.ray(0.0, 0.0)).cast(),
        column: (rotation * Vector3::new(1.0 / camera.fx, 0.0, 0.0)).cast(),
        row: (rotation * Vector3::new(0.0, 1.0 / camera.fy, 0.0)).cast(),
        forward: (rotation * Vector3::z()).cast(),
    }
}

/// Luminance by Rec. 709.
fn luminance(color: [f32; 3]) -> f32 {
    0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
}

/// Output buffers of a band of the image, and the block's position in them.
struct Out<'a> {
    left: usize,
    width: usize,
    rgb: &'a mut [u8],
    depth: &'a mut [f32],
}

impl Out<'_> {
    fn rows(&self) -> usize {
        self.depth.len() / self.width
    }

    #[inline(always)]
    fn put(&mut self, row: usize, column: usize, colour: [u8; 3], depth: f32) {
        let index = row * self.width + self.left + column;
        self.rgb[index * 3..index * 3 + 3].copy_from_slice(&colour);
        self.depth[index] = depth;
    }

    fn depth_at(&self, row: usize, column: usize) -> f32 {
        self.depth[row * self.width + self.left + column]
    }
}
