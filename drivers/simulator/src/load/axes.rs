//! Which way is up.

use std::collections::BTreeMap;

use crate::scene::Triangle;

/// The axis of a file that points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpAxis {
    /// glTF is y up by its specification, and so it is taken, unless large level surfaces say very clearly (three to one)
    /// that it is z: exports of Matterport3D keep the z axis of the scan. OBJ says nothing, so the larger level surfaces decide.
    #[default]
    Auto,
    /// y points up.
    Y,
    /// z points up.
    Z,
}

/// How much more level surface z must have than y before a glTF file is not believed.
const DISBELIEF: f64 = 3.0;

/// Replaces [`UpAxis::Auto`] by what the surfaces say. A home has its largest flat surface at one height: the floor.
pub fn resolve(wanted: UpAxis, is_gltf: bool, triangles: &[Triangle]) -> UpAxis {
    if wanted != UpAxis::Auto {
        return wanted;
    }
    let (y, z) = (largest_level_area(triangles, 1), largest_level_area(triangles, 2));
    let needed = if is_gltf { DISBELIEF * y } else { y };
    if z <= needed {
        return UpAxis::Y;
    }
    if is_gltf {
        tracing::warn!(
            "the scene's level surfaces say that z points up, against the glTF specification; using z"
        );
    }
    UpAxis::Z
}

/// Turns the file's axes into z up and its units into metres.
pub fn apply(up: UpAxis, scale: f32, triangles: &mut [Triangle]) {
    for vertex in triangles.iter_mut().flat_map(|t| &mut t.vertices) {
        let [x, y, z] = vertex.position_m;
        let turned = if up == UpAxis::Z { [x, y, z] } else { [x, -z, y] };
        vertex.position_m = turned.map(|c| c * scale);
    }
}

/// Largest area of surfaces within 15 degrees of level that lie in one slice of the scene, a 200th of its height thick.
fn largest_level_area(triangles: &[Triangle], axis: usize) -> f64 {
    let heights: Vec<f64> = triangles
        .iter()
        .map(|triangle| {
            triangle.vertices.iter().map(|v| f64::from(v.position_m[axis])).sum::<f64>() / 3.0
        })
        .collect();
    let mut sorted = heights.clone();
    sorted.sort_by(f64::total_cmp);
    // Without the outermost percent: a stray vertex far away would make the slices too thick to tell anything.
    let trim = sorted.len() / 100;
    let thickness = ((sorted[sorted.len() - 1 - trim] - sorted[trim]) / 200.0).max(1e-9);
    let mut area = BTreeMap::<i64, f64>::new();
    for (triangle, height) in triangles.iter().zip(heights) {
        let normal = doubled_area_vector(triangle);
        let length = normal.iter().map(|c| c * c).sum::<f64>().sqrt();
        if normal[axis].abs() > 0.966 * length {
            *area.entry((height / thickness).floor() as i64).or_default() +=
                normal[axis].abs() / 2.0;
        }
    }
    area.into_values().fold(0.0, f64::max)
}

/// Normal of a triangle, twice its area long.
pub(crate) fn doubled_area_vector(triangle: &Triangle) -> [f64; 3] {
    let [a, b, c] = triangle.vertices.map(|v| v.position_m.map(f64::from));
    let (u, v): ([f64; 3], [f64; 3]) =
        (std::array::from_fn(|i| b[i] - a[i]), std::array::from_fn(|i| c[i] - a[i]));
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}
