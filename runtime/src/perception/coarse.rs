//! Coarse depth: multi-view matching of frames whose relative poses are known.

use hal::{CameraModel, Distortion, ImageView, Pose3};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::aggregate::{PathRows, Volume};
use super::belief::Belief;
use super::census::CensusImage;
use super::confidence;
use super::floor_plane::FloorPlane;
use super::frame_motion::FrameMotion;
use super::fusion::{CELLS_AT_ONCE, Memory};
use super::keyframes::{Keyframes, Requirements};
use super::motion_mask::MotionMask;
use super::refine::{Corners, refine_rotation};
use super::rotation_filter::{DepthPrior, FlowObservation, RotationFilter, YawError};
use super::subpixel::refine_votes;
use super::surround::{Surround, Surroundings};
use super::sweep::{CELL, FAR, MAX_REFERENCES, PLANES, Reference, hypotheses, sweep};
use super::upsample::Cells;
use super::wta::{Vote, winner_takes_all};
use super::{CoarseConfig, DepthEstimate, NoDepth, PerceptionError};
use crate::calibration_watch::Sums;
use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Scene depth for which parallax is predicted before any was measured, metres.
const FIRST_SCENE_DEPTH_M: f64 = 2.0;

/// Factor on the measured jitter of rotations when references are selected: both poses of a pair jitter, and wrong beliefs of
/// the first frames last long.
const REFERENCE_MARGIN: f64 = 2.0;

/// Factor on the measured jitter of rotations in the confidence of votes: all votes against one keyframe share its error, so
/// that many are no better than one. With 2 mrad of jitter, a factor of 3 halves the loss of delta1, at the cost of 4
/// percentage points of the pixels with depth.
const VOTE_MARGIN: f64 = 3.0;

/// A cell with more far hypotheses than this that no reference sees has just come into view: the remaining hypotheses are
/// near, and probably wrong.
const MOST_UNSEEN: u8 = FAR as u8 / 4;

/// Plane sweep (Collins 1996) over cells of 4x4 pixels: census descriptors of up to three earlier frames, selected by their
/// predicted parallax, are compared over inverse-depth hypotheses, aggregated semi-globally, and the result votes on the
/// beliefs from the frames before. The results are the same to the last bit on any number of threads.
#[derive(Debug)]
pub struct CoarseDepth {
    config: CoarseConfig,
    /// The camera of the frames.
    camera: CameraModel,
    /// The camera whose pixels are the descriptors: full size, each descriptor between 2x2 pixels.
    descriptors: CameraModel,
    /// The camera whose pixels are the cells.
    cells: CameraModel,
    inverse_depth: [f32; PLANES],
    /// Whether the plane z = 0 of `odom` is the floor.
    has_floor: bool,
    keyframes: Keyframes,
    memory: Memory,
    last_pose: Option<Pose3>,
    last_smooth: Vec<u16>,
    scene_depth_m: f64,
    image: CensusImage,
    motion: FrameMotion,
    rotation_filter: RotationFilter,
    /// The last frame had flow to the frame before, and its yaw error was not taken yet.
    has_motion: bool,
    is_matched: bool,
    /// `t_odom_camera` of the last frame, filtered.
    pose: Pose3,
    motion_mask: MotionMask,
    buffers: Buffers,
    estimate: DepthEstimate,
}

/// What a frame saw, by cells of 4x4 pixels, row-major.
pub(super) struct SeenCells<'a> {
    /// Filtered pose of the camera, `t_odom_camera`.
    pub pose: Pose3,
    pub beliefs: &'a [Belief],
    pub confidence: &'a [f32],
    pub surroundings: &'a [Surround],
    /// The votes of this frame alone; empty if it was not matched with earlier ones.
    pub votes: &'a [Vote],
    /// Brightness of the full-size image, 256 to a grey level.
    pub smooth: &'a [u16],
    /// Whether the frame was matched with earlier ones.
    pub is_matched: bool,
}

/// Scratch memory, allocated once.
#[derive(Debug, Default)]
struct Buffers {
    corners: Corners,
    grey: Vec<u16>,
    costs: Vec<[u8; PLANES]>,
    unseen: Vec<u8>,
    down: Vec<[i16; PLANES]>,
    up: Vec<[i16; PLANES]>,
    paths_down: PathRows,
    paths_up: PathRows,
    votes: Vec<Vote>,
    confidence: Vec<f32>,
    surroundings: Surroundings,
    sorted: Vec<f32>,
}

impl CoarseDepth {
    /// Prepares coarse depth of frames of `camera`, a pinhole camera of at least 32x32 pixels.
    ///
    /// # Errors
    /// A setting out of range, or a camera that cannot be used.
    pub fn new(config: CoarseConfig, camera: CameraModel) -> Result<Self, PerceptionError> {
        config.validate()?;
        check(&camera)?;
        let width = camera.width / CELL;
        let height = camera.height / CELL;
        let cell = CELL as f64;
        let cells = CameraModel {
            width,
            height,
            fx: camera.fx / cell,
            fy: camera.fy / cell,
            cx: (camera.cx + 0.5) / cell - 0.5,
            cy: (camera.cy + 0.5) / cell - 0.5,
            distortion: Distortion::None,
        };
        let pixels = width * height;
        let buffers = Buffers {
            grey: vec![0; pixels],
            costs: vec![[0; PLANES]; pixels],
            unseen: vec![0; pixels],
            down: vec![[0; PLANES]; pixels],
            up: vec![[0; PLANES]; pixels],
            votes: vec![Vote::default(); pixels],
            confidence: vec![0.0; pixels],
            ..Buffers::default()
        };
        Ok(Self {
            inverse_depth: hypotheses(config.min_depth_m, config.max_depth_m),
            descriptors: camera.cropped(0.5, 0.5, camera.width, camera.height),
            has_floor: false,
            keyframes: Keyframes::default(),
            memory: Memory::default(),
            last_pose: None,
            last_smooth: Vec::new(),
            scene_depth_m: FIRST_SCENE_DEPTH_M,
            image: CensusImage::default(),
            motion: FrameMotion::new(camera.width, camera.height)?,
            rotation_filter: RotationFilter::default(),
            has_motion: false,
            is_matched: false,
            pose: Pose3::identity(),
            motion_mask: MotionMask::new(camera.width, camera.height),
            estimate: DepthEstimate::none(camera.width, camera.height),
            config,
            camera,
            cells,
            buffers,
        })
    }

    /// Tells whether the plane z = 0 of `odom` is the floor, as it is for a camera on a robot with wheels and not for one held by
    /// hand. What seems to be behind the floor has no vote where the floor matches as well, as on tiles whose pattern repeats.
    #[must_use]
    pub fn with_floor(mut self, has_floor: bool) -> Self {
        self.has_floor = has_floor;
        self
    }

    /// Depth of `frame` (RGB8 or GRAY8), taken at `t_odom_camera`, from the frames before it.
    ///
    /// # Errors
    /// The reason why the frame has no depth. A frame of the wrong size, without texture, of a frozen camera or with a
    /// pose that is not finite has no effect on later frames; every other frame has.
    pub fn estimate(
        &mut self,
        frame: ImageView<'_>,
        t_odom_camera: &Pose3,
    ) -> Result<&DepthEstimate, NoDepth> {
        // One entry into the pool for the whole work: entering for every part would take longer than some of the parts.
        rayon::scope(|_| self.estimate_in_pool(frame, t_odom_camera))?;
        Ok(&self.estimate)
    }

    fn estimate_in_pool(&mut self, frame: ImageView<'_>, pose: &Pose3) -> Result<(), NoDepth> {
        self.has_motion = false;
        self.is_matched = false;
        if !pose.to_homogeneous().iter().all(|value| value.is_finite()) {
            return Err(NoDepth::PoseNotFinite);
        }
        let size = (frame.width(), frame.height());
        if size != (self.camera.width, self.camera.height) || !self.image.compute(frame) {
            return Err(NoDepth::FrameSize);
        }
        if !self.image.has_texture() {
            return Err(NoDepth::NoTexture);
        }
        if self.is_frozen(pose) {
            return Err(NoDepth::SameImage);
        }
        self.last_smooth.clone_from(&self.image.smooth);
        let outcome = self.process(pose);
        self.keyframes.offer(&self.pose, &mut self.image, &self.config);
        self.last_pose = Some(*pose);
        outcome
    }

    /// The last frame's vote, the belief and its neighbourhood for every cell of 4x4 pixels, row-major; `cargo xtask accuracy
    /// --fit` fits confidence with them.
    pub fn cells(&self) -> impl Iterator<Item = (&Vote, &Belief, &Surround)> {
        let beliefs = self.memory.beliefs().iter().zip(self.buffers.surroundings.last());
        self.buffers
            .votes
            .iter()
            .zip(beliefs)
            .map(|(vote, (belief, around))| (vote, belief, around))
    }

    /// What image motion says of the yaw of the robot since the previous frame, beside the given poses; positive to the left.
    /// `None` when the last frame had no flow to the frame before, and when it was taken already. `up` is the vertical axis in
    /// the camera's frame.
    pub fn take_yaw_error(&mut self, up: &Vector3<f64>) -> Option<YawError> {
        let has_motion = std::mem::take(&mut self.has_motion);
        self.rotation_filter.error_about(up).filter(|_| has_motion)
    }

    /// What image motion says of the camera's mount. `None` when the last frame had no flow to the frame before, and after
    /// [`take_yaw_error`](Self::take_yaw_error).
    pub(crate) fn mount(&self) -> Option<Sums<3>> {
        self.rotation_filter.mount().filter(|_| self.has_motion)
    }

    /// The result of the last successful [`estimate`](Self::estimate).
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }

    /// What the last frame saw, by cells.
    pub(super) fn seen(&self) -> SeenCells<'_> {
        SeenCells {
            pose: self.pose,
            beliefs: self.memory.beliefs(),
            confidence: &self.buffers.confidence,
            surroundings: self.buffers.surroundings.last(),
            votes: if self.is_matched { &self.buffers.votes } else { &[] },
            smooth: &self.last_smooth,
            is_matched: self.is_matched,
        }
    }

    /// The camera whose pixels are the cells.
    #[must_use]
    pub fn cell_camera(&self) -> &CameraModel {
        &self.cells
    }

    fn process(&mut self, measured: &Pose3) -> Result<(), NoDepth> {
        let jumped = self.last_pose.is_some_and(|last| self.is_jump(&last, measured));
        if jumped {
            self.forget();
        }
        self.track_motion(measured);
        if jumped {
            return Err(NoDepth::PoseJump);
        }
        if self.keyframes.is_empty() {
            return Err(NoDepth::FirstFrame);
        }
        self.memory.drop_where(self.motion_mask.cells());
        self.buffers.votes.fill(Vote::default());
        let requirements = Requirements {
            depth_m: self.scene_depth_m,
            jitter_rad: REFERENCE_MARGIN * self.jitter_rad(),
        };
        let chosen =
            self.keyframes.choose(&self.pose, &self.descriptors, requirements, &self.config);
        if chosen.iter().flatten().next().is_none() {
            self.update_confidence();
            if self.share_with_depth() < self.config.min_remembered {
                return Err(NoDepth::TooLittleParallax);
            }
        } else {
            self.match_against(&chosen);
            self.is_matched = true;
            self.update_confidence();
            self.update_scene_depth();
        }
        self.write_estimate();
        Ok(())
    }

    /// Discards everything from earlier frames, after the pose has jumped.
    pub(crate) fn forget(&mut self) {
        self.keyframes.forget();
        self.memory.forget();
        self.motion.forget();
        self.rotation_filter.forget();
        self.buffers.confidence.fill(0.0);
        self.scene_depth_m = FIRST_SCENE_DEPTH_M;
    }

    /// Uses the flow to the frame before to filter the camera's rotation and to find moving objects, and moves the beliefs to
    /// the new pose.
    fn track_motion(&mut self, measured: &Pose3) {
        let before = std::mem::replace(&mut self.pose, *measured);
        self.motion_mask.clear();
        let Some(flow) = self.motion.update(&self.image) else {
            self.rotation_filter.restart(measured);
            self.memory.advance(measured, &self.cells, self.config.memory);
            return;
        };
        let image = &self.image;
        let camera = &self.descriptors;
        let cells = &self.cells;
        if self.config.steady_rotation {
            let beliefs = self.memory.beliefs();
            let confidence = &*self.buffers.confidence;
            let observed = FlowObservation { flow, image, camera };
            let prior =
                DepthPrior { beliefs, confidence, cells, scene_depth_m: self.scene_depth_m };
            self.pose = self.rotation_filter.update(measured, observed, prior);
            self.has_motion = true;
        }
        let pose = &self.pose;
        let memory = &mut self.memory;
        let motion_mask = &mut self.motion_mask;
        rayon::join(
            || {
                if self.config.find_moving {
                    let t_before_now = before.inverse() * pose;
                    let nearest_m = self.config.min_depth_m;
                    motion_mask.update(image, flow, &t_before_now, camera, nearest_m);
                }
            },
            || memory.advance(pose, cells, self.config.memory),
        );
    }

    /// The robot has moved, but the frame is the same to the last bit: matching it would find no parallax, that is, infinite
    /// depth.
    fn is_frozen(&self, pose: &Pose3) -> bool {
        let moved = self.last_pose.is_some_and(|last| {
            let step = last.inverse() * pose;
            step.translation.vector.norm() >= self.config.min_baseline_m
                || step.rotation.angle() >= self.config.keyframe_turn_rad
        });
        moved && self.last_smooth == self.image.smooth
    }

    fn is_jump(&self, last: &Pose3, pose: &Pose3) -> bool {
        let step = last.inverse() * pose;
        step.translation.vector.norm() > self.config.max_step_m
            || step.rotation.angle() > self.config.max_turn_rad
    }

    /// The measured jitter of rotations about each axis; 0 without the rotation filter.
    fn jitter_rad(&self) -> f64 {
        if self.config.steady_rotation { self.rotation_filter.jitter_rad() } else { 0.0 }
    }

    fn match_against(&mut self, chosen: &[Option<usize>; MAX_REFERENCES]) {
        let jitter_px = (VOTE_MARGIN * self.jitter_rad() * self.camera.fx) as f32;
        let Buffers { corners, grey, costs, unseen, down, up, paths_down, paths_up, votes, .. } =
            &mut self.buffers;
        let image = &self.image;
        let inverse_depth = &self.inverse_depth;
        let width = self.cells.width;
        if self.config.refine_rotation {
            corners.find(image);
        }
        let references = chosen.map(|index| {
            let keyframe = self.keyframes.all().get(index?)?;
            let mut t_reference_camera = keyframe.pose.inverse() * self.pose;
            if self.config.refine_rotation {
                t_reference_camera = refine_rotation(
                    image,
                    corners,
                    &keyframe.census,
                    &t_reference_camera,
                    &self.descriptors,
                );
            }
            Some(Reference::new(&keyframe.census, &t_reference_camera, &self.descriptors))
        });
        let floor =
            self.has_floor.then(|| FloorPlane::new(&self.pose, &self.descriptors)).flatten();
        sweep(image, &references, inverse_depth, costs, unseen);
        shrink(&image.smooth, image.width, width, grey);
        let p1 = self.config.penalty_small;
        let p2 = self.config.penalty_large;
        let volume = Volume { costs, width, grey, p1, p2 };
        rayon::join(
            || volume.vertical(false, paths_down, down),
            || volume.vertical(true, paths_up, up),
        );
        let lines = votes.par_chunks_exact_mut(width).zip(down.par_chunks_exact_mut(width));
        lines.zip(up.par_chunks_exact(width)).enumerate().for_each(|(row, ((votes, sums), up))| {
            for (sums, up) in sums.iter_mut().zip(up) {
                sums.iter_mut().zip(up).for_each(|(sum, up)| *sum = sum.wrapping_add(*up));
            }
            volume.horizontal(row, sums);
            winner_takes_all(sums, &volume.costs[row * width..], inverse_depth, votes);
            for (column, vote) in votes.iter_mut().enumerate() {
                if unseen[row * width + column] > MOST_UNSEEN {
                    continue;
                }
                let u = (CELL * column) as f32;
                let v = (CELL * row) as f32;
                let parallaxes = references.iter().flatten();
                vote.parallax_px = parallaxes
                    .filter_map(|reference| reference.parallax_px(u, v, vote.inverse_depth))
                    .fold(0.0, f32::max);
            }
            refine_votes(image, &references, row, inverse_depth[0], floor.as_ref(), votes);
        });
        for (vote, moving) in votes.iter_mut().zip(self.motion_mask.cells()) {
            if *moving {
                *vote = Vote::default();
            }
        }
        self.memory.vote(votes, &self.config.vote_weights, jitter_px);
    }

    fn update_confidence(&mut self) {
        let Buffers { confidence, surroundings, .. } = &mut self.buffers;
        let beliefs = self.memory.beliefs();
        let around = surroundings.update(beliefs, self.cells.width);
        let cells = confidence
            .par_iter_mut()
            .zip(beliefs.par_iter().zip(around))
            .with_min_len(CELLS_AT_ONCE);
        let weights = &self.config.belief_weights;
        cells.for_each(|(confidence, (belief, around))| {
            *confidence = confidence::of_belief(weights, belief, around);
        });
    }

    /// Share of the cells whose belief is likely enough to give depth.
    fn share_with_depth(&self) -> f32 {
        let confidence = &self.buffers.confidence;
        let likely = confidence
            .iter()
            .filter(|confidence| **confidence >= self.config.min_confidence)
            .count();
        likely as f32 / confidence.len() as f32
    }

    /// Takes the median depth of this frame, with which the parallax of the next frame is predicted.
    fn update_scene_depth(&mut self) {
        let Buffers { sorted, confidence, .. } = &mut self.buffers;
        let beliefs = self.memory.beliefs();
        sorted.clear();
        let likely = beliefs
            .iter()
            .zip(&*confidence)
            .filter(|(_, confidence)| **confidence >= self.config.min_confidence);
        sorted.extend(likely.map(|(belief, _)| belief.inverse_depth));
        // The median of a few cells is unreliable: at least 5 % are required.
        if sorted.len() * 20 > beliefs.len() {
            let middle = sorted.len() / 2;
            let median = *sorted.select_nth_unstable_by(middle, f32::total_cmp).1;
            self.scene_depth_m = (1.0 / f64::from(median)).clamp(0.5, 5.0);
        }
    }

    /// Upsamples the beliefs to full size.
    fn write_estimate(&mut self) {
        let Buffers { grey, confidence, .. } = &mut self.buffers;
        shrink(&self.image.smooth, self.image.width, self.cells.width, grey);
        let width = self.cells.width;
        let beliefs = self.memory.beliefs();
        let cells =
            Cells { width, beliefs, confidence, grey, min_confidence: self.config.min_confidence };
        cells.upsample(&self.image.smooth, &mut self.estimate);
    }
}

/// The grey value in the middle of every cell, from an image of `image_width` pixels a row.
pub(super) fn shrink(smooth: &[u16], image_width: usize, width: usize, grey: &mut [u16]) {
    for (line, grey) in smooth.chunks_exact(CELL * image_width).zip(grey.chunks_exact_mut(width)) {
        let middle = line.get(image_width + 1..).unwrap_or_default().iter().step_by(CELL);
        grey.iter_mut().zip(middle).for_each(|(grey, smooth)| *grey = *smooth);
    }
}

fn check(camera: &CameraModel) -> Result<(), PerceptionError> {
    let why = if !camera.is_sound() {
        "size and focal lengths must be positive and finite"
    } else if camera.distortion != Distortion::None {
        "its images must be undistorted first"
    } else if camera.width < 32 || camera.height < 32 {
        "it must have at least 32x32 pixels"
    } else {
        return Ok(());
    };
    let CameraModel { width, height, fx, fy, .. } = *camera;
    Err(PerceptionError::Camera { width, height, fx, fy, why })
}

impl State for CoarseDepth {
    fn write(&self, to: &mut Vec<u8>) {
        self.keyframes.write(to);
        self.memory.write(to);
        self.motion.write(to);
        self.rotation_filter.write(to);
        (self.last_pose, self.scene_depth_m, self.pose).write(to);
        write_bulk(&self.last_smooth, to);
        write_bulk(&self.buffers.confidence, to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.keyframes.read(from)?;
        self.memory.read(from)?;
        self.motion.read(from)?;
        self.rotation_filter.read(from)?;
        let mut poses = (None, 0.0, Pose3::identity());
        poses.read(from)?;
        (self.last_pose, self.scene_depth_m, self.pose) = poses;
        let pixels = self.camera.width * self.camera.height;
        let cells = self.cells.width * self.cells.height;
        read_bulk(&mut self.last_smooth, pixels, from)?;
        read_bulk(&mut self.buffers.confidence, cells, from)?;
        let sound = self.buffers.confidence.len() == cells
            && self.motion.has_size(pixels)
            && self.memory.has_size(cells)
            && self.keyframes.all().iter().all(|keyframe| keyframe.census.smooth.len() == pixels);
        if sound {
            Ok(())
        } else {
            Err(SnapshotError::Damaged("keyframes of another image size".to_owned()))
        }
    }
}

#[cfg(test)]
mod tests;
