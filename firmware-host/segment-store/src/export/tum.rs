//! The layout of the TUM RGB-D benchmark (Sturm et al. 2012), which `firmware-host perceive --dataset` reads.
//!
//! `rgb/` and `rgb.txt` hold the pictures as the loop saw them; `groundtruth.txt` the camera's pose from the wheels' odometry,
//! which drifts: it is what the robot knew, not the truth. Simulated runs with true depth have `depth/` and `depth.txt` as well.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use hal::{CameraModel, DepthMap, Distortion};
use image::ExtendedColorType;
use runtime::recording::{RecordedTick, SegmentHeader};

use super::folder::new_folder;
use super::turns::{each_turn, frames_per_second, png};
use crate::error::BufferError;

/// A depth picture's value for one metre.
const DEPTH_SCALE: f64 = 1000.0;

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Exported {
    /// Pictures.
    pub pictures: u64,
    /// Pictures that came without a pose and were left out.
    pub without_pose: u64,
    /// Segments that end early; what they hold is in.
    pub cut: u64,
}

/// Writes the run that consists of `segments`, in this order, into the new directory `to`.
///
/// # Errors
/// When `to` is there already or cannot be written, or a segment is no recording of ours.
pub fn tum(segments: &[PathBuf], to: &Path) -> Result<Exported, BufferError> {
    new_folder(to, |dir| {
        let mut export = Export::new(dir)?;
        let cut = each_turn(segments, |header, tick| export.tick(header, tick))?;
        export.exported.cut = cut;
        export.finish()
    })
}

struct Export {
    dir: PathBuf,
    header: Option<SegmentHeader>,
    rgb: String,
    depth: String,
    poses: String,
    times_ns: Vec<u64>,
    exported: Exported,
}

impl Export {
    fn new(dir: &Path) -> Result<Self, BufferError> {
        let pictures = dir.join("rgb");
        std::fs::create_dir_all(&pictures).map_err(BufferError::write(pictures))?;
        Ok(Self {
            dir: dir.to_owned(),
            header: None,
            rgb: "# color images\n# timestamp filename\n".to_owned(),
            depth: "# depth maps\n# timestamp filename\n".to_owned(),
            poses: "# pose of the camera from odometry\n# timestamp tx ty tz qx qy qz qw\n"
                .to_owned(),
            times_ns: Vec::new(),
            exported: Exported::default(),
        })
    }

    fn tick(&mut self, header: &SegmentHeader, tick: &RecordedTick) -> Result<(), BufferError> {
        self.header.get_or_insert_with(|| header.clone());
        let Some(frame) = &tick.frame else { return Ok(()) };
        if !tick.wheel.odom.is_finite() {
            self.exported.without_pose += 1;
            return Ok(());
        }
        let stamp = stamp(tick.time_ns);
        let name = format!("rgb/{stamp}.png");
        self.png(&name, &frame.rgb, frame.width, frame.height, ExtendedColorType::Rgb8)?;
        let pose = tick.wheel.odom.to_pose3() * header.run.t_base_camera;
        let (t, q) = (pose.translation.vector, pose.rotation);
        // Writing into a String cannot fail.
        let _ = writeln!(self.rgb, "{stamp} {name}");
        let _ = writeln!(
            self.poses,
            "{stamp} {:.6} {:.6} {:.6} {:.9} {:.9} {:.9} {:.9}",
            t.x, t.y, t.z, q.i, q.j, q.k, q.w
        );
        if let Some(truth) = &tick.truth {
            self.depth(&stamp, truth)?;
        }
        self.times_ns.push(tick.time_ns);
        self.exported.pictures += 1;
        Ok(())
    }

    fn depth(&mut self, stamp: &str, truth: &DepthMap) -> Result<(), BufferError> {
        let folder = self.dir.join("depth");
        std::fs::create_dir_all(&folder).map_err(BufferError::write(folder))?;
        let name = format!("depth/{stamp}.png");
        // 0 is "no depth"; a recording holds whole millimetres up to 65.535 m.
        let millimetres = |depth_m: &f32| {
            if depth_m.is_finite() { (f64::from(*depth_m) * DEPTH_SCALE).round() as u16 } else { 0 }
        };
        let bytes: Vec<u8> =
            truth.values().iter().flat_map(|depth_m| millimetres(depth_m).to_ne_bytes()).collect();
        self.png(&name, &bytes, truth.width(), truth.height(), ExtendedColorType::L16)?;
        let _ = writeln!(self.depth, "{stamp} {name}");
        Ok(())
    }

    fn png(
        &self,
        name: &str,
        bytes: &[u8],
        width: usize,
        height: usize,
        color: ExtendedColorType,
    ) -> Result<(), BufferError> {
        let path = self.dir.join(name);
        png(bytes, width, height, color)
            .and_then(|png| std::fs::write(&path, png))
            .map_err(BufferError::write(path))
    }

    fn finish(self) -> Result<Exported, BufferError> {
        let Some(header) = self.header.as_ref().filter(|_| self.exported.pictures > 0) else {
            let detail =
                "the run holds no picture with a pose, so there is nothing to export".to_owned();
            return Err(BufferError::Segment { path: self.dir, detail });
        };
        if let Distortion::Fisheye(_) = header.run.camera.distortion {
            let detail = "the pictures are a fisheye's, which dataset.toml cannot say".to_owned();
            return Err(BufferError::Segment { path: self.dir, detail });
        }
        let mut files =
            vec![("rgb.txt", self.rgb.clone()), ("groundtruth.txt", self.poses.clone())];
        if self.depth.lines().count() > 2 {
            files.push(("depth.txt", self.depth.clone()));
        }
        files.push(("dataset.toml", manifest(header, &self.times_ns)));
        for (name, text) in files {
            let path = self.dir.join(name);
            std::fs::write(&path, text).map_err(BufferError::write(path))?;
        }
        Ok(self.exported)
    }
}

/// Seconds with nine decimals, as `1305031102.175304000`.
fn stamp(time_ns: u64) -> String {
    format!("{}.{:09}", time_ns / 1_000_000_000, time_ns % 1_000_000_000)
}

/// What the lists do not say.
fn manifest(header: &SegmentHeader, times_ns: &[u64]) -> String {
    let CameraModel { width, height, fx, fy, cx, cy, distortion } = &header.run.camera;
    let distortion = match distortion {
        Distortion::PlumbBob(k) => format!("{k:?}"),
        _ => "[]".to_owned(),
    };
    let source = header.run.written_by.replace(['"', '\\', '\n'], " ");
    format!(
        "name = \"run\"\nlayout = \"tum\"\nnominal_fps = {:?}\ndepth_scale = {DEPTH_SCALE:?}\nsource = \"{source}\"\n\
         note = \"poses are the robot's odometry, which drifts\"\nup = [0.0, 0.0, 1.0]\n\n[camera]\nwidth = {width}\nheight = {height}\n\
         fx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\ndistortion = {distortion}\n",
        frames_per_second(times_ns)
    )
}
