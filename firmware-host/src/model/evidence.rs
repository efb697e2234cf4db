//! Held-out frames from the robot's own recordings. Each comes with what the evaluation of a model
//! needs: coarse and dense depth as in the control loop, earlier frames from other places, and the LiDAR
//! returns inside the image.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Result;
use hal::{CameraModel, ImageView, Pose2, Pose3};
use runtime::model_gate::{HeldOutRule, LidarPixel, LidarView, PoseBin};
use runtime::perception::{DenseConfig, DepthEstimate, GivenDepth, Moment};
use runtime::recording::{RecordedTick, RunHeader};

use crate::config::Config;
use crate::frame_depth::{FrameDepth, Shot, moment_of};
use crate::replay::{open_segment, segments};

/// Number of earlier frames that are kept, for coarse depth and as candidates for sources. At 3 cm
/// per tick they cover 1.2 m.
const REMEMBERED: usize = 40;
/// Desired baselines of the sources, metres. The candidate with the nearest baseline is used,
/// within the limits below, which are those of the trainer's frame pairs.
const BASELINES_M: [f64; 2] = [0.1, 0.25];
const BASELINE_LIMITS_M: (f64, f64) = (0.05, 0.3);
/// Largest rotation between a frame and its source, radians. Beyond it they overlap too little.
const MAX_ROTATION_RAD: f64 = 0.35;
/// Two held-out frames must differ by this distance or rotation; closer ones are redundant.
const STEP_M: f64 = 0.05;
const STEP_RAD: f64 = 0.05;

/// A held-out frame with the data for its evaluation.
pub struct Sample<'a> {
    pub tick: u64,
    /// Pose bin in which the frame was taken.
    pub bin: PoseBin,
    /// Pixels in RGB8, row-major.
    pub rgb: &'a [u8],
    pub t_odom_camera: Pose3,
    /// Coarse depth of the frame, as the control loop computes it.
    pub coarse: Option<&'a DepthEstimate>,
    /// Dense depth without the scan, so that the LiDAR stays an independent witness.
    pub dense: Option<&'a DepthEstimate>,
    /// Earlier frames (RGB8) with `t_odom_camera`.
    pub sources: Vec<(&'a [u8], Pose3)>,
    /// LiDAR returns that are visible in the frame.
    pub line: Vec<LidarPixel>,
}

impl Sample<'_> {
    /// The depth that a network is given.
    pub fn given(&self, kind: GivenDepth) -> Option<&DepthEstimate> {
        match kind {
            GivenDepth::Coarse => self.coarse,
            GivenDepth::Dense => self.dense,
        }
    }

    /// An RGB8 buffer of the camera's size as an image view.
    pub fn view<'s>(&self, camera: &CameraModel, rgb: &'s [u8]) -> Result<ImageView<'s>> {
        Ok(ImageView::rgb8(camera.width, camera.height, rgb)?)
    }
}

/// All recorded segments under the given paths (runs, folders of runs, or single files), newest
/// first.
pub fn newest_segments(paths: &[PathBuf]) -> Vec<PathBuf> {
    let mut found: Vec<(SystemTime, PathBuf)> = Vec::new();
    for path in paths {
        let inner =
            std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path());
        let runs = std::iter::once(path.clone()).chain(inner.filter(|path| path.is_dir()));
        for segment in runs.filter_map(|run| segments(&run).ok()).flatten() {
            let changed = std::fs::metadata(&segment)
                .and_then(|data| data.modified())
                .unwrap_or(SystemTime::UNIX_EPOCH);
            found.push((changed, segment));
        }
    }
    // Equal times are ordered by name, so that the order is deterministic.
    found.sort_by(|one, other| other.cmp(one));
    found.dedup();
    found.into_iter().map(|(_, segment)| segment).collect()
}

/// Calls `judge` with every held-out frame of one segment until it returns `false`; returns whether
/// it never did. A damaged segment is read up to the damage, and a segment of another camera is
/// skipped.
///
/// # Errors
/// Only those of `judge`.
pub fn read_segment(
    path: &Path,
    config: &Config,
    mut judge: impl FnMut(&Sample<'_>) -> Result<bool>,
) -> Result<bool> {
    let reader = match open_segment(path) {
        Ok(reader) => reader,
        Err(error) => {
            tracing::warn!("skipping a segment: {error}");
            return Ok(true);
        }
    };
    let run = reader.header().run.clone();
    let camera = config.camera.model();
    if run.camera != camera {
        tracing::warn!("skipping {}: it was recorded with another camera", path.display());
        return Ok(true);
    }
    let without_walls = DenseConfig { walls: false, ..config.dense.clone() };
    let mount = Some(&run.t_base_camera);
    let Ok(depth) = FrameDepth::new(&config.coarse, &without_walls, camera, mount) else {
        return Ok(true);
    };
    let mut clip = Clip { run, depth, seen: VecDeque::new(), last: None };
    for tick in reader {
        let Ok(tick) = tick.inspect_err(|error| tracing::warn!("{}: {error}", path.display()))
        else {
            break;
        };
        if let Some(bin) = clip.push(&tick)
            && let Some(sample) = clip.sample(&tick, bin)
            && !judge(&sample)?
        {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The latest frames of a segment.
struct Clip {
    run: RunHeader,
    depth: FrameDepth,
    seen: VecDeque<Seen>,
    /// Pose of the last held-out frame that was used.
    last: Option<Pose2>,
}

struct Seen {
    rgb: Vec<u8>,
    t_odom_camera: Pose3,
    moment: Moment,
    /// Whether depth was computed for this frame. It is computed lazily, because most frames are not
    /// held out.
    matched: bool,
}

impl Clip {
    /// Stores the frame of a tick. Returns its pose bin if the frame is to be used for the
    /// evaluation.
    fn push(&mut self, tick: &RecordedTick) -> Option<PoseBin> {
        let rule = HeldOutRule::default();
        // Places are compared in `map`, neighbouring frames in `odom`.
        let place = tick.t_map_base_at_frame();
        let frame = tick.frame.as_ref()?;
        let bin = rule.bin(&place)?;
        if self.seen.len() == REMEMBERED {
            self.seen.pop_front();
        }
        let t_odom_camera = tick.t_odom_base_at_frame().to_pose3() * self.run.t_base_camera;
        let moment = moment_of(tick);
        self.seen.push_back(Seen { rgb: frame.rgb.clone(), t_odom_camera, moment, matched: false });
        if !rule.holds_out(&bin) {
            return None;
        }
        self.update_depth();
        if self.last.as_ref().is_some_and(|last| !differs(last, &place)) {
            return None;
        }
        self.last = Some(place);
        Some(bin)
    }

    /// Computes depth for all stored frames that do not have it yet, in order.
    fn update_depth(&mut self) {
        let width = self.run.camera.width;
        let height = self.run.camera.height;
        for seen in self.seen.iter_mut().filter(|seen| !seen.matched) {
            seen.matched = true;
            if let Ok(frame) = ImageView::rgb8(width, height, &seen.rgb) {
                let Seen { t_odom_camera, moment, .. } = *seen;
                let shot = Shot { frame, t_odom_camera, scan: None, moment };
                let _ = self.depth.estimate(&shot);
                self.depth.complete(&shot);
            }
        }
    }

    fn sample(&self, tick: &RecordedTick, bin: PoseBin) -> Option<Sample<'_>> {
        let newest = self.seen.back()?;
        let earlier = self.seen.len() - 1;
        let RunHeader { camera, t_base_camera, t_base_laser, .. } = self.run;
        let view = LidarView { camera, t_base_camera, t_base_laser };
        let scan = tick.scan.as_ref();
        let line = scan.map(|scan| view.at(scan, &tick.scan_odom, &tick.wheel)).unwrap_or_default();
        let candidates: Vec<(f64, &Seen)> =
            self.seen.iter().take(earlier).filter_map(|seen| source(seen, newest)).collect();
        let mut sources: Vec<_> = BASELINES_M
            .into_iter()
            .filter_map(|desired_m| nearest_baseline(&candidates, desired_m))
            .collect();
        sources.dedup_by(|one, other| std::ptr::eq(one.1, other.1));
        Some(Sample {
            tick: tick.tick,
            bin,
            rgb: &newest.rgb,
            t_odom_camera: newest.t_odom_camera,
            coarse: self.depth.coarse(),
            dense: self.depth.dense(),
            sources: sources
                .into_iter()
                .map(|(_, seen)| (seen.rgb.as_slice(), seen.t_odom_camera))
                .collect(),
            line,
        })
    }
}

/// The candidate whose baseline is nearest to `desired_m`.
fn nearest_baseline<'c, 'a>(
    candidates: &'c [(f64, &'a Seen)],
    desired_m: f64,
) -> Option<&'c (f64, &'a Seen)> {
    candidates.iter().min_by(|(one_m, _), (other_m, _)| {
        (one_m - desired_m).abs().total_cmp(&(other_m - desired_m).abs())
    })
}

/// Whether two poses are far enough apart for both frames to be used.
fn differs(last: &Pose2, odom: &Pose2) -> bool {
    last.distance_m(odom) >= STEP_M
        || hal::wrap_angle(last.yaw_rad - odom.yaw_rad).abs() >= STEP_RAD
}

/// An earlier frame with its baseline in metres, if it can serve as a source for `target`.
fn source<'a>(seen: &'a Seen, target: &Seen) -> Option<(f64, &'a Seen)> {
    let motion = seen.t_odom_camera.inverse() * target.t_odom_camera;
    let baseline_m = motion.translation.vector.norm();
    let (least_m, most_m) = BASELINE_LIMITS_M;
    let fits =
        (least_m..=most_m).contains(&baseline_m) && motion.rotation.angle() <= MAX_ROTATION_RAD;
    fits.then_some((baseline_m, seen))
}
