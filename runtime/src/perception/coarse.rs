//! Depth from two or more pictures whose relative poses are known.

use hal::{CameraModel, ImageView, Pose3};
use rayon::prelude::*;

use super::aggregate::Volume;
use super::census::CensusImage;
use super::keyframes::Keyframes;
use super::sweep::{Reference, sweep};
use super::winner::{Winner, winner};
use super::{CoarseConfig, DepthEstimate, NoDepth, PerceptionError};

/// Plane sweep over census descriptors with semi-global aggregation. Deterministic on any number of threads.
#[derive(Debug)]
pub struct CoarseDepth {
    config: CoarseConfig,
    camera: CameraModel,
    /// The half-size camera that depth is computed for.
    half: CameraModel,
    inverse_depth: Vec<f32>,
    keyframes: Keyframes,
    last_pose: Option<Pose3>,
    /// Median of the last depth; what parallax is predicted with.
    scene_depth_m: f64,
    picture: CensusImage,
    grey: Vec<u16>,
    volume: Vec<u8>,
    down: Vec<i16>,
    up: Vec<i16>,
    winners: Vec<Winner>,
    estimate: DepthEstimate,
}

impl CoarseDepth {
    /// An engine for pictures of `camera`.
    ///
    /// # Errors
    /// Settings or a camera that cannot work.
    pub fn new(config: CoarseConfig, camera: CameraModel) -> Result<Self, PerceptionError> {
        config.validate()?;
        let why = if !camera.is_sound() {
            Some("size and focal lengths must be positive and finite")
        } else if camera.distortion != hal::Distortion::None {
            Some("pictures must be undistorted first")
        } else if camera.width < 32 || camera.height < 32 {
            Some("it must have at least 32x32 pixels")
        } else {
            None
        };
        if let Some(why) = why {
            let CameraModel { width, height, fx, fy, .. } = camera;
            return Err(PerceptionError::Camera { width, height, fx, fy, why });
        }
        let (width, height) = (camera.width / 2, camera.height / 2);
        let half = CameraModel {
            width,
            height,
            fx: camera.fx / 2.0,
            fy: camera.fy / 2.0,
            cx: (camera.cx + 0.5) / 2.0 - 0.5,
            cy: (camera.cy + 0.5) / 2.0 - 0.5,
            ..camera
        };
        let (far, near) = (1.0 / config.max_depth_m, 1.0 / config.min_depth_m);
        let last = (config.planes - 1) as f64;
        let exponent: f64 = std::env::var("EXPO").ok().and_then(|v| v.parse().ok()).unwrap_or(1.0);
        let inverse_depth =
            (0..config.planes).map(|i| (far + (near - far) * (i as f64 / last).powf(exponent)) as f32).collect();
        let cells = width * height * config.planes;
        Ok(Self {
            inverse_depth,
            keyframes: Keyframes::default(),
            last_pose: None,
            scene_depth_m: 2.0,
            picture: CensusImage::default(),
            grey: vec![0; width * height],
            volume: vec![0; cells],
            down: vec![0; cells],
            up: vec![0; cells],
            winners: vec![Winner::default(); width * height],
            estimate: DepthEstimate::none(camera.width, camera.height),
            config,
            camera,
            half,
        })
    }

    /// Depth of `frame`, taken at `t_odom_camera`, from the pictures before it.
    ///
    /// # Errors
    /// Why there is none. A refused picture leaves no trace.
    pub fn estimate(&mut self, frame: ImageView<'_>, t_odom_camera: &Pose3) -> Result<&DepthEstimate, NoDepth> {
        let pose = *t_odom_camera;
        if !pose.to_homogeneous().iter().all(|value| value.is_finite()) {
            return Err(NoDepth::PoseNotFinite);
        }
        if (frame.width(), frame.height()) != (self.camera.width, self.camera.height) || !self.picture.compute(frame) {
            return Err(NoDepth::FrameSize);
        }
        let jumped = self.last_pose.is_some_and(|last| {
            let step = last.inverse() * pose;
            step.translation.vector.norm() > self.config.max_step_m || step.rotation.angle() > self.config.max_turn_rad
        });
        self.last_pose = Some(pose);
        if jumped {
            self.keyframes.forget();
        }
        let first = self.keyframes.is_empty();
        let chosen = self.keyframes.choose(&pose, &self.half, self.scene_depth_m, &self.config);
        let outcome = if jumped {
            Err(NoDepth::PoseJump)
        } else if first {
            Err(NoDepth::FirstFrame)
        } else if chosen.is_empty() {
            Err(NoDepth::TooLittleParallax)
        } else {
            self.match_against(&chosen, &pose);
            Ok(())
        };
        self.keyframes.offer(&pose, &mut self.picture, &self.config);
        outcome.map(|()| &self.estimate)
    }

    /// What the last successful [`estimate`](Self::estimate) returned.
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }

    fn match_against(&mut self, chosen: &[usize], pose: &Pose3) {
        let descriptors = self.camera.cropped(0.5, 0.5, self.camera.width, self.camera.height);
        let references: Vec<Reference<'_>> = chosen
            .iter()
            .filter_map(|index| self.keyframes.all().get(*index))
            .map(|keyframe| Reference::new(&keyframe.census, &(keyframe.pose.inverse() * pose), &descriptors))
            .collect();
        sweep(&self.picture, &references, &self.inverse_depth, &mut self.volume);
        let (width, height, planes) = (self.half.width, self.half.height, self.config.planes);
        for (index, grey) in self.grey.iter_mut().enumerate() {
            let (x, y) = (index % width, index / width);
            *grey = self.picture.smooth[2 * y * self.picture.width + 2 * x];
        }
        let volume = Volume {
            costs: &self.volume,
            width,
            height,
            planes,
            grey: &self.grey,
            small: self.config.penalty_small,
            large: self.config.penalty_large,
        };
        let (down, up) = (&mut self.down, &mut self.up);
        rayon::join(|| volume.sweep_vertical(false, down), || volume.sweep_vertical(true, up));
        let row_length = width * planes;
        self.winners
            .par_chunks_exact_mut(width)
            .zip(self.down.par_chunks_exact_mut(row_length))
            .zip(self.up.par_chunks_exact(row_length))
            .enumerate()
            .for_each(|(row, ((winners, sum), up))| {
                sum.iter_mut().zip(up).for_each(|(sum, up)| *sum += up);
                volume.sweep_row(row, sum);
                for (winner_out, sums) in winners.iter_mut().zip(sum.chunks_exact(planes)) {
                    *winner_out = winner(sums, 2);
                }
            });
        self.write_estimate();
    }

    fn write_estimate(&mut self) {
        let (width, height) = (self.camera.width, self.camera.height);
        let last = self.inverse_depth.len() - 1;
        let values = self.estimate.depth.values_mut();
        for v in 0..height {
            for u in 0..width {
                let (x, y) = ((u / 2).min(self.half.width - 1), (v / 2).min(self.half.height - 1));
                let winner = self.winners[y * self.half.width + x];
                let plane = (winner.plane.max(0.0) as usize).min(last - 1);
                let fraction = winner.plane - plane as f32;
                let w = self.inverse_depth[plane] * (1.0 - fraction) + self.inverse_depth[plane + 1] * fraction;
                let index = v * width + u;
                let confidence = winner.margin;
                let valid = confidence >= self.config.min_confidence;
                values[index] = if valid { 1.0 / w } else { 0.0 };
                self.estimate.confidence[index] = if valid { confidence } else { 0.0 };
            }
        }
        let mut sorted: Vec<f32> = values.iter().copied().filter(|v| *v > 0.0).collect();
        if sorted.len() > 100 {
            let middle = sorted.len() / 2;
            self.scene_depth_m = f64::from(*sorted.select_nth_unstable_by(middle, f32::total_cmp).1);
        }
    }
}
