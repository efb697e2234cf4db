//! Scene data: triangles, materials and textures.

/// One corner of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Vertex {
    /// Position in the world, metres, z up.
    pub position_m: [f32; 3],
    /// Texture coordinates, which wrap. (0, 0) is the corner of the texture's first pixel and v
    /// grows downwards, as in glTF.
    pub uv: [f32; 2],
    /// Baked ambient light, 0 (dark corner) to 1 (open).
    pub ambient: f32,
}

/// A triangle. Both sides are visible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    pub vertices: [Vertex; 3],
    /// Index of the material in [`Scene::materials`].
    pub material: u32,
}

/// What a laser scanner measures on a surface. A camera sees all surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LidarResponse {
    /// The distance of the surface.
    #[default]
    Diffuse,
    /// The beam passes: clear glass with something behind it.
    Glass,
    /// The beam is absorbed or leaves the scene, and does not return unless it hits the surface almost
    /// perpendicularly: black lacquer, and a window with the open air behind it.
    Absorbing,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    pub name: String,
    /// Linear-light colour, which is multiplied with the texture.
    pub base_color: [f32; 3],
    /// Index of the texture in [`Scene::textures`]; `None` for a plain colour.
    pub texture: Option<u32>,
    /// Texels with alpha below this value are holes; `None` means opaque.
    pub alpha_cutoff: Option<f32>,
    /// Emitted light, linear, added to the reflected light.
    pub emissive: [f32; 3],
    pub lidar: LidarResponse,
}

/// An RGBA8 image, sRGB-coded, row-major, first row on top.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    pub width: u32,
    pub height: u32,
    /// `width * height * 4` bytes.
    pub rgba: Vec<u8>,
}

/// Triangles, materials and textures of a world.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scene {
    pub triangles: Vec<Triangle>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
}
