//! The colour of a triangle in the pixels of a block.
//!
//! Loops and plain arrays instead of `array::map`, here and in what is called for every pixel or
//! triangle: the compiler does not always inline `map`, and calls stop it from vectorising.

use super::bvh::V3;
use super::light::Lighting;
use super::surface::Surface;
use super::texture::{Footprint, MipChain};
use super::tile::View;
use crate::scene::Material;

/// What the pixels of a triangle in a view share.
pub(super) struct Facet<'a> {
    surface: &'a Surface,
    material: &'a Material,
    texture: Option<&'a MipChain>,
    /// Light on the surface, without ambient occlusion and the sun.
    light: [f32; 3],
    /// From the surface's origin to the view's.
    to_view: V3,
    /// Steps along the surface's normal from one pixel's ray to the next, along columns and rows.
    normal_step: [f32; 2],
}

impl<'a> Facet<'a> {
    /// `direction` is that of the first pixel in which the triangle is seen.
    #[inline(always)]
    pub fn new(
        surface: &'a Surface,
        material: &'a Material,
        texture: Option<&'a MipChain>,
        view: &View,
        light: &Lighting,
        direction: &V3,
    ) -> Self {
        Self {
            surface,
            material,
            texture,
            light: light.on_surface(&towards_view(surface, surface.normal.dot(direction))),
            to_view: view.origin - surface.origin,
            normal_step: [surface.normal.dot(&view.column), surface.normal.dot(&view.row)],
        }
    }

    /// Linear light that leaves the surface towards a pixel whose `direction` has a depth of 1 m.
    #[inline(always)]
    pub fn colour(&self, view: &View, light: &Lighting, direction: &V3, depth: f32) -> [f32; 3] {
        let surface = self.surface;
        let material = self.material;
        let facing = surface.normal.dot(direction);
        let offset = direction * depth + self.to_view;
        let mut albedo = material.base_color;
        if let Some(texture) = self.texture {
            // Motion of the point on the surface from this pixel to the next (Igehy, "Tracing ray
            // differentials", 1999).
            let step = |pixel: &V3, along_normal: f32| {
                (pixel - direction * (along_normal / facing)) * depth
            };
            let [per_column, per_row] = self.normal_step;
            let texel = texture.sample(&Footprint {
                uv: surface.uv(&offset),
                per_column: surface.uv_change(&step(&view.column, per_column)),
                per_row: surface.uv_change(&step(&view.row, per_row)),
            });
            albedo = [albedo[0] * texel[0], albedo[1] * texel[1], albedo[2] * texel[2]];
        }
        let ambient = surface.ambient(&offset);
        let sun = light.sun.as_ref().map_or(0.0, |sun| {
            let normal = towards_view(surface, facing);
            sun.at(&(surface.origin + offset), &normal) * light.exposure
        });
        let mut colour = [0.0; 3];
        for c in 0..3 {
            colour[c] =
                albedo[c] * (self.light[c] * ambient + sun) + material.emissive[c] * light.exposure;
        }
        colour
    }
}

/// The normal on the side of the view. `facing` is its dot product with the ray's direction.
#[inline(always)]
fn towards_view(surface: &Surface, facing: f32) -> V3 {
    if facing > 0.0 { -surface.normal } else { surface.normal }
}
