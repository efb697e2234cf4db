//! A depth network, given coarse depth as on the robot, or dense depth.

use std::path::Path;

use anyhow::Result;
use firmware_host::config::Config;
use firmware_host::setup::load_network;
use hal::{ImageView, Pose3};
use runtime::perception::{DepthEstimate, DepthNetwork};

use crate::engine::{Coarse, Dense, Engine};
use crate::sequence::{Sequence, View};

/// The depth that a network is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Input {
    /// Coarse depth, which it was trained with.
    Coarse,
    /// Dense depth, which a robot gives it.
    Dense,
}

/// The depth of a network.
pub struct Refined {
    input: Input,
    engine: Box<dyn Engine>,
    network: DepthNetwork,
}

impl Refined {
    /// # Errors
    /// When a setting is out of range or the model cannot be used.
    pub fn new(model: &Path, input: Input, config: &Config, sequence: &Sequence) -> Result<Self> {
        let engine: Box<dyn Engine> = match input {
            Input::Coarse => Box::new(Coarse::new("coarse", config, sequence)?),
            Input::Dense => Box::new(Dense::new("dense", config, sequence)?),
        };
        let network = load_network(model, &sequence.camera, config)?;
        Ok(Self { input, engine, network })
    }
}

impl Engine for Refined {
    fn name(&self) -> String {
        match self.input {
            Input::Coarse => "network on coarse".to_owned(),
            Input::Dense => "network on dense".to_owned(),
        }
    }

    fn process(
        &mut self,
        frame: ImageView<'_>,
        pose: &Pose3,
        view: &View,
        evaluated: bool,
    ) -> Result<Option<DepthEstimate>> {
        let given = self.engine.process(frame, pose, view, evaluated)?;
        if !evaluated {
            return Ok(None);
        }
        if self.network.estimate(frame, pose, given.as_ref()).is_err() {
            return Ok(None);
        }
        let mut estimate = self.network.last().clone();
        if let (Input::Dense, Some(dense)) = (self.input, &given) {
            // As on the robot.
            estimate.join(dense);
        }
        Ok(Some(estimate))
    }
}
