//! What a robot knows that has just started: dense depth without memory, and without coarse depth until there is parallax.
//!
//! In a recording this is rare: the engine starts once for each of its segments, which are a minute long. A network that was trained on recordings as they are
//! made dense depth worse where there was no memory (docs/accuracy.md, *Views without memory*).

use anyhow::Result;
use hal::{CameraModel, Pose3};
use runtime::perception::{CoarseConfig, DenseConfig, DepthEstimate};

use crate::config::Config;
use crate::frame_depth::{FrameDepth, Shot};

/// Starts again for every second stretch of frames.
pub(super) struct Restarts {
    /// Length of a stretch in frames.
    every: u64,
    coarse: CoarseConfig,
    dense: DenseConfig,
    camera: CameraModel,
    /// `None`: the camera is held by hand.
    t_base_camera: Option<Pose3>,
    engine: Option<FrameDepth>,
}

impl Restarts {
    pub fn new(
        every: u64,
        config: &Config,
        camera: CameraModel,
        t_base_camera: Option<Pose3>,
    ) -> Self {
        let coarse = config.coarse.clone();
        let dense = config.dense.clone();
        Self { every, coarse, dense, camera, t_base_camera, engine: None }
    }

    /// Dense depth of the frame `index`, counted from 0, if it belongs to a stretch before which the robot starts; frames must come in
    /// their order.
    ///
    /// # Errors
    /// When a setting is out of range.
    pub fn dense(&mut self, index: u64, shot: &Shot<'_>) -> Result<Option<Option<&DepthEstimate>>> {
        let is_after_a_start = (index / self.every) % 2 == 1;
        if !is_after_a_start {
            return Ok(None);
        }
        if index.is_multiple_of(self.every) {
            let mount = self.t_base_camera.as_ref();
            self.engine = Some(FrameDepth::new(&self.coarse, &self.dense, self.camera, mount)?);
        }
        let Some(engine) = &mut self.engine else { return Ok(None) };
        // Without coarse depth there is dense depth nevertheless.
        let _ = engine.estimate(shot);
        engine.complete(shot);
        Ok(Some(engine.dense()))
    }
}
