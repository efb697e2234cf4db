//! Depth from pictures whose relative poses are known.

use hal::{CameraModel, Distortion, ImageView, Pose3};
use rayon::prelude::*;

use super::aggregate::{PathRows, Volume};
use super::belief::Belief;
use super::census::CensusImage;
use super::enlarge::Cells;
use super::fusion::{CELLS_AT_ONCE, Memory};
use super::keyframes::{Keyframes, Wanted};
use super::motion::PictureMotion;
use super::moving::MovingThings;
use super::refine::{Corners, refine_rotation};
use super::steady::{Believed, Seen, SteadyRotation};
use super::subpixel::polish;
use super::surround::{Surround, Surroundings};
use super::sweep::{CELL, FAR, MAX_REFERENCES, PLANES, Reference, hypotheses, sweep};
use super::trust;
use super::winner::{Vote, winners};
use super::{CoarseConfig, DepthEstimate, NoDepth, PerceptionError};
use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Depth that parallax is predicted for before any was seen, metres.
const FIRST_SCENE_DEPTH_M: f64 = 2.0;

/// References must promise parallax as if rotations jittered by so many times what they do: both poses of a pair are wrong,
/// and what is believed from the first pictures is slow to be forgotten.
const REFERENCE_MARGIN: f64 = 2.0;

/// Votes are doubted as if rotations jittered by so many times what they do: all votes against one keyframe share its error,
/// so that many are no better than one. With 2 mrad of jitter, 3 halves what delta1 loses, for 4 points of the share.
const VOTE_MARGIN: f64 = 3.0;

/// A cell with more far hypotheses than this that no reference sees has just come into view: what is left to choose from is
/// near, and probably wrong.
const MOST_UNSEEN: u8 = FAR as u8 / 4;

/// Plane sweep (Collins 1996) over cells of 4x4 pixels: census descriptors of up to three earlier pictures, chosen by the
/// parallax that they promise, are compared over inverse-depth hypotheses, aggregated semi-globally, and the result votes on
/// what is remembered from the pictures before. Deterministic on any number of threads.
#[derive(Debug)]
pub struct CoarseDepth {
    config: CoarseConfig,
    /// The camera of the pictures.
    camera: CameraModel,
    /// The camera of descriptors: full size, each descriptor between 2x2 pixels.
    descriptors: CameraModel,
    /// The camera that depth is computed for.
    cells: CameraModel,
    inverse_depth: [f32; PLANES],
    keyframes: Keyframes,
    memory: Memory,
    last_pose: Option<Pose3>,
    last_smooth: Vec<u16>,
    scene_depth_m: f64,
    picture: CensusImage,
    motion: PictureMotion,
    steady: SteadyRotation,
    /// `t_odom_camera` of the last picture, steadied.
    pose: Pose3,
    moving: MovingThings,
    buffers: Buffers,
    estimate: DepthEstimate,
}

/// Memory that is kept from picture to picture.
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
    /// An engine for pictures of `camera`, a pinhole of at least 32x32 pixels.
    ///
    /// # Errors
    /// Settings or a camera that cannot work.
    pub fn new(config: CoarseConfig, camera: CameraModel) -> Result<Self, PerceptionError> {
        config.validate()?;
        check(&camera)?;
        let (width, height) = (camera.width / CELL, camera.height / CELL);
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
            keyframes: Keyframes::default(),
            memory: Memory::default(),
            last_pose: None,
            last_smooth: Vec::new(),
            scene_depth_m: FIRST_SCENE_DEPTH_M,
            picture: CensusImage::default(),
            motion: PictureMotion::new(camera.width, camera.height)?,
            steady: SteadyRotation::default(),
            pose: Pose3::identity(),
            moving: MovingThings::new(camera.width, camera.height),
            estimate: DepthEstimate::none(camera.width, camera.height),
            config,
            camera,
            cells,
            buffers,
        })
    }

    /// Depth of `frame` (RGB8 or GRAY8), taken at `t_odom_camera`, from the pictures before it.
    ///
    /// # Errors
    /// Why there is none. A picture of the wrong size, without texture, of a frozen camera or with a pose that is not finite
    /// leaves no trace; every other one is remembered.
    pub fn estimate(
        &mut self,
        frame: ImageView<'_>,
        t_odom_camera: &Pose3,
    ) -> Result<&DepthEstimate, NoDepth> {
        // Into the pool once: to go there for every part of the work takes longer than some of them.
        rayon::scope(|_| self.estimate_in_pool(frame, t_odom_camera))?;
        Ok(&self.estimate)
    }

    fn estimate_in_pool(&mut self, frame: ImageView<'_>, pose: &Pose3) -> Result<(), NoDepth> {
        if !pose.to_homogeneous().iter().all(|value| value.is_finite()) {
            return Err(NoDepth::PoseNotFinite);
        }
        let size = (frame.width(), frame.height());
        if size != (self.camera.width, self.camera.height) || !self.picture.compute(frame) {
            return Err(NoDepth::FrameSize);
        }
        if !self.picture.has_texture() {
            return Err(NoDepth::NoTexture);
        }
        if self.is_frozen(pose) {
            return Err(NoDepth::SamePicture);
        }
        self.last_smooth.clone_from(&self.picture.smooth);
        let outcome = self.look(pose);
        self.keyframes.offer(&self.pose, &mut self.picture, &self.config);
        self.last_pose = Some(*pose);
        outcome
    }

    /// What the last picture says about every cell of 4x4 pixels, and what is believed of it and around it, row-major; for
    /// studies.
    pub fn cells(&self) -> impl Iterator<Item = (&Vote, &Belief, &Surround)> {
        let beliefs = self.memory.beliefs().iter().zip(self.buffers.surroundings.last());
        self.buffers
            .votes
            .iter()
            .zip(beliefs)
            .map(|(vote, (belief, around))| (vote, belief, around))
    }

    /// What the last successful [`estimate`](Self::estimate) returned.
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }

    fn look(&mut self, said: &Pose3) -> Result<(), NoDepth> {
        let jumped = self.last_pose.is_some_and(|last| self.is_jump(&last, said));
        if jumped {
            self.forget();
        }
        self.follow(said);
        if jumped {
            return Err(NoDepth::PoseJump);
        }
        if self.keyframes.is_empty() {
            return Err(NoDepth::FirstFrame);
        }
        self.memory.drop_where(self.moving.last());
        self.buffers.votes.fill(Vote::default());
        let wanted = Wanted {
            depth_m: self.scene_depth_m,
            jitter_rad: REFERENCE_MARGIN * self.jitter_rad(),
        };
        let chosen = self.keyframes.choose(&self.pose, &self.descriptors, wanted, &self.config);
        if chosen.iter().flatten().next().is_none() {
            self.judge();
            if self.share_believed() < self.config.min_remembered {
                return Err(NoDepth::TooLittleParallax);
            }
        } else {
            self.match_against(&chosen);
            self.judge();
            self.measure_scene();
        }
        self.write_estimate();
        Ok(())
    }

    /// The pose jumped: nothing from before fits.
    fn forget(&mut self) {
        self.keyframes.forget();
        self.memory.forget();
        self.motion.forget();
        self.steady.forget();
        self.buffers.confidence.fill(0.0);
        self.scene_depth_m = FIRST_SCENE_DEPTH_M;
    }

    /// What flow to the picture before tells: where the camera looks, and what moves by itself. Memory moves along.
    fn follow(&mut self, said: &Pose3) {
        let before = std::mem::replace(&mut self.pose, *said);
        self.moving.forget();
        let Some(flow) = self.motion.follow(&self.picture) else {
            self.steady.begin(said);
            self.memory.advance(said, &self.cells, self.config.memory);
            return;
        };
        let (picture, camera, cells) = (&self.picture, &self.descriptors, &self.cells);
        if self.config.steady_rotation {
            let (beliefs, confidence) = (self.memory.beliefs(), &*self.buffers.confidence);
            let seen = Seen { flow, picture, camera };
            let believed =
                Believed { beliefs, confidence, cells, scene_depth_m: self.scene_depth_m };
            self.pose = self.steady.steady(said, seen, believed);
        }
        let (pose, memory, moving) = (&self.pose, &mut self.memory, &mut self.moving);
        let advance = || memory.advance(pose, cells, self.config.memory);
        let look = || {
            if self.config.find_moving {
                moving.look(
                    picture,
                    flow,
                    &(before.inverse() * pose),
                    camera,
                    self.config.min_depth_m,
                );
            }
        };
        rayon::join(look, advance);
    }

    /// Nobody moves and sees the same to the last bit: taken at its word, such a picture shows a world without parallax.
    fn is_frozen(&self, pose: &Pose3) -> bool {
        let moved = self.last_pose.is_some_and(|last| {
            let step = last.inverse() * pose;
            step.translation.vector.norm() >= self.config.min_baseline_m
                || step.rotation.angle() >= self.config.keyframe_turn_rad
        });
        moved && self.last_smooth == self.picture.smooth
    }

    fn is_jump(&self, last: &Pose3, pose: &Pose3) -> bool {
        let step = last.inverse() * pose;
        step.translation.vector.norm() > self.config.max_step_m
            || step.rotation.angle() > self.config.max_turn_rad
    }

    /// What rotations are known to jitter by about each axis.
    fn jitter_rad(&self) -> f64 {
        if self.config.steady_rotation { self.steady.jitter_rad() } else { 0.0 }
    }

    fn match_against(&mut self, chosen: &[Option<usize>; MAX_REFERENCES]) {
        let jitter_px = (VOTE_MARGIN * self.jitter_rad() * self.camera.fx) as f32;
        let Buffers { corners, grey, costs, unseen, down, up, paths_down, paths_up, votes, .. } =
            &mut self.buffers;
        let (picture, inverse_depth, width) =
            (&self.picture, &self.inverse_depth, self.cells.width);
        if self.config.refine_rotation {
            corners.find(picture);
        }
        let mut reference = |index: Option<usize>| {
            let keyframe = self.keyframes.all().get(index?)?;
            let mut t = keyframe.pose.inverse() * self.pose;
            if self.config.refine_rotation {
                t = refine_rotation(picture, corners, &keyframe.census, &t, &self.descriptors);
            }
            Some(Reference::new(&keyframe.census, &t, &self.descriptors))
        };
        let references = chosen.map(&mut reference);
        sweep(picture, &references, inverse_depth, costs, unseen);
        shrink(picture, width, grey);
        let (small, large) = (self.config.penalty_small, self.config.penalty_large);
        let volume = Volume { costs, width, grey, small, large };
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
            winners(sums, &volume.costs[row * width..], inverse_depth, votes);
            for (column, vote) in votes.iter_mut().enumerate() {
                if unseen[row * width + column] > MOST_UNSEEN {
                    continue;
                }
                let (u, v) = ((CELL * column) as f32, (CELL * row) as f32);
                let parallax_px = |r: &Reference<'_>| r.parallax_px(u, v, vote.inverse_depth);
                vote.parallax_px =
                    references.iter().flatten().filter_map(parallax_px).fold(0.0, f32::max);
            }
            polish(picture, &references, row, inverse_depth[0], votes);
        });
        for (vote, moving) in votes.iter_mut().zip(self.moving.last()) {
            if *moving {
                *vote = Vote::default();
            }
        }
        self.memory.vote(votes, &self.config.vote_weights, jitter_px);
    }

    /// The probability of every belief.
    fn judge(&mut self) {
        let Buffers { confidence, surroundings, .. } = &mut self.buffers;
        let beliefs = self.memory.beliefs();
        let around = surroundings.look(beliefs, self.cells.width);
        let cells = confidence
            .par_iter_mut()
            .zip(beliefs.par_iter().zip(around))
            .with_min_len(CELLS_AT_ONCE);
        let weights = &self.config.belief_weights;
        cells.for_each(|(confidence, (belief, around))| {
            *confidence = trust::of_belief(weights, belief, around);
        });
    }

    fn share_believed(&self) -> f32 {
        let confidence = &self.buffers.confidence;
        let believed = confidence
            .iter()
            .filter(|confidence| **confidence >= self.config.min_confidence)
            .count();
        believed as f32 / confidence.len() as f32
    }

    /// The parallax of the next picture is predicted with the median of this one.
    fn measure_scene(&mut self) {
        let Buffers { sorted, confidence, .. } = &mut self.buffers;
        let beliefs = self.memory.beliefs();
        sorted.clear();
        let trusted = beliefs
            .iter()
            .zip(&*confidence)
            .filter(|(_, confidence)| **confidence >= self.config.min_confidence);
        sorted.extend(trusted.map(|(belief, _)| belief.inverse_depth));
        // A few cells may be anything.
        if sorted.len() * 20 > beliefs.len() {
            let middle = sorted.len() / 2;
            let median = *sorted.select_nth_unstable_by(middle, f32::total_cmp).1;
            self.scene_depth_m = (1.0 / f64::from(median)).clamp(0.5, 5.0);
        }
    }

    /// Writes what is believed at full size.
    fn write_estimate(&mut self) {
        let Buffers { grey, confidence, .. } = &mut self.buffers;
        shrink(&self.picture, self.cells.width, grey);
        let (width, beliefs) = (self.cells.width, self.memory.beliefs());
        let cells =
            Cells { width, beliefs, confidence, grey, min_confidence: self.config.min_confidence };
        cells.enlarge(&self.picture.smooth, &mut self.estimate);
    }
}

/// The grey value in the middle of every cell.
fn shrink(picture: &CensusImage, width: usize, grey: &mut [u16]) {
    for (line, grey) in
        picture.smooth.chunks_exact(CELL * picture.width).zip(grey.chunks_exact_mut(width))
    {
        let middle = line.get(picture.width + 1..).unwrap_or_default().iter().step_by(CELL);
        grey.iter_mut().zip(middle).for_each(|(grey, smooth)| *grey = *smooth);
    }
}

fn check(camera: &CameraModel) -> Result<(), PerceptionError> {
    let why = if !camera.is_sound() {
        "size and focal lengths must be positive and finite"
    } else if camera.distortion != Distortion::None {
        "its pictures must be undistorted first"
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
        self.steady.write(to);
        (self.last_pose, self.scene_depth_m, self.pose).write(to);
        write_bulk(&self.last_smooth, to);
        write_bulk(&self.buffers.confidence, to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.keyframes.read(from)?;
        self.memory.read(from)?;
        self.motion.read(from)?;
        self.steady.read(from)?;
        let mut poses = (None, 0.0, Pose3::identity());
        poses.read(from)?;
        (self.last_pose, self.scene_depth_m, self.pose) = poses;
        let (pixels, cells) =
            (self.camera.width * self.camera.height, self.cells.width * self.cells.height);
        read_bulk(&mut self.last_smooth, pixels, from)?;
        read_bulk(&mut self.buffers.confidence, cells, from)?;
        let sound = self.buffers.confidence.len() == cells
            && self.motion.has_size(pixels)
            && self.memory.has_size(cells)
            && self.keyframes.all().iter().all(|keyframe| keyframe.census.smooth.len() == pixels);
        if sound {
            Ok(())
        } else {
            Err(SnapshotError::Damaged("pictures of another size".to_owned()))
        }
    }
}

#[cfg(test)]
mod tests;
