//! A world as triangles with textures.

/// One corner of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Vertex {
    /// Position in the world, metres, z up.
    pub position_m: [f32; 3],
    /// Texture coordinates; they wrap. (0, 0) is the texture's first pixel's corner, v grows downwards, as in glTF.
    pub uv: [f32; 2],
    /// Baked ambient light, 0 (dark corner) to 1 (open).
    pub ambient: f32,
}

/// A triangle; both sides are seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    /// Its corners.
    pub vertices: [Vertex; 3],
    /// Index into [`Scene::materials`].
    pub material: u32,
}

/// How a surface looks.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// For error messages.
    pub name: String,
    /// Linear-light colour, multiplied with the texture.
    pub base_color: [f32; 3],
    /// Index into [`Scene::textures`].
    pub texture: Option<u32>,
    /// Texels with alpha below this are holes; `None`: opaque.
    pub alpha_cutoff: Option<f32>,
    /// Light of its own, linear, added.
    pub emissive: [f32; 3],
}

/// A picture on surfaces: RGBA8, sRGB-coded, row-major, first row on top.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height * 4` bytes.
    pub rgba: Vec<u8>,
}

/// Triangles, materials and textures of a world.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scene {
    /// All surfaces.
    pub triangles: Vec<Triangle>,
    /// What triangles refer to.
    pub materials: Vec<Material>,
    /// What materials refer to.
    pub textures: Vec<Texture>,
}
