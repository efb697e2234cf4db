//! Loads scenes from glTF/GLB and OBJ/MTL files.

mod axes;
mod gltf_file;
mod obj_file;
mod texture;
mod vertex_color;

use std::path::Path;

pub use axes::UpAxis;

use crate::error::SceneError;
use crate::scene::{Scene, Triangle, Vertex};

/// Conversion of file coordinates to metres with z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadOptions {
    /// Which axis of the file points up.
    pub up_axis: UpAxis,
    /// Metres in one unit of the file.
    pub scale: f64,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self { up_axis: UpAxis::Auto, scale: 1.0 }
    }
}

/// A scene from a file, in metres with z up. Its floor is not yet shifted to z = 0.
#[derive(Debug)]
pub struct Loaded {
    /// The scene, without the dropped triangles.
    pub scene: Scene,
    /// Axis of the file that was taken as up; never [`UpAxis::Auto`].
    pub up_axis: UpAxis,
    /// Triangles that were dropped because a corner is NaN or infinite.
    pub dropped_triangles: usize,
}

/// Reads a scene. The file extension selects the format.
///
/// Normals and normal maps are not used: lighting follows from the orientation of the triangles.
/// Texture coordinates always wrap.
///
/// # Errors
/// Returns an error when the file or a file that it refers to is missing, damaged or not supported,
/// or when it contains no triangle.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Loaded, SceneError> {
    if !(options.scale.is_finite() && (1e-6..=1e6).contains(&options.scale)) {
        return Err(SceneError::Option {
            option: "scale",
            value: options.scale.to_string(),
            allowed: "a number from 1e-6 to 1e6 (metres in one unit of the file)",
        });
    }
    let extension =
        path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let read: fn(&Path) -> Result<Scene, SceneError> = match extension.as_str() {
        "glb" | "gltf" => gltf_file::read,
        "obj" => obj_file::read,
        _ => return Err(SceneError::UnknownFormat { path: path.into() }),
    };
    if !path.exists() {
        return Err(SceneError::NotFound { path: path.into() });
    }
    let mut scene = read(path)?;
    let triangles = scene.triangles.len();
    if triangles == 0 {
        return Err(SceneError::Empty { scene: path.display().to_string() });
    }
    scene.triangles.retain(is_finite);
    if scene.triangles.is_empty() {
        return Err(SceneError::NotFinite { scene: path.display().to_string(), triangles });
    }
    let dropped_triangles = triangles - scene.triangles.len();
    if dropped_triangles > 0 {
        tracing::warn!(
            scene = path.display().to_string(),
            dropped_triangles,
            "dropped triangles with NaN or infinite corners"
        );
    }
    let up_axis = axes::resolve(options.up_axis, extension != "obj", &scene.triangles);
    axes::apply(up_axis, options.scale as f32, &mut scene.triangles);
    Ok(Loaded { scene, up_axis, dropped_triangles })
}

fn is_finite(triangle: &Triangle) -> bool {
    triangle.vertices.iter().all(|v| v.position_m.iter().chain(&v.uv).all(|c| c.is_finite()))
}

/// A vertex before baking, with full ambient light.
fn corner(position_m: [f32; 3], uv: [f32; 2]) -> Vertex {
    Vertex { position_m, uv, ambient: 1.0 }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, SceneError> {
    std::fs::read(path).map_err(|source| SceneError::Read { path: path.into(), source })
}

#[cfg(test)]
pub(crate) mod hand_made;
#[cfg(test)]
pub(crate) mod tests;
