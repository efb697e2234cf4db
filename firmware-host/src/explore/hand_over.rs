//! Hands the recording so far to a trainer and takes a better network from it, at the ticks of a schedule.
//!
//! Both sides use one folder. Before a tick of the schedule, the robot closes the current segment of its recording,
//! writes `round_NNNN.json` and waits for `model_NNNN.onnx`. Both files are renamed into place, so they are complete
//! when they appear. A run that was killed is started again with the same arguments. It takes the models that exist
//! already without waiting and reaches the same state, as the digests in `round_NNNN.json` show.

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

/// Interval between two checks for the next model. Training takes minutes.
const POLL_PERIOD: Duration = Duration::from_millis(50);

/// The message to the trainer: the first `segments` files of the recording, and the corresponding part of the dump, are
/// complete.
#[derive(Debug, Serialize)]
pub(super) struct Round {
    pub round: u64,
    /// Number of ticks so far.
    pub frames: u64,
    pub segments: u32,
    /// Digest of every decision so far.
    pub digest: String,
}

/// The folder and the schedule of a hand-over.
pub(super) struct HandOver {
    dir: PathBuf,
    schedule: HandOverSchedule,
    config: Config,
}

impl HandOver {
    pub fn schedule(args: &HandOverArgs) -> Option<HandOverSchedule> {
        Some(HandOverSchedule { first: args.first?, every: args.every? })
    }

    /// Prepares the hand-over; `None` if the arguments name no folder or no schedule.
    pub fn new(args: &HandOverArgs, config: &Config) -> Result<Option<Self>> {
        let (Some(dir), Some(schedule)) = (&args.dir, Self::schedule(args)) else {
            return Ok(None);
        };
        prepare_dir(dir)?;
        Ok(Some(Self { dir: dir.clone(), schedule, config: config.clone() }))
    }

    /// The number of the round that ends before this tick, if one does.
    pub fn round(&self, tick: u64) -> Option<u64> {
        self.schedule.round(tick)
    }

    /// Sends the message to the trainer and waits for its model; `None` if the run was interrupted.
    #[expect(
        clippy::disallowed_methods,
        reason = "another process trains, and the run's own time stands still"
    )]
    pub fn exchange(
        &self,
        round: &Round,
        interrupted: &AtomicBool,
    ) -> Result<Option<DepthNetwork>> {
        let file = self.dir.join(format!("round_{:04}.json", round.round));
        write_atomically(&file, &serde_json::to_vec_pretty(round)?)?;
        let path = setup::handed_over_model(&self.dir, round.round);
        while !path.exists() {
            if interrupted.load(Ordering::Relaxed) {
                return Ok(None);
            }
            std::thread::sleep(POLL_PERIOD);
        }
        setup::load_network(&path, &self.config.camera.model(), &self.config).map(Some)
    }
}
