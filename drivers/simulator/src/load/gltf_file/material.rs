//! Materials and their textures.

use std::borrow::Cow;
use std::collections::BTreeMap;

use gltf::json::extensions::texture::TextureTransform;
use gltf::json::validation::Checked::Valid;
use gltf::json::{Index, material, texture};
use rayon::prelude::*;

use super::super::texture::decode;
use super::super::vertex_color::{ColorAtlas, srgb_from_linear};
use super::container::File;
use crate::error::SceneError;
use crate::scene::{LidarResponse, Material, Scene};

/// Blended materials with less alpha than this are clear glass.
const CLEAR_ALPHA: f32 = 0.5;

/// Materials of the document that triangles use.
pub(super) struct Materials<'a> {
    file: &'a File,
    /// The materials that were read, by index in the document; `None` is glTF's default material.
    surfaces: BTreeMap<Option<usize>, Surface>,
    /// Scene texture of every image that was read, by its index in the document.
    textures: BTreeMap<usize, u32>,
    /// Names and encoded bytes of the scene's textures, in order.
    encoded: Vec<(String, Cow<'a, [u8]>)>,
    /// Materials of triangles with vertex colours, by the material that tints them.
    colored: BTreeMap<u32, u32>,
    atlas: ColorAtlas,
    /// Triangles whose texture coordinates are set when the atlas is complete: (triangle, block).
    pending: Vec<(usize, usize)>,
}

/// The parts of a material that a primitive needs.
#[derive(Clone)]
pub(super) struct Surface {
    pub material: u32,
    pub is_textured: bool,
    pub uv_set: u32,
    transform: Option<TextureTransform>,
}

impl Surface {
    /// KHR_texture_transform: scale, then rotate, then translate.
    pub fn transform_uv(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        let Some(transform) = &self.transform else { return [u, v] };
        let [du, dv] = transform.offset.0;
        let [su, sv] = transform.scale.0;
        let (sin, cos) = transform.rotation.0.sin_cos();
        let u = u * su;
        let v = v * sv;
        [cos * u + sin * v + du, cos * v - sin * u + dv]
    }
}

impl<'a> Materials<'a> {
    pub fn new(file: &'a File) -> Self {
        Self {
            file,
            surfaces: BTreeMap::new(),
            textures: BTreeMap::new(),
            encoded: Vec::new(),
            colored: BTreeMap::new(),
            atlas: ColorAtlas::default(),
            pending: Vec::new(),
        }
    }

    /// The material of a primitive. It is read on first use.
    pub fn surface(
        &mut self,
        index: Option<Index<material::Material>>,
        scene: &mut Scene,
    ) -> Result<Surface, SceneError> {
        let key = index.map(|index| index.value());
        if let Some(surface) = self.surfaces.get(&key) {
            return Ok(surface.clone());
        }
        let surface = match index {
            Some(index) => self.read(index, scene)?,
            None => add(scene, Material { name: "default".into(), ..plain() }, None),
        };
        self.surfaces.insert(key, surface.clone());
        Ok(surface)
    }

    fn read(
        &mut self,
        index: Index<material::Material>,
        scene: &mut Scene,
    ) -> Result<Surface, SceneError> {
        let source = self.file.get(index, "material")?;
        let extensions = source.extensions.as_ref();
        let (mut factor, mut image_info) =
            match extensions.and_then(|e| e.pbr_specular_glossiness.as_ref()) {
                Some(old) => (old.diffuse_factor.0, old.diffuse_texture.as_ref()),
                None => {
                    let pbr = &source.pbr_metallic_roughness;
                    (pbr.base_color_factor.0, pbr.base_color_texture.as_ref())
                }
            };
        let mut emissive = source.emissive_factor.0;
        if let Some(glow) = &source.emissive_texture {
            // Photogrammetry exports put their only texture here so that viewers show it unlit. In
            // other files it is mostly black.
            if image_info.is_none() {
                image_info = Some(glow);
                factor[..3].copy_from_slice(&emissive);
            }
            emissive = [0.0; 3];
        }
        let texture = image_info.map(|info| self.texture(info.index)).transpose()?;
        let alpha_cutoff = match source.alpha_mode {
            Valid(material::AlphaMode::Mask) => {
                Some(source.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0))
            }
            // Half-transparent texels become opaque or holes: a pixel has only one depth, so there
            // is no blending.
            Valid(material::AlphaMode::Blend) => Some(0.5),
            _ => None,
        };
        let material = Material {
            name: source.name.clone().unwrap_or_else(|| format!("material {}", index.value())),
            base_color: [factor[0], factor[1], factor[2]],
            texture,
            alpha_cutoff: alpha_cutoff.filter(|_| texture.is_some()),
            emissive,
            lidar: if is_clear(source, factor[3]) {
                LidarResponse::Glass
            } else {
                LidarResponse::Diffuse
            },
        };
        Ok(add(scene, material, image_info))
    }

    fn texture(&mut self, index: Index<texture::Texture>) -> Result<u32, SceneError> {
        let file = self.file;
        let source = file.get(index, "texture")?.source;
        if let Some(&known) = self.textures.get(&source.value()) {
            return Ok(known);
        }
        let Some(image) = file.root.get(source) else {
            let feature = format!("texture {} without a PNG or JPEG image", index.value());
            return Err(file.unsupported(feature, super::super::texture::WAY_OUT));
        };
        let label = format!("image {}", source.value());
        let image_info = match (image.buffer_view, &image.uri) {
            (Some(view), _) => {
                (image.name.clone().unwrap_or(label), Cow::Borrowed(file.view(view)?))
            }
            (None, Some(uri)) => {
                let name = if uri.starts_with("data:") { label } else { uri.clone() };
                (name, Cow::Owned(file.fetch(uri, "texture")?))
            }
            (None, None) => {
                return Err(file.malformed(format!("{label} has neither bytes nor a file")));
            }
        };
        let texture = self.encoded.len() as u32;
        self.encoded.push(image_info);
        self.textures.insert(source.value(), texture);
        Ok(texture)
    }

    /// The material of the next triangle of the scene, whose corners have colours (linear light).
    pub fn color(
        &mut self,
        surface: &Surface,
        corners: [u32; 3],
        colors: &[[f32; 3]],
        scene: &mut Scene,
    ) -> u32 {
        let block = self.atlas.push(corners.map(|it| corner_color(it, colors)));
        self.pending.push((scene.triangles.len(), block));
        *self.colored.entry(surface.material).or_insert_with(|| {
            scene.materials.push(scene.materials[surface.material as usize].clone());
            scene.materials.len() as u32 - 1
        })
    }

    /// Completes the scene after its last triangle: decodes the textures on all cores.
    pub fn finish(self, scene: &mut Scene) -> Result<(), SceneError> {
        let path = &self.file.path;
        let decoded: Vec<_> =
            self.encoded.par_iter().map(|(name, bytes)| decode(path, name, bytes)).collect();
        scene.textures = decoded.into_iter().collect::<Result<_, _>>()?;
        if self.pending.is_empty() {
            return Ok(());
        }
        for (triangle, block) in self.pending {
            for (vertex, uv) in
                scene.triangles[triangle].vertices.iter_mut().zip(self.atlas.uv(block))
            {
                vertex.uv = uv;
            }
        }
        scene.textures.push(self.atlas.into_texture());
        for material in self.colored.into_values() {
            scene.materials[material as usize].texture = Some(scene.textures.len() as u32 - 1);
        }
        Ok(())
    }
}

/// Whether a laser beam passes: the material is blended with what is behind it, and mostly shows
/// that.
fn is_clear(source: &material::Material, alpha: f32) -> bool {
    source.alpha_mode == Valid(material::AlphaMode::Blend) && alpha < CLEAR_ALPHA
}

fn corner_color(corner: u32, colors: &[[f32; 3]]) -> [u8; 3] {
    colors.get(corner as usize).copied().unwrap_or([1.0; 3]).map(srgb_from_linear)
}

fn add(scene: &mut Scene, material: Material, image_info: Option<&texture::Info>) -> Surface {
    scene.materials.push(material);
    let transform = image_info.and_then(|info| info.extensions.as_ref()?.texture_transform.clone());
    let uv_set = image_info
        .map_or(0, |info| transform.as_ref().and_then(|t| t.tex_coord).unwrap_or(info.tex_coord));
    Surface {
        material: scene.materials.len() as u32 - 1,
        is_textured: image_info.is_some(),
        uv_set,
        transform,
    }
}

fn plain() -> Material {
    Material {
        name: String::new(),
        base_color: [1.0; 3],
        texture: None,
        alpha_cutoff: None,
        emissive: [0.0; 3],
        lidar: LidarResponse::Diffuse,
    }
}
