//! Between two turns, the trainer gets what was recorded so far and the robot a better network.
//!
//! All of it goes through one folder. Before a turn of the schedule the robot closes its recording's segment, writes
//! `round_NNNN.json` and waits for `model_NNNN.onnx`; both appear whole, by renaming. A run that was killed is begun again
//! with the same arguments: it takes the models that are there already without waiting and comes to the very same state, as
//! the digests in `round_NNNN.json` show.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Result;
use runtime::perception::DepthNetwork;
use runtime::recording::HandOverSchedule;
use serde::Serialize;

use crate::cli::HandOverArgs;
use crate::config::Config;
use crate::report::atomic::{prepare_dir, write_atomically};
use crate::setup;

/// Between two looks for the next model. Training takes minutes.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// What the trainer is told: the first `segments` files of the recording, and as much of the dump, are whole.
#[derive(Debug, Serialize)]
pub(super) struct Round {
    pub round: u64,
    /// Turns so far.
    pub frames: u64,
    pub segments: u32,
    /// Of every decision so far.
    pub digest: String,
}

/// The folder and the schedule.
pub(super) struct HandOver {
    dir: PathBuf,
    schedule: HandOverSchedule,
    config: Config,
}

impl HandOver {
    pub fn schedule(args: &HandOverArgs) -> Option<HandOverSchedule> {
        Some(HandOverSchedule { first: args.first?, every: args.every? })
    }

    /// `None` when no networks come.
    pub fn new(args: &HandOverArgs, config: &Config) -> Result<Option<Self>> {
        let (Some(dir), Some(schedule)) = (&args.dir, Self::schedule(args)) else {
            return Ok(None);
        };
        prepare_dir(dir)?;
        Ok(Some(Self { dir: dir.clone(), schedule, config: config.clone() }))
    }

    /// The round that ends before this turn.
    pub fn round(&self, tick: u64) -> Option<u64> {
        self.schedule.round(tick)
    }

    /// Tells the trainer, and waits for the model; `None`: interrupted.
    #[expect(
        clippy::disallowed_methods,
        reason = "another process trains, and the run's own time stands still"
    )]
    pub fn exchange(
        &self,
        round: &Round,
        interrupted: &AtomicBool,
    ) -> Result<Option<DepthNetwork>> {
        let told = self.dir.join(format!("round_{:04}.json", round.round));
        write_atomically(&told, &serde_json::to_vec_pretty(round)?)?;
        let path = setup::handed_over_model(&self.dir, round.round);
        while !path.exists() {
            if interrupted.load(Ordering::Relaxed) {
                return Ok(None);
            }
            std::thread::sleep(LOOK_EVERY);
        }
        setup::load_network(&path, &self.config.camera.model(), &self.config).map(Some)
    }
}
