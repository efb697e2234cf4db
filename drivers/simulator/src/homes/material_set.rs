//! Materials by colour and skin. A texture is painted once, however many materials share it.

use rayon::prelude::*;

use super::texture::Skin;
use crate::scene::{LidarResponse, Material, Texture};

/// A material and the size of its texture in metres, which gives all surfaces the same density of
/// detail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    pub material: u32,
    pub tile_m: f32,
}

/// Collects materials and the skins that they need.
#[derive(Debug, Default, PartialEq)]
pub struct MaterialSet {
    materials: Vec<Material>,
    skins: Vec<Skin>,
}

impl MaterialSet {
    /// Adds a material with a colour (sRGB, steps of 255) multiplied by a skin.
    pub fn appearance(&mut self, name: &str, color: [u8; 3], skin: Skin) -> Appearance {
        self.glowing(name, color, skin, 0.0)
    }

    /// Adds a material that also emits `glow` times its colour.
    pub fn glowing(&mut self, name: &str, color: [u8; 3], skin: Skin, glow: f32) -> Appearance {
        let base_color = color.map(linear);
        let emissive = base_color.map(|c| c * glow);
        self.add(name, base_color, skin, emissive, LidarResponse::Diffuse)
    }

    /// Adds a material that laser scanners hardly see, and that emits `glow` times its colour.
    pub fn absorbing(&mut self, name: &str, color: [u8; 3], skin: Skin, glow: f32) -> Appearance {
        let base_color = color.map(linear);
        let emissive = base_color.map(|c| c * glow);
        self.add(name, base_color, skin, emissive, LidarResponse::Absorbing)
    }

    fn add(
        &mut self,
        name: &str,
        base_color: [f32; 3],
        skin: Skin,
        emissive: [f32; 3],
        lidar: LidarResponse,
    ) -> Appearance {
        let texture = self.skins.iter().position(|s| *s == skin).unwrap_or_else(|| {
            self.skins.push(skin);
            self.skins.len() - 1
        });
        let material = Material {
            name: name.to_owned(),
            base_color,
            texture: Some(texture as u32),
            alpha_cutoff: None,
            emissive,
            lidar,
        };
        let index = self.materials.iter().position(|m| *m == material).unwrap_or_else(|| {
            self.materials.push(material);
            self.materials.len() - 1
        });
        Appearance { material: index as u32, tile_m: skin.tile_m().unwrap_or(1.0) }
    }

    pub fn finish(mut self, seed: u64, texture: f32) -> (Vec<Material>, Vec<Texture>) {
        let painted: Vec<(Texture, f32)> = self
            .skins
            .par_iter()
            .map(|skin| {
                let image = skin.paint(seed, texture);
                let mean = if skin.tints() { mean_light(&image) } else { 1.0 };
                (image, mean)
            })
            .collect();
        for material in &mut self.materials {
            let mean = material.texture.map_or(1.0, |t| painted[t as usize].1);
            material.base_color = material.base_color.map(|c| c / mean);
        }
        (self.materials, painted.into_iter().map(|(image, _)| image).collect())
    }
}

/// Approximates the conversion of sRGB steps to linear light by a power of 2.2.
fn linear(step: u8) -> f32 {
    (f32::from(step) / 255.0).powf(2.2)
}

/// Mean green in linear light.
fn mean_light(texture: &Texture) -> f32 {
    let table: [f32; 256] = std::array::from_fn(|i| linear(i as u8));
    let sum: f64 = texture.rgba.chunks_exact(4).map(|p| f64::from(table[usize::from(p[1])])).sum();
    (sum / f64::from((texture.width * texture.height).max(1))) as f32
}
