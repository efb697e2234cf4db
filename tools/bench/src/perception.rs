//! Coarse and dense depth, and the metrics of their accuracy.

use std::time::Instant;

use hal::{
    CameraModel, DepthMap, ImageView, LaserScan, PixelFormat, Pose2, Pose3, Range, ScanGeometry,
    camera_mount,
};
use nalgebra::Point3;
use runtime::accuracy::Accuracy;
use runtime::imaging::{FrontEnd, YuvRange};
use runtime::perception::{
    CoarseConfig, CoarseDepth, DenseConfig, DenseDepth, DepthEstimate, Moment,
};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing, time};

const AREA: &str = "perception";
const WIDTH: usize = 640;
const HEIGHT: usize = 192;
const FRAMES: u32 = 60;
const STEP_M: f64 = 0.03;
/// Number of frames between the two that semi-global matching gets: 22 pixels of disparity.
const APART: usize = 7;

/// Measures coarse depth of a camera that moves along a textured wall, sideways and forward.
///
/// # Errors
/// When no frame gets depth, or the peer fails.
pub fn rows() -> anyhow::Result<Vec<Row>> {
    let camera = CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2);
    let threads = rayon::current_num_threads();
    let mut rows = Vec::new();
    for (direction_name, direction, rectified) in
        [("sideways", [1.0, 0.0, 0.0], true), ("on an arc", [0.5, 0.0, 0.7], false)]
    {
        let drive = Drive::new(camera, direction);
        // Semi-global matching needs rectified images.
        let mut peer = if rectified { drive.semi_global_matching()? } else { None };
        let timings = drive.coarse(peer.as_mut())?;
        let note = format!(
            "{threads} threads; per frame: flow to the frame before, matching of 160x48 cells in 64 planes and up to {} references, \
             8 paths, sub-pixel refinement, fusion, upsampling",
            CoarseConfig::default().parallax_px.len()
        );
        let row_name = format!("coarse depth 640x192 on 160x48 cells, {direction_name}");
        let row = Row::seconds(AREA, row_name, timings.ours).goal(0.008, 0.003).note(note);
        let Some([full, quarter]) = timings.peer else {
            rows.push(row);
            rows.push(drive.whole_row(direction_name)?);
            continue;
        };
        rows.push(row.clone().peer("OpenCV SGBM of all 640x192 pixels", full.median));
        let name = format!("{}, beside SGBM on the same grid", row.name);
        let row = Row { name, goal: None, ..row };
        rows.push(
            row.peer("OpenCV SGBM of 160x48 pixels", quarter.median)
                .note("SGBM at the resolution of the cells: matching of one rectified pair only, 64 disparities, 3 paths"),
        );
        rows.push(drive.whole_row(direction_name)?);
    }
    rows.push(Drive::new(camera, [1.0, 0.0, 0.0]).dense_row()?);
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
    Row::seconds(AREA, "accuracy metrics of one frame 640x192", measured).goal(0.01, 0.003)
}

/// Timings of coarse depth, and of the peer at full and at a quarter of the size.
struct Timings {
    ours: Timing,
    peer: Option<[Timing; 2]>,
}

/// Frames of a wall from a straight path.
struct Drive {
    camera: CameraModel,
    path: Vec<Pose3>,
    images: Vec<Vec<u8>>,
}

impl Drive {
    fn new(camera: CameraModel, direction: [f64; 3]) -> Self {
        let path: Vec<Pose3> = (0..FRAMES).map(|i| pose(direction, i)).collect();
        let images = path.iter().map(|pose| wall(&camera, pose)).collect();
        Self { camera, path, images }
    }

    /// Starts OpenCV's semi-global matching with two frames of the drive.
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
        // The script has read the files, or has failed.
        std::fs::remove_dir_all(&folder)?;
        peer
    }

    /// Times coarse depth frame by frame, alternating with the peer.
    fn coarse(&self, mut peer: Option<&mut PeerProcess>) -> anyhow::Result<Timings> {
        let mut engine = CoarseDepth::new(CoarseConfig::default(), self.camera)?;
        let mut ours = Vec::new();
        let mut full = Vec::new();
        let mut quarter = Vec::new();
        for (image, pose) in self.images.iter().zip(&self.path) {
            let frame = ImageView::rgb8(WIDTH, HEIGHT, image)?;
            let began = Instant::now();
            if engine.estimate(frame, pose).is_ok() {
                ours.push(began.elapsed().as_secs_f64());
                if let Some(peer) = peer.as_mut() {
                    full.push(peer.seconds("full")?);
                    quarter.push(peer.seconds("quarter")?);
                }
            }
        }
        anyhow::ensure!(!ours.is_empty(), "no frame of the drive got depth");
        let peer = peer.map(|_| [full, quarter].map(Timing::of));
        Ok(Timings { ours: Timing::of(ours), peer })
    }

    /// Dense depth on top of coarse depth, with a scan of the wall, beside OpenCV's filling of holes.
    fn dense_row(&self) -> anyhow::Result<Row> {
        let size = [WIDTH.to_string(), HEIGHT.to_string()];
        let mut peer = PeerProcess::start("opencv_inpaint.py", &[&size[0], &size[1]])?;
        let mut coarse = CoarseDepth::new(CoarseConfig::default(), self.camera)?;
        let mount = camera_mount(0.0, 0.8, 0.0);
        let mut dense =
            DenseDepth::new(DenseConfig::default(), &self.camera, &coarse, Some(&mount));
        dense.see(&scan_of_wall(), &Pose2::IDENTITY);
        let mut ours = Vec::new();
        let mut theirs = Vec::new();
        for (image, pose) in self.images.iter().zip(&self.path) {
            let frame = ImageView::rgb8(WIDTH, HEIGHT, image)?;
            if coarse.estimate(frame, pose).is_err() {
                continue;
            }
            let began = Instant::now();
            dense.complete(&coarse, &Moment::HANDHELD);
            ours.push(began.elapsed().as_secs_f64());
            if let Some(peer) = &mut peer {
                theirs.push(peer.seconds("fill")?);
            }
        }
        let name = "dense depth 640x192, after coarse depth";
        let row = Row::seconds(AREA, name, Timing::of(ours)).goal(0.004, 0.0015);
        let row = row.note("voxel map, filling, walls of the scan, learning, upsampling; the peer fills 30 % of the pixels");
        Ok(match theirs.is_empty() {
            true => row,
            false => row.peer("OpenCV inpainting (Telea)", Timing::of(theirs).median),
        })
    }

    /// The 99th percentile from the camera's bytes to depth.
    fn whole_row(&self, name: &str) -> anyhow::Result<Row> {
        let mut seconds = self.whole()?;
        seconds.sort_by(f64::total_cmp);
        let p99 = seconds[(seconds.len() * 99).div_ceil(100) - 1];
        let timing = Timing { median: p99, ..Timing::of(seconds) };
        let name = format!("YUYV to coarse depth, 99th percentile, {name}");
        let row = Row::seconds(AREA, name, timing).goal(0.015, 0.008);
        Ok(row.note("front end and coarse depth; no network"))
    }

    /// Seconds from the camera's bytes (YUYV of the same size) to depth.
    fn whole(&self) -> anyhow::Result<Vec<f64>> {
        let mut engine = CoarseDepth::new(CoarseConfig::default(), self.camera)?;
        let mut front = FrontEnd::new(self.camera, self.camera, PixelFormat::Yuyv, YuvRange::Full)?;
        let mut rgb = vec![0; WIDTH * HEIGHT * 3];
        let mut seconds = Vec::new();
        for (image, pose) in self.images.iter().zip(&self.path) {
            // Luma and neutral chroma.
            let yuyv: Vec<u8> = image.chunks_exact(3).flat_map(|pixel| [pixel[0], 128]).collect();
            let began = Instant::now();
            front.to_rgb(ImageView::new(WIDTH, HEIGHT, PixelFormat::Yuyv, &yuyv)?, &mut rgb)?;
            if engine.estimate(ImageView::rgb8(WIDTH, HEIGHT, &rgb)?, pose).is_ok() {
                seconds.push(began.elapsed().as_secs_f64());
            }
        }
        anyhow::ensure!(!seconds.is_empty(), "no frame of the drive got depth");
        Ok(seconds)
    }
}

/// A scan of a wall 3 m ahead.
fn scan_of_wall() -> LaserScan {
    let geometry = ScanGeometry::UTM_30LX;
    let mut scan = LaserScan::empty(geometry);
    let ranges = (0..geometry.beams).map(|beam| match 3.0 / geometry.angle_rad(beam).cos() {
        range_m if (0.0..30.0).contains(&range_m) => Range::Hit(range_m as f32),
        _ => Range::NoReturn,
    });
    scan.ranges.extend(ranges);
    scan
}

fn pose(direction: [f64; 3], index: u32) -> Pose3 {
    let along = f64::from(index) * STEP_M;
    Pose3::translation(direction[0] * along, direction[1] * along, direction[2] * along)
}

/// An RGB image of a wall 3 m ahead with a texture of several scales.
fn wall(camera: &CameraModel, t_world_camera: &Pose3) -> Vec<u8> {
    let mut image = Vec::with_capacity(WIDTH * HEIGHT * 3);
    for index in 0..WIDTH * HEIGHT {
        let ray = camera.ray((index % WIDTH) as f64, (index / WIDTH) as f64);
        let point: Point3<f64> =
            t_world_camera * Point3::from(ray * (3.0 - t_world_camera.translation.z));
        let waves = [(7.0, 3.0, 0.3), (-4.0, 9.0, 1.0), (23.0, -17.0, 0.7), (11.0, 29.0, 2.0)];
        let [a, b, c, d] = waves.map(|(fx, fy, phase)| (point.x * fx + point.y * fy + phase).sin());
        let value = a * b + c * d;
        image.extend([(128.0 + 50.0 * value) as u8; 3]);
    }
    image
}
