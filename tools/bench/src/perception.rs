//! Coarse depth and its parts.

use std::time::Instant;

use hal::{CameraModel, DepthMap, ImageView, PixelFormat, Pose3};
use nalgebra::Point3;
use runtime::accuracy::Accuracy;
use runtime::imaging::{FrontEnd, YuvRange};
use runtime::perception::{CoarseConfig, CoarseDepth, DepthEstimate};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing, time};

const ROOM: &str = "perception";
const WIDTH: usize = 640;
const HEIGHT: usize = 192;
const FRAMES: u32 = 60;
const STEP_M: f64 = 0.03;
/// Frames between the two that semi-global matching gets: 22 pixels of disparity.
const APART: usize = 7;

/// Measures a walk along a textured wall, sideways and forward.
///
/// # Errors
/// When a frame cannot be looked at.
pub fn rows() -> anyhow::Result<Vec<Row>> {
    let camera = CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2);
    let threads = rayon::current_num_threads();
    let mut rows = Vec::new();
    for (name, direction, rectified) in
        [("sideways", [1.0, 0.0, 0.0], true), ("on an arc", [0.5, 0.0, 0.7], false)]
    {
        let walk = Walk::new(camera, direction);
        // Semi-global matching needs rectified frames.
        let mut peer = if rectified { walk.semi_global_matching()? } else { None };
        let (coarse, theirs) = walk.coarse(peer.as_mut())?;
        let coarse = Timing::of(coarse);
        let note = format!(
            "{threads} threads, 64 planes, up to {} references",
            CoarseConfig::default().parallax_px.len()
        );
        let row = Row::seconds(ROOM, format!("coarse depth 640x192, {name}"), coarse)
            .goal(0.008, 0.003)
            .note(note);
        rows.push(match theirs.is_empty() {
            true => row,
            false => row.peer("OpenCV SGBM, 3 paths, 1 reference", Timing::of(theirs).median),
        });
        let mut whole = walk.whole()?;
        whole.sort_by(f64::total_cmp);
        let p99 = whole[(whole.len() * 99).div_ceil(100) - 1];
        let whole = Timing { median: p99, ..Timing::of(whole) };
        let row =
            Row::seconds(ROOM, format!("YUYV to coarse depth, 99th percentile, {name}"), whole);
        rows.push(row.goal(0.015, 0.008).note("front end and coarse depth; no network"));
    }
    rows.push(accuracy());
    Ok(rows)
}

fn accuracy() -> Row {
    let depths = (0..WIDTH * HEIGHT).map(|i| 1.0 + (i * 7919 % 4001) as f32 / 1e3).collect();
    let truth =
        DepthMap::from_vec(WIDTH, HEIGHT, depths).unwrap_or_else(|| DepthMap::none(WIDTH, HEIGHT));
    let confidence = (0..WIDTH * HEIGHT).map(|i| (i * 31 % 1009) as f32 / 1009.0).collect();
    let estimate = DepthEstimate { depth: truth.clone(), confidence };
    let mut accuracy = Accuracy::new();
    let measured = time(31, || accuracy.add(Some(&estimate), &truth));
    Row::seconds(ROOM, "accuracy of one picture 640x192", measured).goal(0.01, 0.003)
}

/// Frames of a wall from a straight path.
struct Walk {
    camera: CameraModel,
    path: Vec<Pose3>,
    images: Vec<Vec<u8>>,
}

impl Walk {
    fn new(camera: CameraModel, direction: [f64; 3]) -> Self {
        let path: Vec<Pose3> = (0..FRAMES).map(|i| pose(direction, i)).collect();
        let images = path.iter().map(|pose| wall(&camera, pose)).collect();
        Self { camera, path, images }
    }

    /// OpenCV's, on two frames of the walk.
    fn semi_global_matching(&self) -> anyhow::Result<Option<PeerProcess>> {
        let folder = std::env::temp_dir().join(format!("bench-sgbm-{}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        let files =
            [folder.join("left"), folder.join("right")].map(|file| file.display().to_string());
        // Moving to the right, the later frame is the right one.
        for (file, image) in files.iter().zip([&self.images[0], &self.images[APART]]) {
            std::fs::write(file, image.iter().step_by(3).copied().collect::<Vec<u8>>())?;
        }
        let size = [WIDTH.to_string(), HEIGHT.to_string()];
        let [left, right] = &files;
        let peer = PeerProcess::start("opencv_sgbm.py", &[left, right, &size[0], &size[1]]);
        // It has read them, or never will.
        std::fs::remove_dir_all(&folder)?;
        peer
    }

    /// Seconds of coarse depth, frame by frame, and of the peer's by turns.
    fn coarse(&self, mut peer: Option<&mut PeerProcess>) -> anyhow::Result<(Vec<f64>, Vec<f64>)> {
        let mut engine = CoarseDepth::new(CoarseConfig::default(), self.camera)?;
        let mut seconds = Vec::new();
        let mut theirs = Vec::new();
        for (image, pose) in self.images.iter().zip(&self.path) {
            let frame = ImageView::rgb8(WIDTH, HEIGHT, image)?;
            let began = Instant::now();
            if engine.estimate(frame, pose).is_ok() {
                seconds.push(began.elapsed().as_secs_f64());
                if let Some(peer) = peer.as_mut() {
                    theirs.push(peer.seconds("one_pass")?);
                }
            }
        }
        anyhow::ensure!(!seconds.is_empty(), "no picture of the walk gave depth");
        Ok((seconds, theirs))
    }

    /// Seconds from the camera's bytes (YUYV of the same size) to depth.
    fn whole(&self) -> anyhow::Result<Vec<f64>> {
        let mut engine = CoarseDepth::new(CoarseConfig::default(), self.camera)?;
        let mut front = FrontEnd::new(self.camera, self.camera, PixelFormat::Yuyv, YuvRange::Full)?;
        let mut rgb = vec![0; WIDTH * HEIGHT * 3];
        let mut seconds = Vec::new();
        for (image, pose) in self.images.iter().zip(&self.path) {
            // Grey: luma and neutral colour.
            let yuyv: Vec<u8> = image.chunks_exact(3).flat_map(|pixel| [pixel[0], 128]).collect();
            let began = Instant::now();
            front.to_rgb(ImageView::new(WIDTH, HEIGHT, PixelFormat::Yuyv, &yuyv)?, &mut rgb)?;
            if engine.estimate(ImageView::rgb8(WIDTH, HEIGHT, &rgb)?, pose).is_ok() {
                seconds.push(began.elapsed().as_secs_f64());
            }
        }
        anyhow::ensure!(!seconds.is_empty(), "no picture of the walk gave depth");
        Ok(seconds)
    }
}

fn pose(direction: [f64; 3], index: u32) -> Pose3 {
    let along = f64::from(index) * STEP_M;
    Pose3::translation(direction[0] * along, direction[1] * along, direction[2] * along)
}

/// A wall 3 m ahead with blobs of many sizes, as RGB.
fn wall(camera: &CameraModel, t_world_camera: &Pose3) -> Vec<u8> {
    let mut image = Vec::with_capacity(WIDTH * HEIGHT * 3);
    for index in 0..WIDTH * HEIGHT {
        let ray = camera.ray((index % WIDTH) as f64, (index / WIDTH) as f64);
        let place: Point3<f64> =
            t_world_camera * Point3::from(ray * (3.0 - t_world_camera.translation.z));
        let wave = |fx: f64, fy: f64, phase: f64| (place.x * fx + place.y * fy + phase).sin();
        let value = wave(7.0, 3.0, 0.3) * wave(-4.0, 9.0, 1.0)
            + wave(23.0, -17.0, 0.7) * wave(11.0, 29.0, 2.0);
        image.extend([(128.0 + 50.0 * value) as u8; 3]);
    }
    image
}
