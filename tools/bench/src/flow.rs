//! Dense optical flow beside OpenCV's, preset by preset, on the very same two pictures.

use anyhow::{Context, Result};
use hal::{ImageView, PixelFormat};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::perception::flow::{DenseFlow, FlowPreset};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing};

const ROOM: &str = "perception";
const WIDTH: usize = 640;
const HEIGHT: usize = 192;
const RUNS: usize = 101;
const PRESETS: [(&str, FlowPreset); 3] =
    [("ultra_fast", FlowPreset::UltraFast), ("fast", FlowPreset::Fast), ("medium", FlowPreset::Medium)];

/// A box before the plane: left, top, right, bottom in the first picture, and its own motion, pixels.
const BOX: [f32; 4] = [250.0, 60.0, 360.0, 150.0];
const BOX_SHIFT: [f32; 2] = [14.0, -3.0];

/// Measures each preset, turn by turn with OpenCV where there is a Python with it.
///
/// # Errors
/// When the pictures cannot be handed to the peer, or it fails.
pub fn rows() -> Result<Vec<Row>> {
    let scene = Scene::new();
    let folder = std::env::temp_dir().join(format!("flow-bench-{}", std::process::id()));
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let measured = measure(&scene, &folder);
    std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
    measured
}

fn measure(scene: &Scene, folder: &std::path::Path) -> Result<Vec<Row>> {
    let file = |name: &str| folder.join(name).display().to_string();
    std::fs::write(file("first"), &scene.first)?;
    std::fs::write(file("second"), &scene.second)?;
    let size = [WIDTH.to_string(), HEIGHT.to_string()];
    let arguments = [file("first"), file("second")];
    let mut peer = PeerProcess::start("opencv_dis.py", &[&arguments[0], &arguments[1], &size[0], &size[1]])?;
    let mut rows = Vec::new();
    for (name, preset) in PRESETS {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT)?;
        let view = |data| ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, data);
        let (first, second) = (view(&scene.first)?, view(&scene.second)?);
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        // The first turn does not count.
        for run in 0..=RUNS {
            let began = std::time::Instant::now();
            engine.flow(first, second, None)?;
            let seconds = began.elapsed().as_secs_f64();
            let peer_seconds = peer.as_mut().map(|peer| peer.seconds(name)).transpose()?;
            if run > 0 {
                ours.push(seconds);
                theirs.extend(peer_seconds);
            }
        }
        let error = scene.error_px(engine.flow(first, second, None)?.values().iter().copied());
        let threads = rayon::current_num_threads();
        let mut row = Row::seconds(ROOM, format!("optical flow {name} 640x192"), Timing::of(ours));
        let mut note = format!("{threads} threads, error {error:.3} px");
        if let Some(peer) = &mut peer {
            let timing = Timing::of(theirs);
            let saved = file(name);
            anyhow::ensure!(peer.ask(&format!("save {name} {saved}"))? == "saved", "opencv_dis.py saved no flow");
            let error = scene.error_px(read_flow(&std::fs::read(&saved)?));
            note += &format!(", OpenCV's {error:.3} px");
            // As fast as the peer is the floor, 0.7 of its time the target.
            row = row.peer("OpenCV DIS", timing.median).goal(timing.median, 0.7 * timing.median);
        }
        rows.push(row.note(note));
    }
    Ok(rows)
}

fn read_flow(bytes: &[u8]) -> impl Iterator<Item = [f32; 2]> {
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    bytes.chunks_exact(8).map(move |pair| [value(&pair[..4]), value(&pair[4..])])
}

/// Two pictures of a textured plane that turns, grows and moves behind a textured box that moves another way.
struct Scene {
    first: Vec<u8>,
    second: Vec<u8>,
    flow: Vec<[f32; 2]>,
}

impl Scene {
    fn new() -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let (plane, cover) = (Texture::new(&mut random), Texture::new(&mut random));
        let mut scene = Self { first: Vec::new(), second: Vec::new(), flow: Vec::new() };
        let (angle, growth, shift) = (0.01_f32, 1.02_f32, [6.0, 1.0]);
        let (c, s) = (growth * angle.cos(), growth * angle.sin());
        let middle = [WIDTH as f32 / 2.0, HEIGHT as f32 / 2.0];
        for index in 0..WIDTH * HEIGHT {
            let (x, y) = ((index % WIDTH) as f32, (index / WIDTH) as f32);
            let (fx, fy) = (x - middle[0], y - middle[1]);
            let (bx, by) = (fx - shift[0], fy - shift[1]);
            let square = growth * growth;
            let back = [(c * bx + s * by) / square + middle[0], (c * by - s * bx) / square + middle[1]];
            let covered = |x: f32, y: f32| (BOX[0]..BOX[2]).contains(&x) && (BOX[1]..BOX[3]).contains(&y);
            let mut noisy = |grey: f32| (grey + random.random_range(-2.0..2.0_f32)).round().clamp(0.0, 255.0) as u8;
            scene.first.push(noisy(if covered(x, y) { cover.at(x, y) } else { plane.at(x, y) }));
            let (u, v) = (x - BOX_SHIFT[0], y - BOX_SHIFT[1]);
            scene.second.push(noisy(if covered(u, v) { cover.at(u, v) } else { plane.at(back[0], back[1]) }));
            scene.flow.push(match covered(x, y) {
                true => BOX_SHIFT,
                false => [c * fx - s * fy - fx + shift[0], s * fx + c * fy - fy + shift[1]],
            });
        }
        scene
    }

    /// Mean end-point error over the whole picture, covered and vanished pixels too.
    fn error_px(&self, flow: impl Iterator<Item = [f32; 2]>) -> f32 {
        let errors = flow.zip(&self.flow).map(|(f, t)| (f[0] - t[0]).hypot(f[1] - t[1]));
        errors.sum::<f32>() / self.flow.len() as f32
    }
}

/// Smooth noise in four sizes, around 128.
struct Texture {
    octaves: Vec<(f32, f32, Vec<f32>)>,
}

/// Cells of an octave along each side; they repeat.
const CELLS: usize = 512;

impl Texture {
    fn new(random: &mut Pcg64Mcg) -> Self {
        let mut grid = || (0..CELLS * CELLS).map(|_| random.random_range(-1.0..1.0_f32)).collect();
        let octaves = [(32.0, 80.0), (12.0, 50.0), (5.0, 30.0), (2.5, 14.0)];
        Self { octaves: octaves.map(|(cell, amplitude)| (cell, amplitude, grid())).into() }
    }

    fn at(&self, x: f32, y: f32) -> f32 {
        self.octaves.iter().fold(128.0, |sum, (cell, amplitude, grid)| {
            let (x, y) = (x / cell + 100.0, y / cell + 100.0);
            let (i, j) = (x as usize, y as usize);
            let smooth = |t: f32| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
            let (fx, fy) = (smooth(x - i as f32), smooth(y - j as f32));
            let corner = |i: usize, j: usize| grid[j % CELLS * CELLS + i % CELLS];
            let line = |j: usize| corner(i, j) * (1.0 - fx) + corner(i + 1, j) * fx;
            sum + amplitude * (line(j) * (1.0 - fy) + line(j + 1) * fy)
        })
    }
}
