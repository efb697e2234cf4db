//! Export in the format of the TUM RGB-D benchmark (Sturm et al. 2012), which `firmware-host perceive --dataset` reads.
//!
//! `rgb/` and `rgb.txt` contain the images that the control loop processed. `groundtruth.txt` contains the camera poses in
//! `map` as localized while the robot drove; in spite of the file's name they are not ground truth. Simulated runs that recorded
//! ground-truth depth also have `depth/` and `depth.txt`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use hal::{CameraModel, DepthMap, Distortion};
use image::ExtendedColorType;
use runtime::recording::{RecordedTick, SegmentHeader};

use super::folder::new_folder;
use super::ticks::{check_order, each_tick, frames_per_second, png, shown};
use crate::error::StoreError;

/// The value of a depth image for one metre.
const DEPTH_SCALE: f64 = 1000.0;

/// The counts of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TumSummary {
    /// The number of images that were written.
    pub images: u64,
    /// The number of images that were left out because their tick has no pose.
    pub without_pose: u64,
    /// The number of segments that end early; their complete ticks are exported.
    pub cut: u64,
}

/// Exports the run that consists of `segments`, in this order, into the new directory `to`.
///
/// # Errors
/// When `to` exists already or cannot be written, a segment is not a recording, or the segments are out of order or have no image
/// with a pose.
pub fn tum(segments: &[PathBuf], to: &Path) -> Result<TumSummary, StoreError> {
    check_order(segments)?;
    new_folder(to, |dir| {
        let mut export = Export::new(dir, shown(segments))?;
        let cut = each_tick(segments, |header, tick| export.tick(header, tick))?;
        export.exported.cut = cut;
        export.finish()
    })
}

struct Export {
    dir: PathBuf,
    /// What errors about the recording call it.
    run: PathBuf,
    header: Option<SegmentHeader>,
    rgb: String,
    depth: String,
    poses: String,
    times_ns: Vec<u64>,
    exported: TumSummary,
}

impl Export {
    fn new(dir: &Path, run: PathBuf) -> Result<Self, StoreError> {
        let images = dir.join("rgb");
        std::fs::create_dir_all(&images).map_err(StoreError::output(images))?;
        Ok(Self {
            dir: dir.to_owned(),
            run,
            header: None,
            rgb: "# color images\n# timestamp filename\n".to_owned(),
            depth: "# depth maps\n# timestamp filename\n".to_owned(),
            poses: "# pose of the camera in map, as localization believed it\n# timestamp tx ty tz qx qy qz qw\n"
                .to_owned(),
            times_ns: Vec::new(),
            exported: TumSummary::default(),
        })
    }

    fn tick(&mut self, header: &SegmentHeader, tick: &RecordedTick) -> Result<(), StoreError> {
        self.header.get_or_insert_with(|| header.clone());
        let Some(frame) = &tick.frame else { return Ok(()) };
        if !tick.t_map_base().is_finite() {
            self.exported.without_pose += 1;
            return Ok(());
        }
        let stamp = stamp(tick.time_ns);
        let name = format!("rgb/{stamp}.png");
        self.png(&name, &frame.rgb, frame.width, frame.height, ExtendedColorType::Rgb8)?;
        let pose = tick.t_map_base_at_frame().to_pose3() * header.run.t_base_camera;
        let t = pose.translation.vector;
        let q = pose.rotation;
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
        self.exported.images += 1;
        Ok(())
    }

    fn depth(&mut self, stamp: &str, truth: &DepthMap) -> Result<(), StoreError> {
        let folder = self.dir.join("depth");
        std::fs::create_dir_all(&folder).map_err(StoreError::output(folder))?;
        let name = format!("depth/{stamp}.png");
        let bytes: Vec<u8> =
            truth.values().iter().flat_map(|depth_m| depth_value(*depth_m).to_ne_bytes()).collect();
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
    ) -> Result<(), StoreError> {
        let path = self.dir.join(name);
        png(bytes, width, height, color)
            .and_then(|png| std::fs::write(&path, png))
            .map_err(StoreError::output(path))
    }

    fn finish(self) -> Result<TumSummary, StoreError> {
        let Some(header) = self.header.as_ref().filter(|_| self.exported.images > 0) else {
            let detail =
                "the run contains no image with a pose, so there is nothing to export".to_owned();
            return Err(StoreError::Segment { path: self.run, detail });
        };
        if let Distortion::Fisheye(_) = header.run.camera.distortion {
            let detail = "the images are from a fisheye camera, which dataset.toml cannot describe"
                .to_owned();
            return Err(StoreError::Segment { path: self.run, detail });
        }
        let mut files =
            vec![("rgb.txt", self.rgb.clone()), ("groundtruth.txt", self.poses.clone())];
        if self.depth.lines().count() > 2 {
            files.push(("depth.txt", self.depth.clone()));
        }
        files.push(("dataset.toml", manifest(header, &self.times_ns)));
        for (name, text) in files {
            let path = self.dir.join(name);
            std::fs::write(&path, text).map_err(StoreError::output(path))?;
        }
        Ok(self.exported)
    }
}

/// The value of a depth image: 0 means "no depth". A recording holds whole millimetres up to 65.535 m.
fn depth_value(depth_m: f32) -> u16 {
    if depth_m.is_finite() { (f64::from(depth_m) * DEPTH_SCALE).round() as u16 } else { 0 }
}

/// Seconds with nine decimals, such as `1305031102.175304000`.
fn stamp(time_ns: u64) -> String {
    format!("{}.{:09}", time_ns / 1_000_000_000, time_ns % 1_000_000_000)
}

/// `dataset.toml`: camera, frame rate and scale, which the TUM format has no file for.
fn manifest(header: &SegmentHeader, times_ns: &[u64]) -> String {
    let CameraModel { width, height, fx, fy, cx, cy, distortion } = &header.run.camera;
    let distortion = match distortion {
        Distortion::PlumbBob(k) => format!("{k:?}"),
        _ => "[]".to_owned(),
    };
    let source = header.run.written_by.replace(['"', '\\', '\n'], " ");
    format!(
        "name = \"run\"\nlayout = \"tum\"\nnominal_fps = {:?}\ndepth_scale = {DEPTH_SCALE:?}\nsource = \"{source}\"\n\
         note = \"poses are localized by the robot and not ground truth\"\nup = [0.0, 0.0, 1.0]\n\n[camera]\nwidth = {width}\nheight = {height}\n\
         fx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\ndistortion = {distortion}\n",
        frames_per_second(times_ns)
    )
}
