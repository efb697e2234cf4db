use hal::*;
use nalgebra as na;
use simulator::{people::*, render::*, scene::*};
fn cpu() -> f64 {
    std::fs::read_dir("/proc/self/task")
        .unwrap()
        .map(|t| {
            std::fs::read_to_string(t.unwrap().path().join("schedstat"))
                .unwrap()
                .split(' ')
                .next()
                .unwrap()
                .parse::<f64>()
                .unwrap()
                * 1e-9
        })
        .sum()
}
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let (doc, buffers, images) = gltf::import(&a[1]).unwrap();
    let mut scene = Scene::default();
    for i in images {
        let n = (i.width * i.height) as usize;
        let mut rgba = vec![255u8; n * 4];
        let c = i.pixels.len() / n;
        for k in 0..n {
            for j in 0..c.min(4) {
                rgba[k * 4 + j] = i.pixels[k * c + j];
            }
            if c == 1 {
                rgba[k * 4 + 1] = i.pixels[k];
                rgba[k * 4 + 2] = i.pixels[k];
            }
        }
        scene.textures.push(Texture { width: i.width, height: i.height, rgba });
    }
    for m in doc.materials() {
        let p = m.pbr_metallic_roughness();
        let f = p.base_color_factor();
        scene.materials.push(Material {
            name: "".into(),
            base_color: [f[0], f[1], f[2]],
            texture: p.base_color_texture().map(|t| t.texture().source().index() as u32),
            alpha_cutoff: if m.alpha_mode() == gltf::material::AlphaMode::Opaque { None } else { Some(0.5) },
            emissive: m.emissive_factor(),
        });
    }
    scene.materials.push(Material {
        name: "d".into(),
        base_color: [0.7; 3],
        texture: None,
        alpha_cutoff: None,
        emissive: [0.0; 3],
    });
    fn walk(n: gltf::Node, t: na::Matrix4<f32>, b: &Vec<gltf::buffer::Data>, s: &mut Scene) {
        let m = t * na::Matrix4::from(n.transform().matrix());
        if let Some(mesh) = n.mesh() {
            for p in mesh.primitives() {
                let r = p.reader(|x| Some(&b[x.index()]));
                let pos: Vec<[f32; 3]> = r.read_positions().unwrap().collect();
                let uv: Vec<[f32; 2]> =
                    r.read_tex_coords(0).map(|x| x.into_f32().collect()).unwrap_or(vec![[0.0; 2]; pos.len()]);
                let idx: Vec<u32> =
                    r.read_indices().map(|x| x.into_u32().collect()).unwrap_or((0..pos.len() as u32).collect());
                for t in idx.chunks_exact(3) {
                    s.triangles.push(Triangle {
                        vertices: [0, 1, 2].map(|k| {
                            let i = t[k] as usize;
                            let q = m * na::Vector4::new(pos[i][0], pos[i][1], pos[i][2], 1.0);
                            Vertex { position_m: [q.x, -q.z, q.y], uv: uv[i], ambient: 1.0 }
                        }),
                        material: p.material().index().unwrap_or(s.materials.len() - 1) as u32,
                    });
                }
            }
        }
        for c in n.children() {
            walk(c, m, b, s);
        }
    }
    for n in doc.default_scene().unwrap().nodes() {
        walk(n, na::Matrix4::identity(), &buffers, &mut scene);
    }
    let mut lo = [f32::MAX; 3];
    let mut hi = [f32::MIN; 3];
    for v in scene.triangles.iter().flat_map(|t| t.vertices) {
        for i in 0..3 {
            lo[i] = lo[i].min(v.position_m[i]);
            hi[i] = hi[i].max(v.position_m[i]);
        }
    }
    println!(
        "{} triangles {:?} {:?} textures {} MiB {}",
        scene.triangles.len(),
        lo,
        hi,
        scene.textures.len(),
        scene.textures.iter().map(|t| t.rgba.len()).sum::<usize>() >> 20
    );
    let c0 = cpu();
    let t = std::time::Instant::now();
    if std::env::var("NOBAKE").is_err() {
        bake_ambient(&mut scene, &AmbientOptions::default());
    }
    println!("bake {:?} cpu {:.2} -> {}", t.elapsed(), cpu() - c0, scene.triangles.len());
    let c0 = cpu();
    let t = std::time::Instant::now();
    let r = Renderer::new(&scene);
    println!("build {:?} cpu {:.2}", t.elapsed(), cpu() - c0);
    let f = |i: usize| a[i].parse::<f64>().unwrap();
    let (x, y, yaw) = (f(2), f(3), f(4).to_radians());
    let cam = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
    let (mut rgb, mut d) = (vec![], DepthMap::none(0, 0));
    let mut ppl = vec![];
    if a.len() > 7 {
        ppl.push(Person { stride_rad: 1.0, yaw_rad: 2.0, ..Person::standing(f(6), f(7)) });
    }
    let mut l = Lighting::default();
    if a.len() > 8 {
        l.sun =
            Some(SunPatches { strength: f(8) as f32, direction: [0.6, 0.35, 0.7], size_m: [0.9, 1.4], spacing_m: 3.1 });
    }
    let pose = Pose2::new(x, y, yaw).to_pose3() * camera_mount(0.0, 0.8, 0.0);
    r.render(&cam, &pose, &ppl, &l, &mut rgb, &mut d);
    let mut cpus = vec![];
    let mut best = f64::MAX;
    let mut tot = vec![];
    for k in 0..std::env::var("N").map_or(40, |n| n.parse().unwrap()) {
        let pose = Pose2::new(x, y, yaw + k as f64 * 0.15).to_pose3() * camera_mount(0.0, 0.8, 0.0);
        let c0 = cpu();
        let t = std::time::Instant::now();
        r.render(&cam, &pose, &ppl, &l, &mut rgb, &mut d);
        let e = t.elapsed().as_secs_f64();
        cpus.push(cpu() - c0);
        best = best.min(e);
        tot.push(e);
    }
    tot.sort_by(f64::total_cmp);
    cpus.sort_by(f64::total_cmp);
    println!("cpu per frame min {:.2} median {:.2} max {:.2} ms", cpus[0] * 1e3, cpus[20] * 1e3, cpus[39] * 1e3);
    println!("render min {:.2} ms median {:.2} ms", best * 1e3, tot[20] * 1e3);
    r.render(&cam, &pose, &ppl, &l, &mut rgb, &mut d);
    let mut out = rgb.clone();
    for z in d.values() {
        let v = if *z > 0.0 { (255.0 / (1.0 + z * 0.5)) as u8 } else { 0 };
        out.extend([v, v, v]);
    }
    ::image::RgbImage::from_raw(640, 384, out).unwrap().save(&a[5]).unwrap();
}
