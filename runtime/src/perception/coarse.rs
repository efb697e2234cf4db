//! Depth from pictures whose relative poses are known.

use hal::{CameraModel, Distortion, ImageView, Pose3};
use rayon::prelude::*;

use super::aggregate::{PathRows, Volume};
use super::census::CensusImage;
use super::fusion::Memory;
use super::keyframes::Keyframes;
use super::refine::{Corners, refine_rotation};
use super::sweep::{PLANES, Reference, hypotheses, smooth_3x3, sweep};
use super::winner::{Winner, winner};
use super::{CoarseConfig, DepthEstimate, NoDepth, PerceptionError};

/// Depth that parallax is predicted for before any was seen, metres.
const FIRST_SCENE_DEPTH_M: f64 = 2.0;

/// Plane sweep (Collins 1996) at half size: census descriptors of up to three earlier pictures, chosen by the parallax that
/// they promise, are compared over inverse-depth hypotheses, aggregated semi-globally, and the result votes on what is
/// remembered from the pictures before. Deterministic on any number of threads.
#[derive(Debug)]
pub struct CoarseDepth {
    config: CoarseConfig,
    /// The camera of the pictures.
    camera: CameraModel,
    /// The camera of descriptors: full size, each descriptor between 2x2 pixels.
    descriptors: CameraModel,
    /// The camera that depth is computed for.
    half: CameraModel,
    inverse_depth: [f32; PLANES],
    keyframes: Keyframes,
    memory: Memory,
    last_pose: Option<Pose3>,
    scene_depth_m: f64,
    picture: CensusImage,
    buffers: Buffers,
    estimate: DepthEstimate,
}

/// Memory that is kept from picture to picture.
#[derive(Debug, Default)]
struct Buffers {
    corners: Corners,
    grey: Vec<u16>,
    raw: Vec<[u8; PLANES]>,
    costs: Vec<[u8; PLANES]>,
    rows: Vec<[u16; PLANES]>,
    down: Vec<[i16; PLANES]>,
    up: Vec<[i16; PLANES]>,
    paths_down: PathRows,
    paths_up: PathRows,
    votes: Vec<(Winner, f32)>,
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
        let (width, height) = (camera.width / 2, camera.height / 2);
        let half = CameraModel {
            width,
            height,
            fx: camera.fx / 2.0,
            fy: camera.fy / 2.0,
            cx: (camera.cx - 0.5) / 2.0,
            cy: (camera.cy - 0.5) / 2.0,
            distortion: Distortion::None,
        };
        let pixels = width * height;
        let buffers = Buffers {
            grey: vec![0; pixels],
            raw: vec![[0; PLANES]; pixels],
            costs: vec![[0; PLANES]; pixels],
            rows: vec![[0; PLANES]; pixels],
            down: vec![[0; PLANES]; pixels],
            up: vec![[0; PLANES]; pixels],
            votes: vec![(Winner::default(), 0.0); pixels],
            ..Buffers::default()
        };
        Ok(Self {
            inverse_depth: hypotheses(config.min_depth_m, config.max_depth_m),
            descriptors: camera.cropped(0.5, 0.5, camera.width, camera.height),
            keyframes: Keyframes::default(),
            memory: Memory::default(),
            last_pose: None,
            scene_depth_m: FIRST_SCENE_DEPTH_M,
            picture: CensusImage::default(),
            estimate: DepthEstimate::none(camera.width, camera.height),
            config,
            camera,
            half,
            buffers,
        })
    }

    /// Depth of `frame` (RGB8 or GRAY8), taken at `t_odom_camera`, from the pictures before it.
    ///
    /// # Errors
    /// Why there is none. A picture of the wrong size, without texture or with a pose that is not finite leaves no trace;
    /// every other one is remembered.
    pub fn estimate(&mut self, frame: ImageView<'_>, t_odom_camera: &Pose3) -> Result<&DepthEstimate, NoDepth> {
        let pose = t_odom_camera;
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
        let outcome = self.look(pose);
        self.keyframes.offer(pose, &mut self.picture, &self.config);
        self.last_pose = Some(*pose);
        outcome.map(|()| &self.estimate)
    }

    /// What the last successful [`estimate`](Self::estimate) returned.
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }

    fn look(&mut self, pose: &Pose3) -> Result<(), NoDepth> {
        if self.last_pose.is_some_and(|last| self.is_jump(&last, pose)) {
            self.keyframes.forget();
            self.memory.forget();
            self.scene_depth_m = FIRST_SCENE_DEPTH_M;
            return Err(NoDepth::PoseJump);
        }
        if self.keyframes.is_empty() {
            return Err(NoDepth::FirstFrame);
        }
        self.memory.advance(pose, &self.half, self.config.memory);
        let chosen = self.keyframes.choose(pose, &self.half, self.scene_depth_m, &self.config);
        if chosen.is_empty() {
            if self.share_believed() < self.config.min_remembered {
                return Err(NoDepth::TooLittleParallax);
            }
        } else {
            self.match_against(&chosen, pose);
            self.measure_scene();
        }
        self.write_estimate();
        Ok(())
    }

    fn is_jump(&self, last: &Pose3, pose: &Pose3) -> bool {
        let step = last.inverse() * pose;
        step.translation.vector.norm() > self.config.max_step_m || step.rotation.angle() > self.config.max_turn_rad
    }

    fn match_against(&mut self, chosen: &[usize], pose: &Pose3) {
        let Buffers { corners, grey, raw, costs, rows, down, up, paths_down, paths_up, votes, .. } = &mut self.buffers;
        let (picture, inverse_depth, width) = (&self.picture, &self.inverse_depth, self.half.width);
        if self.config.refine_rotation {
            corners.find(picture);
        }
        let reference = |index: &usize| {
            let keyframe = self.keyframes.all().get(*index)?;
            let mut t = keyframe.pose.inverse() * pose;
            if self.config.refine_rotation {
                t = refine_rotation(picture, corners, &keyframe.census, &t, &self.descriptors);
            }
            Some(Reference::new(&keyframe.census, &t, &self.descriptors))
        };
        let references: Vec<Reference<'_>> = chosen.iter().filter_map(reference).collect();
        sweep(picture, &references, inverse_depth, raw);
        smooth_3x3(raw, width, rows, costs);
        for (line, grey) in picture.smooth.chunks_exact(2 * picture.width).zip(grey.chunks_exact_mut(width)) {
            grey.iter_mut().zip(line.iter().step_by(2)).for_each(|(grey, smooth)| *grey = *smooth);
        }
        let (small, large) = (self.config.penalty_small, self.config.penalty_large);
        let volume = Volume { costs, width, grey, small, large };
        rayon::join(|| volume.vertical(false, paths_down, down), || volume.vertical(true, paths_up, up));
        let half_trust_px = self.config.half_trust_px;
        let lines = votes.par_chunks_exact_mut(width).zip(down.par_chunks_exact_mut(width));
        lines.zip(up.par_chunks_exact(width)).enumerate().for_each(|(row, ((votes, sums), up))| {
            for (sums, up) in sums.iter_mut().zip(up) {
                sums.iter_mut().zip(up).for_each(|(sum, up)| *sum = sum.wrapping_add(*up));
            }
            volume.horizontal(row, sums);
            for (column, (vote, sums)) in votes.iter_mut().zip(sums.iter()).enumerate() {
                let winner = winner(sums, inverse_depth);
                let (u, v) = (2.0 * column as f32, 2.0 * row as f32);
                let parallax_px = |r: &Reference<'_>| r.parallax_px(u, v, winner.inverse_depth);
                let parallax_px = references.iter().filter_map(parallax_px).fold(0.0, f32::max);
                *vote = (winner, winner.margin * parallax_px / (parallax_px + half_trust_px));
            }
        });
        self.memory.vote(votes);
    }

    fn share_believed(&self) -> f32 {
        let beliefs = self.memory.beliefs();
        let believed = beliefs.iter().filter(|belief| belief.confidence() >= self.config.min_confidence).count();
        believed as f32 / beliefs.len() as f32
    }

    /// The parallax of the next picture is predicted with the median of this one.
    fn measure_scene(&mut self) {
        let (beliefs, sorted) = (self.memory.beliefs(), &mut self.buffers.sorted);
        sorted.clear();
        let trusted = beliefs.iter().filter(|belief| belief.confidence() >= self.config.min_confidence);
        sorted.extend(trusted.map(|belief| belief.inverse_depth));
        // A few pixels may be anything.
        if sorted.len() * 20 > beliefs.len() {
            let middle = sorted.len() / 2;
            let median = *sorted.select_nth_unstable_by(middle, f32::total_cmp).1;
            self.scene_depth_m = (1.0 / f64::from(median)).clamp(0.5, 5.0);
        }
    }

    /// Writes what is believed at full size.
    fn write_estimate(&mut self) {
        let (width, half_width) = (self.camera.width, self.half.width);
        let beliefs = self.memory.beliefs();
        let DepthEstimate { depth, confidence } = &mut self.estimate;
        let lines = depth.values_mut().chunks_exact_mut(width).zip(confidence.chunks_exact_mut(width));
        for (row, (depth, confidence)) in lines.enumerate() {
            let line = &beliefs[(row / 2).min(self.half.height - 1) * half_width..][..half_width];
            for (column, (depth, confidence)) in depth.iter_mut().zip(confidence).enumerate() {
                let belief = line[(column / 2).min(half_width - 1)];
                let trust = belief.confidence();
                let valid = belief.evidence > 0.0 && trust >= self.config.min_confidence;
                *depth = if valid { 1.0 / belief.inverse_depth } else { 0.0 };
                *confidence = if valid { trust } else { 0.0 };
            }
        }
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
