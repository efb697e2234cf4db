//! Explorations whose summaries make tables.

use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use crate::{command, paths};

/// One exploration: `firmware-host explore ARGUMENTS --out OUT`, without recording.
#[derive(Debug, Clone)]
pub struct Exploration {
    pub arguments: Vec<String>,
    pub out: PathBuf,
}

/// Builds the program that [`all`] starts.
///
/// # Errors
/// When it does not compile.
pub fn build() -> Result<()> {
    let build = ["build", "--release", "--locked", "--package", "firmware-host"];
    command::run(command::cargo().args(build))
}

/// The summaries of all explorations, in order. As many run at a time as there are processors; the time that they take is in no
/// table. Runs that an earlier call has finished are not repeated.
///
/// # Errors
/// When an exploration fails, or its summary cannot be read. No further ones are started then.
pub fn all(explorations: &[Exploration]) -> Result<Vec<Value>> {
    let workers = std::thread::available_parallelism().map_or(1, NonZero::get);
    side_by_side(explorations, workers, |exploration, done| {
        let summary = explore(exploration)?;
        eprintln!("{done} of {}: {}", explorations.len(), exploration.out.display());
        Ok(summary)
    })
}

/// The number at a JSON pointer such as `/map_error_m/p90`; NaN if there is none.
pub fn figure(value: &Value, pointer: &str) -> f64 {
    value.pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN)
}

/// The results of `work` on all items, in their order. `work` also gets the number of items that are done, with this one.
fn side_by_side<T: Sync, R: Send>(
    items: &[T],
    workers: usize,
    work: impl Fn(&T, usize) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let results = Mutex::new(Vec::with_capacity(items.len()));
    std::thread::scope(|scope| {
        for _ in 0..workers.clamp(1, items.len().max(1)) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(index) else { break };
                    let result = work(item, done.fetch_add(1, Ordering::Relaxed) + 1);
                    if result.is_err() {
                        next.store(items.len(), Ordering::Relaxed);
                    }
                    if let Ok(mut results) = results.lock() {
                        results.push((index, result));
                    }
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_default();
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

fn explore(exploration: &Exploration) -> Result<Value> {
    let Exploration { arguments, out } = exploration;
    let file = out.join("summary.json");
    if !file.exists() {
        let mut program = command::program(paths::target().join("release/firmware-host"));
        program.args(["explore", "--no-recording"]).args(arguments).arg("--out").arg(out);
        let output = program.output().with_context(|| command::text(&program))?;
        ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    summary_of_a_whole_run(&file, out)
}

fn summary_of_a_whole_run(file: &Path, out: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
    let summary: Value = serde_json::from_str(&text).with_context(|| file.display().to_string())?;
    // It has a summary, too, of the part that was driven.
    let is_whole = summary["end_reason"] != "interrupted";
    ensure!(is_whole, "{} was interrupted: remove this folder, and run again", out.display());
    Ok(summary)
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::bail;
    use std::sync::mpsc;

    #[test]
    fn results_come_in_the_order_of_the_items_though_the_second_ends_before_the_first() {
        let (second_ends, first_waits) = mpsc::sync_channel(1);
        let first_waits = Mutex::new(first_waits);
        let results = side_by_side(&[0, 1], 2, |item, _| {
            match item {
                0 => first_waits.lock().unwrap().recv()?,
                _ => second_ends.send(())?,
            }
            Ok(item * 10)
        });
        assert_eq!(results.unwrap(), [0, 10]);
        assert!(side_by_side(&[] as &[u64], 4, |item, _| Ok(*item)).unwrap().is_empty());
    }

    #[test]
    fn after_a_failure_nothing_more_is_started_and_its_error_is_returned() {
        let started = AtomicUsize::new(0);
        let items: Vec<usize> = (0..1_000).collect();
        let result = side_by_side(&items, 1, |item, done| {
            started.fetch_add(1, Ordering::Relaxed);
            assert_eq!(done, item + 1);
            if *item == 3 { bail!("item 3") } else { Ok(*item) }
        });
        assert_eq!(result.unwrap_err().to_string(), "item 3");
        assert_eq!(started.into_inner(), 4);
    }
}
