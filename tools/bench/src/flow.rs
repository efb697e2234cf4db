//! Dense optical flow beside OpenCV's, preset by preset, on the very same frames: time on one pair, errors over all of them.

use anyhow::Result;
use hal::{CameraModel, DepthMap, ImageView, PixelFormat, Pose3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::perception::flow::{DenseFlow, DepthGuess, FlowField, FlowPreset, predicted_flow};
use simulator::nuisance::Nuisances;
use simulator::render::{Lighting, Renderer};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing};
use crate::simulator::{hall, view};

const ROOM: &str = "perception";
const WIDTH: usize = 640;
const HEIGHT: usize = 192;
const RUNS: usize = 101;
const PRESETS: [(&str, FlowPreset); 3] = [
    ("ultra_fast", FlowPreset::UltraFast),
    ("fast", FlowPreset::Fast),
    ("medium", FlowPreset::Medium),
];
/// Pairs of made-up frames, and of a furnished hall.
const MADE_UP: u64 = 8;
const RENDERED: usize = 8;
/// Larger motions of rendered frames are not judged, pixels.
const MOST_PX: f32 = 64.0;

/// Measures each preset, turn by turn with OpenCV where there is a Python with it.
///
/// # Errors
/// When the frames cannot be handed to the peer, or it fails.
pub fn rows() -> Result<Vec<Row>> {
    let pairs = pairs()?;
    let folder = tempfile::tempdir()?;
    let path = |name: String| folder.path().join(name);
    for (index, pair) in pairs.iter().enumerate() {
        std::fs::write(path(format!("{index}_first")), &pair.first)?;
        std::fs::write(path(format!("{index}_second")), &pair.second)?;
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
    // The first turn does not count.
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
    let row = Row::seconds(ROOM, format!("optical flow {name} 640x192"), Timing::of(ours));
    let note = format!(
        "{} threads, error made-up {:.3}, hall {:.3} px",
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
    // As fast as the peer is the floor, 0.7 of its time the target.
    Ok(row.peer("OpenCV DIS", timing.median).goal(timing.median, 0.7 * timing.median).note(note))
}

/// Mean end-point error of the made-up pairs, and of the rendered ones.
fn errors_px(
    pairs: &[Pair],
    mut flow: impl FnMut(usize, &Pair) -> Result<Vec<[f32; 2]>>,
) -> Result<[f32; 2]> {
    let errors =
        pairs.iter().enumerate().map(|(index, pair)| Ok(pair.error_px(&flow(index, pair)?)));
    let errors = errors.collect::<Result<Vec<_>>>()?;
    let (made_up, rendered) = errors.split_at(MADE_UP as usize);
    Ok([made_up, rendered].map(|errors| errors.iter().sum::<f32>() / errors.len() as f32))
}

fn read_flow(bytes: &[u8]) -> Vec<[f32; 2]> {
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    bytes.chunks_exact(8).map(|pair| [value(&pair[..4]), value(&pair[4..])]).collect()
}

/// Two grey images and the true flow from the first to the second.
struct Pair {
    first: Vec<u8>,
    second: Vec<u8>,
    truth: Vec<[f32; 2]>,
}

fn pairs() -> Result<Vec<Pair>> {
    let mut pairs: Vec<_> = (0..MADE_UP).map(Pair::made_up).collect();
    let scene = hall();
    let renderer = Renderer::new(&scene);
    for index in 0..RENDERED {
        pairs.push(Pair::rendered(&renderer, index)?);
    }
    Ok(pairs)
}

impl Pair {
    /// A textured plane that turns, grows and moves behind a textured box that moves another way.
    fn made_up(seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let plane = Texture::new(&mut random);
        let cover = Texture::new(&mut random);
        let mut pair = Self { first: Vec::new(), second: Vec::new(), truth: Vec::new() };
        let mut any = |most: f32| random.random_range(-most..most);
        let angle = any(0.02);
        let growth = 1.0 + any(0.03);
        let shift = [any(10.0), any(3.0)];
        let box_shift = [any(20.0), any(6.0)];
        let left = 300.0 + any(200.0);
        let top = 50.0 + any(40.0);
        let right = left + 110.0;
        let bottom = top + 90.0;
        let c = growth * angle.cos();
        let s = growth * angle.sin();
        let middle = [WIDTH as f32 / 2.0, HEIGHT as f32 / 2.0];
        for index in 0..WIDTH * HEIGHT {
            let x = (index % WIDTH) as f32;
            let y = (index / WIDTH) as f32;
            let fx = x - middle[0];
            let fy = y - middle[1];
            let bx = fx - shift[0];
            let by = fy - shift[1];
            let square = growth * growth;
            let back =
                [(c * bx + s * by) / square + middle[0], (c * by - s * bx) / square + middle[1]];
            let covered = |x: f32, y: f32| (left..right).contains(&x) && (top..bottom).contains(&y);
            let mut noisy = |grey: f32| {
                (grey + random.random_range(-2.0..2.0_f32)).round().clamp(0.0, 255.0) as u8
            };
            pair.first.push(noisy(if covered(x, y) { cover.at(x, y) } else { plane.at(x, y) }));
            let u = x - box_shift[0];
            let v = y - box_shift[1];
            pair.second.push(noisy(if covered(u, v) {
                cover.at(u, v)
            } else {
                plane.at(back[0], back[1])
            }));
            pair.truth.push(match covered(x, y) {
                true => box_shift,
                false => [c * fx - s * fy - fx + shift[0], s * fx + c * fy - fy + shift[1]],
            });
        }
        pair
    }

    /// A step and a turn in a furnished hall, with a sensor's noise.
    fn rendered(renderer: &Renderer, index: usize) -> Result<Self> {
        let camera = CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2);
        let mut random = Pcg64Mcg::seed_from_u64(100 + index as u64);
        let step = Pose3::translation(
            random.random_range(-0.05..0.05),
            0.0,
            random.random_range(0.03..0.15),
        );
        // About the camera's y axis, which looks down.
        let turn =
            nalgebra::UnitQuaternion::from_euler_angles(0.0, random.random_range(-0.05..0.05), 0.0);
        let t_first_second = step * Pose3::from_parts(nalgebra::Translation3::identity(), turn);
        let t_world_first = view(index);
        let mut image = |pose: &Pose3, depth: &mut DepthMap| {
            let mut rgb = Vec::new();
            renderer.render(&camera, pose, &[], &Lighting::default(), &mut rgb, depth);
            Nuisances::default().add_sensor_noise(&mut random, &mut rgb);
            rgb.chunks_exact(3)
                .map(|rgb| {
                    ((2 * u16::from(rgb[0]) + 5 * u16::from(rgb[1]) + u16::from(rgb[2])) / 8) as u8
                })
                .collect()
        };
        let mut depth = DepthMap::none(0, 0);
        let mut other = DepthMap::none(0, 0);
        let first = image(&t_world_first, &mut depth);
        let second = image(&(t_world_first * t_first_second), &mut other);
        let mut truth = FlowField::zero(WIDTH, HEIGHT);
        predicted_flow(&camera, &t_first_second.inverse(), DepthGuess::Map(&depth), &mut truth)?;
        // What the camera nearly touches is not judged.
        let truth = truth
            .values()
            .iter()
            .map(|flow| if flow[0].hypot(flow[1]) < MOST_PX { *flow } else { [f32::NAN; 2] });
        Ok(Self { first, second, truth: truth.collect() })
    }

    fn flow<'e>(&self, engine: &'e mut DenseFlow) -> Result<&'e [[f32; 2]]> {
        let view = |data| ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, data);
        Ok(engine.flow(view(&self.first)?, view(&self.second)?, None)?.values())
    }

    /// Mean end-point error over all pixels whose motion is known, covered and vanished ones too.
    fn error_px(&self, flow: &[[f32; 2]]) -> f32 {
        let errors = flow.iter().zip(&self.truth).map(|(f, t)| (f[0] - t[0]).hypot(f[1] - t[1]));
        let (count, sum) = errors
            .filter(|error| error.is_finite())
            .fold((0, 0.0), |(n, sum), error| (n + 1, sum + error));
        sum / count as f32
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
            let x = x / cell + 100.0;
            let y = y / cell + 100.0;
            let i = x as usize;
            let j = y as usize;
            let smooth = |t: f32| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
            let fx = smooth(x - i as f32);
            let fy = smooth(y - j as f32);
            let corner = |i: usize, j: usize| grid[j % CELLS * CELLS + i % CELLS];
            let line = |j: usize| corner(i, j) * (1.0 - fx) + corner(i + 1, j) * fx;
            sum + amplitude * (line(j) * (1.0 - fy) + line(j + 1) * fy)
        })
    }
}
