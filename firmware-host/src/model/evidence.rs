//! Held-out pictures out of the robot's own recordings, each with what judging a model by it takes: coarse depth as the loop
//! has it, earlier pictures from other places, and the LiDAR line.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Result;
use hal::{CameraModel, ImageView, Pose2, Pose3};
use runtime::model_gate::{HeldOutRule, LidarView, LinePoint, PoseBin};
use runtime::perception::{CoarseConfig, CoarseDepth, DepthEstimate};
use runtime::recording::{RecordedTick, RunHeader};

use crate::replay::{open_segment, segments};

/// Pictures that are remembered: enough for coarse depth to begin with and to find sources among. At 3 cm a turn 1.2 m.
const REMEMBERED: usize = 40;
/// Baselines of the sources, metres, as near as possible; within the limits, as the trainer's pairs.
const BASELINES_M: [f64; 2] = [0.1, 0.25];
const BASELINE_LIMITS_M: (f64, f64) = (0.05, 0.3);
/// A source that looks elsewhere overlaps too little.
const MOST_TURN_RAD: f64 = 0.35;
/// Two held-out pictures nearer to each other than this say the same.
const STEP_M: f64 = 0.05;
const STEP_RAD: f64 = 0.05;

/// A held-out picture.
pub struct Sample<'a> {
    /// Turn of its run.
    pub tick: u64,
    /// Where it was taken.
    pub bin: PoseBin,
    /// RGB8.
    pub rgb: &'a [u8],
    /// Where the camera was.
    pub t_odom_camera: Pose3,
    /// What the loop had.
    pub coarse: Option<&'a DepthEstimate>,
    /// Earlier pictures with the camera's poses.
    pub sources: Vec<(&'a [u8], Pose3)>,
    /// What the LiDAR sees of it.
    pub line: Vec<LinePoint>,
}

impl Sample<'_> {
    /// The picture as networks take it.
    pub fn view<'s>(&self, camera: &CameraModel, rgb: &'s [u8]) -> Result<ImageView<'s>> {
        Ok(ImageView::rgb8(camera.width, camera.height, rgb)?)
    }
}

/// Recorded segments under the given paths, newest first: runs, folders of runs, or single files.
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
    // By name where times are the same, so that the order is always the same.
    found.sort_by(|one, other| other.cmp(one));
    found.dedup();
    found.into_iter().map(|(_, segment)| segment).collect()
}

/// Hands every held-out picture of one segment to `judge` until it says `false`. A segment that is damaged is read as far as
/// it goes; one of another camera is skipped.
///
/// # Errors
/// Only what `judge` returns.
pub fn read_segment(
    path: &Path,
    camera: &CameraModel,
    coarse: &CoarseConfig,
    mut judge: impl FnMut(&Sample<'_>) -> Result<bool>,
) -> Result<bool> {
    let reader = match open_segment(path) {
        Ok(reader) => reader,
        Err(error) => {
            tracing::warn!("left out: {error}");
            return Ok(true);
        }
    };
    let run = reader.header().run.clone();
    if run.camera != *camera {
        tracing::warn!("left out: {} was recorded with another camera", path.display());
        return Ok(true);
    }
    let Ok(coarse) = CoarseDepth::new(coarse.clone(), *camera) else { return Ok(true) };
    let mut clip = Clip { run, coarse, has_coarse: false, seen: VecDeque::new(), last: None };
    for tick in reader {
        let Ok(tick) = tick.inspect_err(|error| tracing::warn!("{}: {error}", path.display()))
        else {
            break;
        };
        if let Some(bin) = clip.take(&tick)
            && let Some(sample) = clip.sample(&tick, bin)
            && !judge(&sample)?
        {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The pictures before a held-out one.
struct Clip {
    run: RunHeader,
    coarse: CoarseDepth,
    /// Whether the last picture got coarse depth.
    has_coarse: bool,
    seen: VecDeque<Seen>,
    /// Where the last held-out picture was taken.
    last: Option<Pose2>,
}

struct Seen {
    rgb: Vec<u8>,
    t_odom_camera: Pose3,
    /// Whether coarse depth knows it. It is computed only where it is needed: most pictures are not held out.
    matched: bool,
}

impl Clip {
    /// Remembers a turn's picture; its bin, if it is one to judge by.
    fn take(&mut self, tick: &RecordedTick) -> Option<PoseBin> {
        let rule = HeldOutRule::default();
        let odom = tick.wheel.odom;
        let picture = tick.frame.as_ref()?;
        let bin = rule.bin(&odom)?;
        if self.seen.len() == REMEMBERED {
            self.seen.pop_front();
        }
        let t_odom_camera = odom.to_pose3() * self.run.t_base_camera;
        self.seen.push_back(Seen { rgb: picture.rgb.clone(), t_odom_camera, matched: false });
        if !rule.holds_out(&bin) {
            return None;
        }
        self.match_pictures();
        let far = |last: &Pose2| {
            last.distance_m(&odom) >= STEP_M
                || hal::wrap_angle(last.yaw_rad - odom.yaw_rad).abs() >= STEP_RAD
        };
        if !self.last.as_ref().is_none_or(far) {
            return None;
        }
        self.last = Some(odom);
        Some(bin)
    }

    /// Coarse depth of all that it has not seen yet.
    fn match_pictures(&mut self) {
        let (width, height) = (self.run.camera.width, self.run.camera.height);
        for seen in self.seen.iter_mut().filter(|seen| !seen.matched) {
            seen.matched = true;
            let view = ImageView::rgb8(width, height, &seen.rgb);
            self.has_coarse =
                view.is_ok_and(|view| self.coarse.estimate(view, &seen.t_odom_camera).is_ok());
        }
    }

    fn sample(&self, tick: &RecordedTick, bin: PoseBin) -> Option<Sample<'_>> {
        let (newest, earlier) = (self.seen.back()?, self.seen.len() - 1);
        let t_camera_laser = self.run.t_base_camera.inverse() * self.run.t_base_laser;
        let view = LidarView { camera: self.run.camera, t_camera_laser };
        let line =
            tick.scan.as_ref().map(|scan| view.at(scan, tick.wheel.time_ns)).unwrap_or_default();
        let candidates: Vec<(f64, &Seen)> =
            self.seen.iter().take(earlier).filter_map(|seen| source(seen, newest)).collect();
        let best = |wanted: f64| {
            let off = |(baseline, _): &(f64, &Seen)| (baseline - wanted).abs();
            candidates.iter().min_by(|one, other| off(one).total_cmp(&off(other)))
        };
        let mut sources: Vec<_> = BASELINES_M.into_iter().filter_map(best).collect();
        sources.dedup_by(|one, other| std::ptr::eq(one.1, other.1));
        Some(Sample {
            tick: tick.tick,
            bin,
            rgb: &newest.rgb,
            t_odom_camera: newest.t_odom_camera,
            coarse: self.has_coarse.then(|| self.coarse.last()),
            sources: sources
                .into_iter()
                .map(|(_, seen)| (seen.rgb.as_slice(), seen.t_odom_camera))
                .collect(),
            line,
        })
    }
}

/// The baseline to a picture that may explain `target`.
fn source<'a>(seen: &'a Seen, target: &Seen) -> Option<(f64, &'a Seen)> {
    let motion = seen.t_odom_camera.inverse() * target.t_odom_camera;
    let (baseline, turn) = (motion.translation.vector.norm(), motion.rotation.angle());
    let (least, most) = BASELINE_LIMITS_M;
    ((least..=most).contains(&baseline) && turn <= MOST_TURN_RAD).then_some((baseline, seen))
}
