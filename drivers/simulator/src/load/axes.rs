//! Detection and conversion of the up axis.

use std::collections::BTreeMap;

use crate::scene::Triangle;

/// Which axis of a file points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpAxis {
    /// Detect the axis. glTF is y up by its specification, unless the level surfaces indicate z by
    /// a factor of three: exports of Matterport3D keep the z axis of the scan. OBJ does not define
    /// an up axis, so the axis with more level surface is used.
    #[default]
    Auto,
    /// y points up.
    Y,
    /// z points up.
    Z,
}

/// Ratio of level surface along z to that along y above which a glTF file is taken as z up.
const Z_UP_RATIO: f64 = 3.0;

/// Ratio of level surface along the other axis to that along the requested one above which the request is doubted.
const DOUBTED_RATIO: f64 = 2.0;

/// Replaces [`UpAxis::Auto`] by the detected axis. The largest flat surface of a home at one height
/// is its floor.
pub fn resolve(requested: UpAxis, is_gltf: bool, triangles: &[Triangle]) -> UpAxis {
    let y = largest_level_area(triangles, 1);
    let z = largest_level_area(triangles, 2);
    if requested != UpAxis::Auto {
        if let Some(doubt) = doubt(requested, is_gltf, y, z) {
            tracing::warn!("{doubt}");
        }
        return requested;
    }
    let detected = detect(is_gltf, y, z);
    if is_gltf && detected == UpAxis::Z {
        tracing::warn!(
            "the scene's level surfaces indicate that z points up, contrary to the glTF specification; using z"
        );
    }
    detected
}

/// The up axis, from the largest level surfaces along y and z.
fn detect(is_gltf: bool, y: f64, z: f64) -> UpAxis {
    let needed = if is_gltf { Z_UP_RATIO * y } else { y };
    if z > needed { UpAxis::Z } else { UpAxis::Y }
}

/// Why the requested axis is probably wrong, from the largest level surfaces along y and z. The robot would drive on a wall.
fn doubt(requested: UpAxis, is_gltf: bool, y: f64, z: f64) -> Option<String> {
    let (axis, own, other_axis, other) =
        if requested == UpAxis::Z { ("z", z, "y", y) } else { ("y", y, "z", z) };
    if other > DOUBTED_RATIO * own {
        return Some(format!(
            "{axis} was requested as the up axis, but the largest level surface is {:.1} times as large along {other_axis}: if \
             the robot drives on a wall, request {other_axis} or no axis",
            other / own.max(f64::MIN_POSITIVE)
        ));
    }
    let contradicts_gltf = is_gltf && requested == UpAxis::Z && detect(is_gltf, y, z) == UpAxis::Y;
    contradicts_gltf.then(|| {
        format!(
            "z was requested as the up axis, but y points up in glTF files, and the largest level surface is less than \
             {Z_UP_RATIO} times as large along z: if the robot drives on a wall, request y or no axis"
        )
    })
}

/// Converts the file's axes to z up and its units to metres.
pub fn apply(up: UpAxis, scale: f32, triangles: &mut [Triangle]) {
    for vertex in triangles.iter_mut().flat_map(|t| &mut t.vertices) {
        let [x, y, z] = vertex.position_m;
        let rotated = if up == UpAxis::Z { [x, y, z] } else { [x, -z, y] };
        vertex.position_m = rotated.map(|c| c * scale);
    }
}

/// Largest area of surfaces within 15 degrees of level in one slice of the scene. A slice is a
/// 200th of the scene's height.
fn largest_level_area(triangles: &[Triangle], axis: usize) -> f64 {
    let heights: Vec<f64> = triangles
        .iter()
        .map(|triangle| {
            triangle.vertices.iter().map(|v| f64::from(v.position_m[axis])).sum::<f64>() / 3.0
        })
        .collect();
    let mut sorted = heights.clone();
    sorted.sort_by(f64::total_cmp);
    // Ignores the outermost percent: a stray vertex far away would make the slices too thick.
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

/// Normal of a triangle with a length of twice its area.
pub(crate) fn doubled_area_vector(triangle: &Triangle) -> [f64; 3] {
    let [a, b, c] = triangle.vertices.map(|v| v.position_m.map(f64::from));
    let u: [f64; 3] = std::array::from_fn(|i| b[i] - a[i]);
    let v: [f64; 3] = std::array::from_fn(|i| c[i] - a[i]);
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_requested_axis_is_doubted_when_the_floor_lies_along_the_other_one() {
        assert_eq!(doubt(UpAxis::Z, false, 20.0, 80.0), None);
        assert_eq!(doubt(UpAxis::Y, false, 60.0, 80.0), None, "walls and floor of one size");
        let said = doubt(UpAxis::Z, false, 80.0, 25.0).unwrap();
        assert!(said.contains("3.2 times as large along y"), "{said}");
        assert!(doubt(UpAxis::Y, true, 25.0, 80.0).unwrap().contains("request z"));
    }

    #[test]
    fn z_is_doubted_in_a_gltf_file_unless_its_floor_lies_along_z() {
        assert!(doubt(UpAxis::Z, true, 60.0, 60.0).unwrap().contains("y points up in glTF"));
        assert!(doubt(UpAxis::Z, true, 80.0, 25.0).unwrap().contains("3.2 times as large along y"));
        assert!(doubt(UpAxis::Z, true, 60.0, 110.0).is_some());
        assert_eq!(doubt(UpAxis::Z, true, 20.0, 80.0), None);
        assert_eq!(doubt(UpAxis::Y, true, 60.0, 60.0), None);
    }
}
