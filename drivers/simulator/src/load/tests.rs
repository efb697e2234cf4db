use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::*;

/// A folder with files in it.
fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        std::fs::write(dir.path().join(name), bytes).unwrap();
    }
    dir
}

fn open(dir: &TempDir, name: &str) -> Result<Loaded, SceneError> {
    load(&dir.path().join(name), &LoadOptions::default())
}

fn message(result: Result<Loaded, SceneError>) -> String {
    result.map(|loaded| loaded.scene.triangles.len()).unwrap_err().to_string()
}

/// Two by one pixels: red, blue.
pub(crate) fn png() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image = image::RgbImage::from_raw(2, 1, vec![255, 0, 0, 0, 0, 255]).unwrap();
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// A level square of 4 m in the plane y = `height`, with texture coordinates.
fn square_obj(height: f64, extra: &str) -> String {
    let corners = [(0, 0), (4, 0), (4, 4), (0, 4)];
    let v: String = corners
        .iter()
        .map(|(x, z)| format!("v {x} {height} {z}\nvt {} {}\n", x / 4, z / 4))
        .collect();
    format!("{extra}\n{v}f 1/1 2/2 3/3 4/4\n")
}

#[test]
fn an_obj_becomes_triangles_with_z_up_and_v_downwards() {
    let dir = folder(&[
        ("a.obj", square_obj(1.5, "mtllib a.mtl\nusemtl wood").as_bytes()),
        ("a.mtl", b"newmtl wood\nKd 0 0 0\nmap_Kd -s 1 1 1 wood.png\n"),
        ("wood.png", &png()),
    ]);
    let loaded = open(&dir, "a.obj").unwrap();
    assert_eq!((loaded.up_axis, loaded.scene.triangles.len()), (UpAxis::Y, 2));
    let triangle = &loaded.scene.triangles[0];
    assert_eq!(triangle.vertices[2].position_m, [4.0, -4.0, 1.5]);
    assert_eq!(triangle.vertices[2].uv, [1.0, 0.0]);
    let material = &loaded.scene.materials[triangle.material as usize];
    assert_eq!((material.base_color, material.texture), ([1.0; 3], Some(0)));
    assert_eq!(loaded.scene.textures[0].rgba, [255, 0, 0, 255, 0, 0, 255, 255]);
}

#[test]
fn the_larger_level_surface_tells_an_objs_up_axis() {
    let z_up = "v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nv 9 0 2\nv 0 0 2\nf 1 2 3 4\nf 1 2 5 6\n";
    let dir = folder(&[("z.obj", z_up.as_bytes())]);
    let loaded = open(&dir, "z.obj").unwrap();
    assert_eq!(loaded.up_axis, UpAxis::Z);
    assert_eq!(loaded.scene.triangles[0].vertices[2].position_m, [9.0, 9.0, 0.0]);
    let options = LoadOptions { up_axis: UpAxis::Y, scale: 0.5 };
    let forced = load(&dir.path().join("z.obj"), &options).unwrap();
    assert_eq!(forced.scene.triangles[0].vertices[2].position_m, [4.5, 0.0, 4.5]);
}

#[test]
fn vertex_colours_of_an_obj_become_a_texture() {
    let dir = folder(&[("c.obj", b"v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 0 1 0 0 1\nf 1 2 3\n")]);
    let scene = open(&dir, "c.obj").unwrap().scene;
    let material = &scene.materials[scene.triangles[0].material as usize];
    let texture = &scene.textures[material.texture.unwrap() as usize];
    let shown = scene.triangles[0].vertices.map(|vertex| {
        let x = vertex.uv[0] * texture.width as f32;
        let y = vertex.uv[1] * texture.height as f32;
        let texel = (y as u32 * texture.width + x as u32) as usize;
        [texture.rgba[4 * texel], texture.rgba[4 * texel + 1], texture.rgba[4 * texel + 2]]
    });
    assert_eq!(shown, [[255, 0, 0], [0, 255, 0], [0, 0, 255]]);
}

#[test]
fn what_is_missing_is_named() {
    let dir = folder(&[
        ("a.obj", square_obj(0.0, "mtllib gone.mtl").as_bytes()),
        ("b.obj", square_obj(0.0, "mtllib b.mtl\nusemtl m").as_bytes()),
        ("b.mtl", b"newmtl m\nmap_Kd textures\\gone.png\n"),
        ("c.gltf", gltf("", r#","uri":"gone.bin""#).as_bytes()),
        ("d.gltf", gltf(TEXTURED, "").replace("IMAGE", r#""uri":"gone%20too.jpg""#).as_bytes()),
    ]);
    assert!(message(open(&dir, "a.obj")).contains("material library"));
    assert!(message(open(&dir, "a.obj")).contains("gone.mtl"));
    assert!(message(open(&dir, "b.obj")).contains("textures/gone.png"));
    assert!(message(open(&dir, "c.gltf")).contains("gone.bin"));
    assert!(message(open(&dir, "d.gltf")).contains("gone too.jpg"));
    assert!(matches!(open(&dir, "e.glb"), Err(SceneError::NotFound { .. })));
    assert!(matches!(open(&dir, "e.ply"), Err(SceneError::UnknownFormat { .. })));
}

/// One triangle (0 0 0) (1 0 0) (0 0 -1) with uv, twice in the scene: unchanged, and translated,
/// rotated and scaled.
fn gltf(more: &str, buffer_uri: &str) -> String {
    let positions = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0];
    let uv = [0.0_f32, 0.0, 1.0, 0.0, 0.0, 1.0];
    let mut bytes: Vec<u8> = positions.iter().chain(&uv).flat_map(|f| f.to_le_bytes()).collect();
    bytes.extend([0, 1, 2, 0]);
    let embedded = format!(r#","uri":"data:application/octet-stream;base64,{}""#, base64(&bytes));
    let uri = if buffer_uri.is_empty() { &embedded } else { buffer_uri };
    let material = if more.is_empty() { "" } else { r#","material":0"# };
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,1]}}],
        "nodes":[{{"mesh":0}},{{"translation":[0,2,0],"children":[2]}},
                 {{"mesh":0,"rotation":[0,0.70710678,0,0.70710678],"scale":[3,1,1]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2{material}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
                     {{"bufferView":0,"byteOffset":36,"componentType":5126,"count":3,"type":"VEC2"}},
                     {{"bufferView":0,"byteOffset":60,"componentType":5121,"count":3,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteLength":64}}],
        "buffers":[{{"byteLength":64{uri}}}]{more}}}"#
    )
}

const TEXTURED: &str = r#","images":[{IMAGE}],"textures":[{"source":0}],
    "materials":[{"name":"m","alphaMode":"MASK","pbrMetallicRoughness":{"baseColorFactor":[0.5,1,1,1],"baseColorTexture":
    {"index":0,"extensions":{"KHR_texture_transform":{"offset":[0.5,0],"scale":[2,2],"rotation":1.5707964}}}}}]"#;

fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0, |w, &b| w << 8 | u32::from(b)) << (8 * (3 - chunk.len()));
        text.extend((0..4).map(|i| {
            let digit = (word >> (18 - 6 * i)) as usize & 63;
            if i <= chunk.len() { char::from(ALPHABET[digit]) } else { '=' }
        }));
    }
    text
}

#[test]
fn gltf_nodes_place_their_meshes() {
    let dir = folder(&[("a.gltf", gltf("", "").as_bytes())]);
    let scene = open(&dir, "a.gltf").unwrap().scene;
    // z up: (x, -z, y).
    assert_eq!(rounded_corners(0, &scene), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    // Scaled by 3 along x, rotated left by 90 degrees (x to -z), translated up by 2.
    assert_eq!(rounded_corners(1, &scene), [[0.0, 0.0, 2.0], [0.0, 3.0, 2.0], [-1.0, 0.0, 2.0]]);
}

fn rounded_corners(i: usize, scene: &Scene) -> [[f32; 3]; 3] {
    scene.triangles[i].vertices.map(|v| v.position_m.map(|c| (c * 1e4).round() / 1e4 + 0.0))
}

#[test]
fn gltf_textures_factors_and_texture_transforms_are_kept() {
    let image = format!(r#""uri":"data:image/png;base64,{}""#, base64(&png()));
    let dir = folder(&[
        ("a.gltf", gltf(TEXTURED, "").replace("IMAGE", &image).as_bytes()),
        ("b.gltf", gltf(TEXTURED, "").replace("IMAGE", r#""uri":"wood%20floor.png""#).as_bytes()),
        ("wood floor.png", &png()),
    ]);
    for name in ["a.gltf", "b.gltf"] {
        let scene = open(&dir, name).unwrap().scene;
        assert_eq!(scene.textures[0].rgba[..4], [255, 0, 0, 255]);
        assert_eq!(scene.materials[0].base_color, [0.5, 1.0, 1.0]);
        assert_eq!(scene.materials[0].alpha_cutoff, Some(0.5));
        // (1, 0) scaled to (2, 0), rotated to (0, -2), translated to (0.5, -2).
        let [u, v] = scene.triangles[0].vertices[1].uv;
        assert!((u - 0.5).abs() < 1e-6 && (v + 2.0).abs() < 1e-6, "{u} {v}");
    }
}

#[test]
fn vertex_colours_of_a_gltf_become_a_texture() {
    let text = gltf("", "").replace(r#""TEXCOORD_0":1"#, r#""COLOR_0":0"#);
    let scene = open(&folder(&[("a.gltf", text.as_bytes())]), "a.gltf").unwrap().scene;
    let texture = &scene.textures
        [scene.materials[scene.triangles[1].material as usize].texture.unwrap() as usize];
    assert_eq!((texture.width, texture.height), (4, 2));
    // The second corner's colour is (1, 0, 0).
    assert_eq!(texture.rgba[4..8], [255, 0, 0, 255]);
}

#[test]
fn compressed_geometry_and_pictures_are_refused_with_the_way_out() {
    let basis = gltf(TEXTURED, "").replace("IMAGE", r#""uri":"a.ktx2""#);
    let dir = folder(&[
        ("draco.gltf", requiring_extension("KHR_draco_mesh_compression").as_bytes()),
        ("meshopt.gltf", requiring_extension("EXT_meshopt_compression").as_bytes()),
        ("basis.gltf", requiring_extension("KHR_texture_basisu").as_bytes()),
        ("ktx.gltf", basis.as_bytes()),
        ("a.ktx2", b"\xabKTX 20\xbb\r\n\x1a\n"),
    ]);
    for (name, words) in [
        ("draco.gltf", ["KHR_draco_mesh_compression", "gltf-transform copy"]),
        ("meshopt.gltf", ["EXT_meshopt_compression", "gltf-transform copy"]),
        ("basis.gltf", ["KHR_texture_basisu", "gltf-transform png"]),
        ("ktx.gltf", ["a.ktx2", "KTX2"]),
    ] {
        let text = message(open(&dir, name));
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
    }
}

fn requiring_extension(name: &str) -> String {
    gltf(&format!(r#","extensionsRequired":["{name}"]"#), "")
}

#[test]
fn damaged_documents_are_errors_not_panics() {
    let sound = gltf("", "");
    let damage = [
        ("\"count\":3", "\"count\":300"),
        ("\"count\":3", "\"count\":18446744073709551615"),
        ("\"byteOffset\":36", "\"byteOffset\":18446744073709551615"),
        ("\"byteLength\":64}", "\"byteLength\":65}"),
        ("\"indices\":2", "\"indices\":9"),
        ("\"indices\":2", "\"indices\":0"),
        ("\"componentType\":5121", "\"componentType\":77"),
        ("\"type\":\"VEC3\"", "\"type\":\"SCALAR\""),
        ("\"children\":[2]", "\"children\":[1]"),
        ("\"children\":[2]", "\"children\":[0]"),
        ("\"mesh\":0", "\"mesh\":5"),
        ("{\"asset\"", "{{\"asset\""),
    ];
    for (from, to) in damage {
        let text = sound.replacen(from, to, 1);
        assert_ne!(text, sound, "{from} is not in the document");
        let error = open(&folder(&[("a.gltf", text.as_bytes())]), "a.gltf")
            .map(|l| l.scene.triangles.len());
        assert!(matches!(error, Err(SceneError::Malformed { .. })), "{to}: {error:?}");
    }
    let not_gltf =
        folder(&[("a.glb", b"solid cube"), ("a.obj", b"f 1 2 3\n"), ("b.obj", b"v 1 2\n")]);
    for name in ["a.glb", "a.obj", "b.obj"] {
        assert!(matches!(open(&not_gltf, name), Err(SceneError::Malformed { .. })), "{name}");
    }
}

#[test]
fn nan_corners_are_dropped_and_counted_and_only_nan_is_refused() {
    let bad = "v nan 0 0\nv 1 0 0\nv 1 0 1\nf 1 2 3\n";
    let mixed = format!("{bad}v 0 0 0\nv 4 0 0\nv 4 0 4\nf 4 5 6\nf 4 2 3\n");
    let dir = folder(&[
        ("bad.obj", bad.as_bytes()),
        ("mixed.obj", mixed.as_bytes()),
        ("empty.obj", b"v 0 0 0\n"),
    ]);
    assert!(matches!(open(&dir, "bad.obj"), Err(SceneError::NotFinite { triangles: 1, .. })));
    let loaded = open(&dir, "mixed.obj").unwrap();
    assert_eq!((loaded.scene.triangles.len(), loaded.dropped_triangles), (2, 1));
    assert!(matches!(open(&dir, "empty.obj"), Err(SceneError::Empty { .. })));
}

#[test]
fn an_impossible_scale_is_refused() {
    for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let result = load(Path::new("any.obj"), &LoadOptions { scale, ..LoadOptions::default() });
        assert!(matches!(result, Err(SceneError::Option { option: "scale", .. })));
    }
}

#[test]
fn a_hand_made_home_loads_alike_from_glb_and_obj() {
    let dir = hand_made::folder(&png());
    for name in ["home.glb", "home.obj"] {
        let loaded = open(&dir, name).unwrap();
        assert_eq!(loaded.up_axis, UpAxis::Y, "{name}");
        assert_eq!(loaded.dropped_triangles, 0, "{name}");
        assert_eq!(loaded.scene.triangles.len(), hand_made::TRIANGLES, "{name}");
        let floor = &loaded.scene.triangles[0];
        assert_eq!(floor.vertices[1].position_m, [5.0, 0.0, hand_made::FLOOR_M as f32], "{name}");
        let material = &loaded.scene.materials[floor.material as usize];
        assert_eq!(material.name, "floor", "{name}");
        assert_eq!(material.texture, Some(0), "{name}");
        let wall = &loaded.scene.triangles[hand_made::TRIANGLES - 1];
        let material = &loaded.scene.materials[wall.material as usize];
        assert_eq!((material.base_color, material.texture), ([0.5; 3], None), "{name}");
        assert_eq!(loaded.scene.textures[0].rgba, [255, 0, 0, 255, 0, 0, 255, 255], "{name}");
    }
}

/// The larger scenes for development, in `EMBODIED_DEPTH_DATA` or the default folder. Tests that call this are ignored;
/// `cargo xtask test` runs them where the scenes are.
pub(crate) fn shared_scenes() -> PathBuf {
    let configured = std::env::var_os("EMBODIED_DEPTH_DATA").map(PathBuf::from);
    let scenes = configured
        .unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"))
        .join("scenes");
    assert!(scenes.is_dir(), "there is no folder {}; set EMBODIED_DEPTH_DATA", scenes.display());
    scenes
}

#[test]
#[ignore = "needs the shared scenes; `cargo xtask test` runs it where they are"]
fn shared_scenes_load() {
    let scenes = shared_scenes();
    for (name, least) in [("bathroom", 100_000), ("living-room", 60_000), ("aws_warehouse", 14_000)]
    {
        let loaded = load(&scenes.join(format!("{name}.glb")), &LoadOptions::default()).unwrap();
        assert!(
            loaded.scene.triangles.len() > least,
            "{name}: {} triangles",
            loaded.scene.triangles.len()
        );
        assert_eq!(loaded.up_axis, UpAxis::Y, "{name}");
    }
}
