//! glTF 2.0 and its binary form GLB.
//!
//! The `gltf` crate parses the document's structure. Buffers are read here, because the crate's
//! readers panic on malformed documents, and scene files are untrusted.

mod accessor;
mod container;
mod material;

use std::path::Path;

use gltf::json::{Index, Node, mesh};
use nalgebra::{Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use self::container::File;
use self::material::Materials;
use crate::error::SceneError;
use crate::scene::{Scene, Triangle};

/// Reads all triangles of the default scene with node transforms applied, in the file's axes and
/// units.
pub fn read(path: &Path) -> Result<Scene, SceneError> {
    let file = File::open(path)?;
    let mut scene = Scene::default();
    let mut materials = Materials::new(&file);
    for (node, t_world_node) in placed_nodes(&file)? {
        let Some(mesh) = node.mesh else { continue };
        for primitive in &file.get(mesh, "mesh")?.primitives {
            add_primitive(&file, primitive, &t_world_node, &mut materials, &mut scene)?;
        }
    }
    materials.finish(&mut scene)?;
    Ok(scene)
}

/// Every node of the default scene with its world transform. A node that is reached twice is an
/// error; otherwise a cycle would never end.
fn placed_nodes(file: &File) -> Result<Vec<(&Node, Matrix4<f64>)>, SceneError> {
    let root = &file.root;
    let scene = root.scene.map_or(root.scenes.first(), |index| root.get(index));
    let roots: Vec<Index<Node>> = match scene {
        Some(scene) => scene.nodes.clone(),
        None => {
            let children: Vec<_> =
                root.nodes.iter().filter_map(|n| n.children.as_ref()).flatten().collect();
            (0..root.nodes.len())
                .filter(|&i| !children.iter().any(|child| child.value() == i))
                .map(|i| Index::new(i as u32))
                .collect()
        }
    };
    let mut seen = vec![false; root.nodes.len()];
    let mut placed = Vec::with_capacity(root.nodes.len());
    let mut stack: Vec<_> =
        roots.into_iter().rev().map(|index| (index, Matrix4::identity())).collect();
    while let Some((index, t_world_parent)) = stack.pop() {
        let node = file.get(index, "node")?;
        if std::mem::replace(&mut seen[index.value()], true) {
            return Err(file.malformed(format!(
                "node {} has two parents or is its own ancestor",
                index.value()
            )));
        }
        let t_world_node = t_world_parent * local_transform(node);
        stack.extend(node.children.iter().flatten().rev().map(|&child| (child, t_world_node)));
        placed.push((node, t_world_node));
    }
    Ok(placed)
}

fn local_transform(node: &Node) -> Matrix4<f64> {
    if let Some(matrix) = node.matrix {
        return Matrix4::from_column_slice(&matrix.map(f64::from));
    }
    let [x, y, z] = node.translation.unwrap_or_default().map(f64::from);
    let [i, j, k, w] = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |q| q.0).map(f64::from);
    let scale = Vector3::from(node.scale.unwrap_or([1.0; 3]).map(f64::from));
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Translation3::new(x, y, z).to_homogeneous()
        * rotation.to_homogeneous()
        * Matrix4::new_nonuniform_scaling(&scale)
}

fn add_primitive(
    file: &File,
    primitive: &mesh::Primitive,
    t_world_node: &Matrix4<f64>,
    materials: &mut Materials<'_>,
    scene: &mut Scene,
) -> Result<(), SceneError> {
    use mesh::Semantic;
    let Some(positions) = attribute(Semantic::Positions, primitive) else { return Ok(()) };
    let positions: Vec<[f32; 3]> = file.floats(positions)?;
    let corners = match primitive.indices {
        Some(indices) => file.indices(indices)?,
        None => (0..positions.len() as u32).collect(),
    };
    let triangles = assemble(primitive, &corners);
    if let Some(&bad) = triangles.iter().flatten().find(|&&c| c as usize >= positions.len()) {
        return Err(
            file.malformed(format!("a triangle uses vertex {bad} of {} vertices", positions.len()))
        );
    }
    if triangles.is_empty() {
        return Ok(());
    }
    let surface = materials.surface(primitive.material, scene)?;
    let uv = attribute(Semantic::TexCoords(surface.uv_set), primitive)
        .map(|index| file.floats::<2>(index))
        .transpose()?;
    let colors = attribute(Semantic::Colors(0), primitive).filter(|_| !surface.is_textured);
    let colors = colors.map(|index| file.floats::<3>(index)).transpose()?;
    for triangle in triangles {
        let vertices = triangle.map(|corner| {
            let corner = corner as usize;
            let world =
                t_world_node.transform_point(&Point3::from(positions[corner].map(f64::from)));
            let uv = uv.as_ref().and_then(|uv| uv.get(corner)).copied().unwrap_or_default();
            super::corner(
                [world.x as f32, world.y as f32, world.z as f32],
                surface.transform_uv(uv),
            )
        });
        let material = match &colors {
            Some(colors) => materials.color(&surface, triangle, colors, scene),
            None => surface.material,
        };
        scene.triangles.push(Triangle { vertices, material });
    }
    Ok(())
}

fn attribute(
    semantic: mesh::Semantic,
    primitive: &mesh::Primitive,
) -> Option<Index<gltf::json::Accessor>> {
    primitive.attributes.get(&gltf::json::validation::Checked::Valid(semantic)).copied()
}

/// Corner indices of every triangle of a list, strip or fan. Points and lines have none.
fn assemble(primitive: &mesh::Primitive, corners: &[u32]) -> Vec<[u32; 3]> {
    use gltf::json::validation::Checked::Valid;
    match primitive.mode {
        Valid(mesh::Mode::Triangles) => corners.as_chunks::<3>().0.to_vec(),
        Valid(mesh::Mode::TriangleStrip) => corners.array_windows().copied().collect(),
        Valid(mesh::Mode::TriangleFan) => match corners {
            [hub, rim @ ..] => rim.array_windows().map(|[a, b]| [*hub, *a, *b]).collect(),
            [] => Vec::new(),
        },
        _ => Vec::new(),
    }
}
