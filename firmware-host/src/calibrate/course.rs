//! The drive of `calibrate --drive`: the robot drives the policy `calibration` like any other run, through its safety plane, and records it.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use runtime::event::ExploreEnd;

use crate::areas::AreaArgs;
use crate::check::confirm;
use crate::cli::{CalibrateArgs, PolicyArg, RunArgs};
use crate::config::Config;
use crate::faults::FaultArgs;
use crate::report::atomic::check_file;
use crate::report::fit;
use crate::run::{self, Arming};

/// What the person beside the robot is told before it moves.
const WARNING: &str = "The robot rotates, stops, and drives to and fro on 2 x 2 m around where it stands. Put it in the middle of so much free \
                       floor, among walls and textured things in light, and stand beside it with a hand at the emergency stop.";

/// Drives with the configuration file `path`, and returns the folder of the recording.
///
/// # Errors
/// The person did not confirm, the robot cannot run, or the drive was ended before its time.
pub fn drive(path: &Path, args: &CalibrateArgs) -> Result<PathBuf> {
    let config = Config::load(path)?;
    let beside = path.parent().unwrap_or(Path::new(""));
    if let Some(out) = &args.out {
        check_file(out)?;
    }
    println!("{}", fit::text(WARNING, fit::columns()));
    println!("It takes {} s. Ctrl-C stops the robot.", args.seconds);
    if !args.yes {
        print!("Type yes to start: ");
        std::io::stdout().flush()?;
        confirm(&mut std::io::stdin().lock())?;
    }
    let out = args.run_out.clone().unwrap_or_else(|| beside.join(name()));
    let frames = (args.seconds as f64 / config.base.tick_s()).ceil() as u64;
    let run = RunArgs {
        config: path.to_owned(),
        out: Some(out.clone()),
        runs: None,
        policy: PolicyArg::Calibration,
        model: None,
        model_store: None,
        frames: Some(frames),
        seed: 1,
        status: None,
        map: None,
        areas: AreaArgs::default(),
        no_recording: false,
        live: None,
        faults: FaultArgs::default(),
    };
    let end = run::run(&run, Arming::Confirmed)?;
    if end != ExploreEnd::FrameBudget {
        bail!(
            "the drive ended before its time: what was recorded is in {}, and `calibrate --recording` measures it",
            out.display()
        );
    }
    Ok(out)
}

/// The folder of a drive that begins now.
fn name() -> String {
    let time = jiff::Timestamp::now().strftime("%Y-%m-%dT%H-%M-%S");
    format!("calibration-{time}")
}
