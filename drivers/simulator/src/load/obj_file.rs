//! Wavefront OBJ with MTL materials.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use super::texture::decode;
use super::vertex_color::ColorAtlas;
use super::{corner, read_bytes};
use crate::error::SceneError;
use crate::scene::{LidarResponse, Material, Scene, Triangle};

/// Materials with less opacity than this are clear glass.
const CLEAR_DISSOLVE: f32 = 0.5;

const TRIANGLES: tobj::LoadOptions = tobj::LoadOptions {
    single_index: true,
    triangulate: true,
    ignore_points: true,
    ignore_lines: true,
};

/// Reads all faces in the file's axes and units. Vertex colours are taken as sRGB, as MeshLab
/// writes them.
pub fn read(path: &Path) -> Result<Scene, SceneError> {
    let file = std::fs::File::open(path)
        .map_err(|source| SceneError::Read { path: path.into(), source })?;
    let libraries = Libraries { scene: path, error: RefCell::new(None) };
    let loaded =
        tobj::load_obj_buf(&mut BufReader::new(file), &TRIANGLES, |name| libraries.load(name));
    let (models, materials) = loaded.map_err(|error| malformed(path, error.to_string()))?;
    if let Some(error) = libraries.error.into_inner() {
        return Err(error);
    }
    let mut scene = Scene::default();
    read_materials(path, &materials.unwrap_or_default(), &mut scene)?;
    let mut atlas = ColorAtlas::default();
    // Triangles with vertex colours: (triangle, block of the atlas).
    let mut colored = Vec::new();
    for tobj::Model { mesh, name } in &models {
        let default = scene.materials.len() as u32 - 1;
        let material = mesh.material_id.map_or(default, |id| id as u32);
        let has_colors =
            !mesh.vertex_color.is_empty() && scene.materials[material as usize].texture.is_none();
        for triangle in mesh.indices.as_chunks::<3>().0 {
            let vertices = triangle.map(|index| {
                let position = array::<3>(&mesh.positions, index)?;
                let [u, v] = array::<2>(&mesh.texcoords, index).unwrap_or_default();
                Some(corner(position, [u, 1.0 - v]))
            });
            let [Some(a), Some(b), Some(c)] = vertices else {
                return Err(malformed(
                    path,
                    format!("a face of '{name}' uses a vertex that does not exist"),
                ));
            };
            if has_colors {
                let colors =
                    triangle.map(|index| array::<3>(&mesh.vertex_color, index).unwrap_or([1.0; 3]));
                let block = atlas.push(
                    colors.map(|color| color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8)),
                );
                colored.push((scene.triangles.len(), block));
            }
            scene.triangles.push(Triangle { vertices: [a, b, c], material });
        }
    }
    apply_colors(&mut scene, atlas, &colored);
    Ok(scene)
}

fn array<const N: usize>(values: &[f32], index: u32) -> Option<[f32; N]> {
    values.as_chunks::<N>().0.get(index as usize).copied()
}

fn malformed(path: &Path, problem: String) -> SceneError {
    SceneError::Malformed { path: path.into(), format: "OBJ", problem }
}

/// Loads the material libraries of the scene. Keeps the first error, because `tobj` would continue
/// without the library.
struct Libraries<'a> {
    scene: &'a Path,
    error: RefCell<Option<SceneError>>,
}

impl Libraries<'_> {
    fn load(&self, name: &Path) -> tobj::MTLLoadResult {
        let file = beside(self.scene, &name.to_string_lossy());
        let bytes = if file.is_file() {
            read_bytes(&file)
        } else {
            Err(SceneError::MissingFile {
                path: self.scene.into(),
                what: "material library",
                file: file.clone(),
            })
        };
        let parsed = bytes.and_then(|bytes| {
            tobj::load_mtl_buf(&mut bytes.as_slice())
                .map_err(|error| malformed(&file, error.to_string()))
        });
        match parsed {
            Ok((mut materials, names)) => {
                for texture_name in materials.iter_mut().filter_map(|m| m.diffuse_texture.as_mut())
                {
                    *texture_name =
                        beside(&file, without_options(texture_name)).to_string_lossy().into_owned();
                }
                Ok((materials, names))
            }
            Err(error) => {
                self.error.borrow_mut().get_or_insert(error);
                Ok(Default::default())
            }
        }
    }
}

/// Path of a file that is referenced by another file. Windows exporters write backslashes.
fn beside(file: &Path, name: &str) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).join(name.trim().replace('\\', "/"))
}

/// `map_Kd -s 1 1 1 wood.png` is `wood.png`.
fn without_options(value: &str) -> &str {
    let value = value.trim();
    if value.starts_with('-') { value.split_whitespace().last().unwrap_or(value) } else { value }
}

/// Reads the library's materials in order, and appends a white one for faces without material.
fn read_materials(
    path: &Path,
    materials: &[tobj::Material],
    scene: &mut Scene,
) -> Result<(), SceneError> {
    let mut known = BTreeMap::<&str, u32>::new();
    for material in materials {
        let texture = match material.diffuse_texture.as_deref() {
            None => None,
            Some(name) if known.contains_key(name) => known.get(name).copied(),
            Some(name) => {
                let file = Path::new(name);
                if !file.is_file() {
                    return Err(SceneError::MissingFile {
                        path: path.into(),
                        what: "texture",
                        file: file.into(),
                    });
                }
                scene.textures.push(decode(path, name, &read_bytes(file)?)?);
                known.insert(name, scene.textures.len() as u32 - 1);
                known.get(name).copied()
            }
        };
        // When there is a texture, exporters leave Kd at an arbitrary value, often black.
        let base_color =
            if texture.is_some() { [1.0; 3] } else { material.diffuse.unwrap_or([0.8; 3]) };
        let emissive = material.emissive.unwrap_or_default();
        scene.materials.push(Material {
            name: material.name.clone(),
            base_color,
            texture,
            alpha_cutoff: None,
            emissive,
            lidar: match material.dissolve {
                Some(dissolve) if dissolve < CLEAR_DISSOLVE => LidarResponse::Glass,
                _ => LidarResponse::Diffuse,
            },
        });
    }
    let white = Material {
        name: "without material".into(),
        base_color: [1.0; 3],
        texture: None,
        alpha_cutoff: None,
        emissive: [0.0; 3],
        lidar: LidarResponse::Diffuse,
    };
    scene.materials.push(white);
    Ok(())
}

/// Assigns all triangles with vertex colours one material that uses the atlas.
fn apply_colors(scene: &mut Scene, atlas: ColorAtlas, colored: &[(usize, usize)]) {
    if colored.is_empty() {
        return;
    }
    for &(triangle, block) in colored {
        let triangle = &mut scene.triangles[triangle];
        triangle.material = scene.materials.len() as u32;
        for (vertex, uv) in triangle.vertices.iter_mut().zip(atlas.uv(block)) {
            vertex.uv = uv;
        }
    }
    scene.textures.push(atlas.into_texture());
    scene.materials.push(Material {
        name: "vertex colours".into(),
        base_color: [1.0; 3],
        texture: Some(scene.textures.len() as u32 - 1),
        alpha_cutoff: None,
        emissive: [0.0; 3],
        lidar: LidarResponse::Diffuse,
    });
}
