//! Dense optical flow beside OpenCV's with the same presets on the same images: time on one pair, errors over all pairs.

use anyhow::Result;
use hal::{CameraModel, DepthMap, ImageView, PixelFormat, Pose3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::perception::flow::{DenseFlow, FlowPreset};
use simulator::nuisance::Nuisances;
use simulator::render::{Lighting, Renderer};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing};
use crate::simulator::{hall, view};

const AREA: &str = "perception";
const WIDTH: usize = 640;
const HEIGHT: usize = 192;
const RUNS: usize = 101;
const PRESETS: [(&str, FlowPreset); 3] = [
    ("ultra_fast", FlowPreset::UltraFast),
    ("fast", FlowPreset::Fast),
    ("medium", FlowPreset::Medium),
];
/// Number of synthetic image pairs.
const SYNTHETIC: u64 = 8;
/// Number of rendered image pairs of a furnished hall.
const RENDERED: usize = 8;
/// Larger motions of rendered images are not evaluated, pixels.
const MOST_PX: f32 = 64.0;

/// Measures each preset, alternating with OpenCV if it is available.
///
/// # Errors
/// When the images cannot be written for the peer, or it fails.
pub fn rows() -> Result<Vec<Row>> {
    let pairs = pairs()?;
    let folder = tempfile::tempdir()?;
    for (index, pair) in pairs.iter().enumerate() {
        std::fs::write(folder.path().join(format!("{index}_first")), &pair.first)?;
        std::fs::write(folder.path().join(format!("{index}_second")), &pair.second)?;
    }
    let arguments = [folder.path().display().to_string()].into_iter();
    let arguments: Vec<_> =
        arguments.chain([pairs.len(), WIDTH, HEIGHT].map(|number| number.to_string())).collect();
    let arguments: Vec<_> = arguments.iter().map(String::as_str).collect();
    let mut peer = PeerProcess::start("opencv_dis.py", &arguments)?;
    PRESETS
        .into_iter()
        .map(|(name, preset)| row(name, preset, &pairs, peer.as_mut(), folder.path()))
        .collect()
}

fn row(
    name: &str,
    preset: FlowPreset,
    pairs: &[Pair],
    mut peer: Option<&mut PeerProcess>,
    folder: &std::path::Path,
) -> Result<Row> {
    let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT)?;
    let mut ours = Vec::new();
    let mut theirs = Vec::new();
    // The first run is a warm-up.
    for run in 0..=RUNS {
        let began = std::time::Instant::now();
        pairs[0].flow(&mut engine)?;
        let seconds = began.elapsed().as_secs_f64();
        let peer_seconds = peer.as_mut().map(|peer| peer.seconds(name)).transpose()?;
        if run > 0 {
            ours.push(seconds);
            theirs.extend(peer_seconds);
        }
    }
    let error = errors_px(pairs, |_, pair| Ok(pair.flow(&mut engine)?.to_vec()))?;
    let row = Row::seconds(AREA, format!("optical flow {name} 640x192"), Timing::of(ours));
    let note = format!(
        "{} threads, error synthetic {:.3}, hall {:.3} px",
        rayon::current_num_threads(),
        error[0],
        error[1]
    );
    let Some(peer) = peer else { return Ok(row.note(note)) };
    let timing = Timing::of(theirs);
    let peer_error = errors_px(pairs, |index, _| {
        let saved = folder.join("flow");
        let answer = peer.ask(&format!("save {name} {index} {}", saved.display()))?;
        anyhow::ensure!(answer == "saved", "opencv_dis.py saved no flow");
        Ok(read_flow(&std::fs::read(&saved)?))
    })?;
    let note = format!("{note}; OpenCV's {:.3}, {:.3} px", peer_error[0], peer_error[1]);
    // The peer's time is the floor, 0.7 of it the target.
    Ok(row.peer("OpenCV DIS", timing.median).goal(timing.median, 0.7 * timing.median).note(note))
}

/// Mean end-point errors of the synthetic and of the rendered pairs.
fn errors_px(
    pairs: &[Pair],
    mut flow: impl FnMut(usize, &Pair) -> Result<Vec<[f32; 2]>>,
) -> Result<[f32; 2]> {
    let errors =
        pairs.iter().enumerate().map(|(index, pair)| Ok(pair.error_px(&flow(index, pair)?)));
    let errors = errors.collect::<Result<Vec<_>>>()?;
    let (synthetic, rendered) = errors.split_at(SYNTHETIC as usize);
    Ok([synthetic, rendered].map(|errors| errors.iter().sum::<f32>() / errors.len() as f32))
}

fn read_flow(bytes: &[u8]) -> Vec<[f32; 2]> {
    let values = bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let values: Vec<f32> = values.collect();
    values.chunks_exact(2).map(|flow| [flow[0], flow[1]]).collect()
}

/// Two grey images and the true flow from the first to the second.
struct Pair {
    first: Vec<u8>,
    second: Vec<u8>,
    truth: Vec<[f32; 2]>,
}

fn pairs() -> Result<Vec<Pair>> {
    let mut pairs: Vec<_> = (0..SYNTHETIC).map(Pair::synthetic).collect();
    let scene = hall();
    let renderer = Renderer::new(&scene);
    for index in 0..RENDERED {
        pairs.push(Pair::rendered(&renderer, index)?);
    }
    Ok(pairs)
}

impl Pair {
    /// A textured plane that rotates, grows and shifts behind a textured box with another motion.
    fn synthetic(seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let plane = Texture::new(&mut random);
        let cover = Texture::new(&mut random);
        let mut pair = Self { first: Vec::new(), second: Vec::new(), truth: Vec::new() };
        let angle = up_to(&mut random, 0.02);
        let growth = 1.0 + up_to(&mut random, 0.03);
        let shift = [up_to(&mut random, 10.0), up_to(&mut random, 3.0)];
        let box_shift = [up_to(&mut random, 20.0), up_to(&mut random, 6.0)];
        let left = 300.0 + up_to(&mut random, 200.0);
        let top = 50.0 + up_to(&mut random, 40.0);
        let columns = left..left + 110.0;
        let rows = top..top + 90.0;
        let c = growth * angle.cos();
        let s = growth * angle.sin();
        let middle = [WIDTH as f32 / 2.0, HEIGHT as f32 / 2.0];
        let square = growth * growth;
        for index in 0..WIDTH * HEIGHT {
            let x = (index % WIDTH) as f32;
            let y = (index / WIDTH) as f32;
            let fx = x - middle[0];
            let fy = y - middle[1];
            let is_covered = columns.contains(&x) && rows.contains(&y);
            let first = if is_covered { cover.at(x, y) } else { plane.at(x, y) };
            pair.first.push(noisy(&mut random, first));
            let u = x - box_shift[0];
            let v = y - box_shift[1];
            let second = if columns.contains(&u) && rows.contains(&v) {
                cover.at(u, v)
            } else {
                let bx = fx - shift[0];
                let by = fy - shift[1];
                plane.at(
                    (c * bx + s * by) / square + middle[0],
                    (c * by - s * bx) / square + middle[1],
                )
            };
            pair.second.push(noisy(&mut random, second));
            pair.truth.push(match is_covered {
                true => box_shift,
                false => [c * fx - s * fy - fx + shift[0], s * fx + c * fy - fy + shift[1]],
            });
        }
        pair
    }

    /// A translation and a rotation in a furnished hall, with sensor noise.
    fn rendered(renderer: &Renderer, index: usize) -> Result<Self> {
        let camera = CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2);
        let mut random = Pcg64Mcg::seed_from_u64(100 + index as u64);
        let step = Pose3::translation(
            random.random_range(-0.05..0.05),
            0.0,
            random.random_range(0.03..0.15),
        );
        // The rotation is about the camera's y axis, which points down.
        let rotation =
            nalgebra::UnitQuaternion::from_euler_angles(0.0, random.random_range(-0.05..0.05), 0.0);
        let t_first_second = step * Pose3::from_parts(nalgebra::Translation3::identity(), rotation);
        let t_world_first = view(index);
        let t_world_second = t_world_first * t_first_second;
        let (first, depth) = render(renderer, &camera, &t_world_first, &mut random);
        let (second, _) = render(renderer, &camera, &t_world_second, &mut random);
        let truth = true_flow(&camera, &t_first_second.inverse(), &depth);
        Ok(Self { first, second, truth })
    }

    fn flow<'e>(&self, engine: &'e mut DenseFlow) -> Result<&'e [[f32; 2]]> {
        let first = ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, &self.first)?;
        let second = ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, &self.second)?;
        Ok(engine.flow(first, second)?.values())
    }

    /// Mean end-point error over all pixels whose motion is known, including those that become hidden or leave the image.
    fn error_px(&self, flow: &[[f32; 2]]) -> f32 {
        let errors = flow.iter().zip(&self.truth).map(|(f, t)| (f[0] - t[0]).hypot(f[1] - t[1]));
        let (count, sum) = errors
            .filter(|error| error.is_finite())
            .fold((0, 0.0), |(n, sum), error| (n + 1, sum + error));
        sum / count as f32
    }
}

/// A random number between -`most` and `most`.
fn up_to(random: &mut Pcg64Mcg, most: f32) -> f32 {
    random.random_range(-most..most)
}

fn noisy(random: &mut Pcg64Mcg, grey: f32) -> u8 {
    (grey + random.random_range(-2.0..2.0_f32)).round().clamp(0.0, 255.0) as u8
}

/// A grey image with sensor noise, and its depth.
fn render(
    renderer: &Renderer,
    camera: &CameraModel,
    t_world_camera: &Pose3,
    random: &mut Pcg64Mcg,
) -> (Vec<u8>, DepthMap) {
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    renderer.render(camera, t_world_camera, &[], &Lighting::default(), &mut rgb, &mut depth);
    Nuisances::default().add_sensor_noise(random, &mut rgb);
    let grey = rgb
        .chunks_exact(3)
        .map(|rgb| ((2 * u16::from(rgb[0]) + 5 * u16::from(rgb[1]) + u16::from(rgb[2])) / 8) as u8);
    (grey.collect(), depth)
}

/// The flow of every pixel from its depth and the camera's motion; NaN for motions above [`MOST_PX`] and for points behind
/// the second camera.
fn true_flow(camera: &CameraModel, t_second_first: &Pose3, depth: &DepthMap) -> Vec<[f32; 2]> {
    let flow = depth.values().iter().enumerate().map(|(index, depth_m)| {
        let u = (index % WIDTH) as f64;
        let v = (index / WIDTH) as f64;
        let point = t_second_first * camera.unproject(u, v, f64::from(*depth_m));
        let (x, y) = camera.project(&point)?;
        let flow = [(x - u) as f32, (y - v) as f32];
        (flow[0].hypot(flow[1]) < MOST_PX).then_some(flow)
    });
    flow.map(|flow| flow.unwrap_or([f32::NAN; 2])).collect()
}

/// Smooth noise at four scales, around 128.
struct Texture {
    octaves: Vec<Octave>,
}

struct Octave {
    cell_px: f32,
    amplitude: f32,
    grid: Vec<f32>,
}

/// Cells of an octave along each side, after which they repeat.
const CELLS: usize = 512;

impl Texture {
    fn new(random: &mut Pcg64Mcg) -> Self {
        let octaves = [(32.0, 80.0), (12.0, 50.0), (5.0, 30.0), (2.5, 14.0)];
        let octaves = octaves.map(|(cell_px, amplitude)| {
            let grid = (0..CELLS * CELLS).map(|_| random.random_range(-1.0..1.0_f32)).collect();
            Octave { cell_px, amplitude, grid }
        });
        Self { octaves: octaves.into() }
    }

    fn at(&self, x: f32, y: f32) -> f32 {
        self.octaves.iter().fold(128.0, |sum, octave| sum + octave.amplitude * octave.at(x, y))
    }
}

impl Octave {
    fn at(&self, x: f32, y: f32) -> f32 {
        let x = x / self.cell_px + 100.0;
        let y = y / self.cell_px + 100.0;
        let i = x as usize;
        let j = y as usize;
        let fx = smooth(x - i as f32);
        let fy = smooth(y - j as f32);
        let upper = self.corner(i, j) * (1.0 - fx) + self.corner(i + 1, j) * fx;
        let lower = self.corner(i, j + 1) * (1.0 - fx) + self.corner(i + 1, j + 1) * fx;
        upper * (1.0 - fy) + lower * fy
    }

    fn corner(&self, i: usize, j: usize) -> f32 {
        self.grid[j % CELLS * CELLS + i % CELLS]
    }
}

fn smooth(t: f32) -> f32 {
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}
