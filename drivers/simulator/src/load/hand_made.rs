//! A small hand-made home for tests, written as OBJ and as GLB.
//!
//! Two rooms of 5 x 4 m and 3 x 4 m share a wall with a door of 1 m. The floor has a texture, and a
//! table of 1 x 1 m stands in the middle of the larger room. The floor is 0.5 m above the origin.

use tempfile::TempDir;

/// Height of the floor in the files, metres.
pub(crate) const FLOOR_M: f64 = 0.5;
/// Floor area of both rooms and the doorway without the table, square metres.
pub(crate) const FREE_M2: f64 = 20.0 + 12.0 - 1.0;
/// Centres of the two rooms in the world with z up, metres. The first is next to the table.
pub(crate) const ROOMS_M: [[f64; 2]; 2] = [[1.0, 2.0], [6.5, 2.0]];
/// Number of triangles of the home.
pub(crate) const TRIANGLES: usize = 2 * 13;

/// A rectangle by its four corners, counter-clockwise, metres, z up.
type Face = [[f32; 3]; 4];

fn wall(from: [f32; 2], to: [f32; 2], low_m: f32, high_m: f32) -> Face {
    [
        [from[0], from[1], low_m],
        [to[0], to[1], low_m],
        [to[0], to[1], high_m],
        [from[0], from[1], high_m],
    ]
}

fn level(min: [f32; 2], max: [f32; 2], height_m: f32) -> Face {
    [
        [min[0], min[1], height_m],
        [max[0], min[1], height_m],
        [max[0], max[1], height_m],
        [min[0], max[1], height_m],
    ]
}

/// All faces; the first two are the floors of the two rooms.
fn faces() -> Vec<Face> {
    let floor = FLOOR_M as f32;
    let ceiling = floor + 2.5;
    let table = floor + 0.7;
    vec![
        level([0.0, 0.0], [5.0, 4.0], floor),
        level([5.0, 0.0], [8.0, 4.0], floor),
        wall([0.0, 0.0], [8.0, 0.0], floor, ceiling),
        wall([8.0, 0.0], [8.0, 4.0], floor, ceiling),
        wall([8.0, 4.0], [0.0, 4.0], floor, ceiling),
        wall([0.0, 4.0], [0.0, 0.0], floor, ceiling),
        wall([5.0, 0.0], [5.0, 1.5], floor, ceiling),
        wall([5.0, 2.5], [5.0, 4.0], floor, ceiling),
        wall([2.0, 1.5], [3.0, 1.5], floor, table),
        wall([3.0, 1.5], [3.0, 2.5], floor, table),
        wall([3.0, 2.5], [2.0, 2.5], floor, table),
        wall([2.0, 2.5], [2.0, 1.5], floor, table),
        level([2.0, 1.5], [3.0, 2.5], table),
    ]
}

/// The home with y up, as glTF and most OBJ exporters write it.
fn y_up([x, y, z]: [f32; 3]) -> [f32; 3] {
    [x, z, -y]
}

const UV: [[f32; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];

/// Writes `home.obj`, `home.mtl`, `floor.png` and `home.glb` to a folder.
pub(crate) fn folder(png: &[u8]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let files: [(&str, Vec<u8>); 4] = [
        ("home.obj", obj().into_bytes()),
        ("home.mtl", b"newmtl floor\nmap_Kd floor.png\nnewmtl wall\nKd 0.5 0.5 0.5\n".to_vec()),
        ("floor.png", png.to_vec()),
        ("home.glb", glb(png)),
    ];
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    folder
}

fn obj() -> String {
    let mut text = String::from("mtllib home.mtl\n");
    for face in faces() {
        for (corner, [u, v]) in face.into_iter().zip(UV) {
            let [x, y, z] = y_up(corner);
            text += &format!("v {x} {y} {z}\nvt {u} {v}\n");
        }
    }
    for index in 0..faces().len() {
        let corners: Vec<String> =
            (1..=4).map(|corner| format!("{0}/{0}", 4 * index + corner)).collect();
        let material = if index < 2 { "floor" } else { "wall" };
        text += &format!("usemtl {material}\nf {}\n", corners.join(" "));
    }
    text
}

/// A GLB file with two primitives, the floors and the other faces, and an embedded texture.
fn glb(png: &[u8]) -> Vec<u8> {
    let faces = faces();
    let mut data = Vec::new();
    let mut views = Vec::new();
    let mut accessors = Vec::new();
    let mut primitives = Vec::new();
    for (material, part) in [&faces[..2], &faces[2..]].into_iter().enumerate() {
        let corners = 4 * part.len();
        let positions = part.iter().flatten().flat_map(|corner| y_up(*corner));
        let uv = part.iter().flat_map(|_| UV.into_iter().flatten());
        let indices = (0..part.len()).flat_map(|face| [0, 1, 2, 0, 2, 3].map(|i| 4 * face + i));
        let first = views.len();
        for (bytes, kind, component, count) in [
            (positions.flat_map(f32::to_le_bytes).collect::<Vec<u8>>(), "VEC3", 5126, corners),
            (uv.flat_map(f32::to_le_bytes).collect(), "VEC2", 5126, corners),
            (
                indices.flat_map(|index| (index as u16).to_le_bytes()).collect(),
                "SCALAR",
                5123,
                6 * part.len(),
            ),
        ] {
            let view = views.len();
            views.push(add_view(&mut data, &bytes));
            accessors.push(format!(
                r#"{{"bufferView":{view},"componentType":{component},"count":{count},"type":"{kind}"}}"#
            ));
        }
        primitives.push(format!(
            r#"{{"attributes":{{"POSITION":{first},"TEXCOORD_0":{}}},"indices":{},"material":{material}}}"#,
            first + 1,
            first + 2
        ));
    }
    let image_view = views.len();
    views.push(add_view(&mut data, png));
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{}]}}],"accessors":[{}],"bufferViews":[{}],
        "buffers":[{{"byteLength":{}}}],
        "images":[{{"bufferView":{image_view},"mimeType":"image/png"}}],"textures":[{{"source":0}}],
        "materials":[{{"name":"floor","pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}},
            {{"name":"wall","pbrMetallicRoughness":{{"baseColorFactor":[0.5,0.5,0.5,1]}}}}]}}"#,
        primitives.join(","),
        accessors.join(","),
        views.join(","),
        data.len()
    );
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    data.resize(data.len().next_multiple_of(4), 0);
    let length = 12 + 8 + json.len() + 8 + data.len();
    let mut file = b"glTF".to_vec();
    file.extend(2_u32.to_le_bytes());
    file.extend((length as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", data)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    file
}

/// Appends bytes to the binary chunk at a multiple of 4 and returns their buffer view.
fn add_view(data: &mut Vec<u8>, bytes: &[u8]) -> String {
    data.resize(data.len().next_multiple_of(4), 0);
    let offset = data.len();
    data.extend(bytes);
    format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{}}}"#, bytes.len())
}
