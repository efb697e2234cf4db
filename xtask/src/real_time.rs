//! Tests whose devices and programs run in real time. They wait for most of their time, so the other tests run beside them, at the
//! lowest priority so that they do not disturb them.

use std::fs::File;
use std::process::Command;

use anyhow::{Context, Result};

use crate::test::{Outcome, step};
use crate::{command, paths};

/// These tests, as a filter of nextest.
pub const FILTER: &str = "package(firmware-host) & binary(/^(run|live)$/) | package(live-view) | package(hil) - binary(/^(faults|lost|model_check|restart_authority|snapshots)$/)";

/// Runs `real_time` with its output in a file, which is shown at the end, and beside it `others` with the lowest priority. Returns
/// the outcomes in this order.
///
/// # Errors
/// When the file cannot be written.
pub fn run_beside(mut real_time: Command, others: &Command) -> Result<[(Outcome, f64); 2]> {
    let path = paths::target().join("real-time-tests.log");
    let log = File::create(&path).with_context(|| path.display().to_string())?;
    real_time.stdout(log.try_clone()?).stderr(log);
    let mut nice = command::program("nice");
    nice.args(["-n", "19"]).arg(others.get_program()).args(others.get_args());
    nice.envs(others.get_envs().filter_map(|(key, value)| Some((key, value?))));
    let (real_time, others) = std::thread::scope(|scope| {
        let real_time = scope.spawn(|| step(&mut real_time));
        let others = step(&mut nice);
        (real_time.join(), others)
    });
    print!("{}", std::fs::read_to_string(&path).unwrap_or_default());
    let real_time = real_time.unwrap_or((Outcome::Failed, 0.0));
    Ok([real_time, others])
}
