//! Starts the examination of a model in a separate process and waits for it, up to a time limit.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use runtime::model_gate::Examination;

use super::examine::{Report, Unfit};

/// Largest output accepted from the child, bytes. A report on 300 frames is 200 KB.
const MAX_STDOUT: u64 = 16 << 20;
/// Largest part of the child's standard error that is searched for its last line, bytes.
const MAX_STDERR: u64 = 4096;

/// Resource limits of the examining process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChildLimits {
    /// Address space, MiB.
    pub memory_mib: u64,
    /// Wall-clock time, seconds. Processor time is limited to twice as much.
    pub time_s: u64,
}

/// Input of one examination.
#[derive(Debug, Clone)]
pub struct Task<'a> {
    /// Path of this program, which the child runs with `model examine`.
    pub program: &'a Path,
    /// Bytes of the model to examine. They are sent through a pipe, so that no file is left behind
    /// if a process is killed.
    pub candidate: &'a [u8],
    /// File of the model that the robot uses now.
    pub resident: Option<PathBuf>,
    /// Runs, or folders with runs, from which held-out frames are taken.
    pub recordings: &'a [PathBuf],
    pub config: Option<&'a Path>,
    /// Maximum number of held-out frames.
    pub frames: usize,
    pub limits: ChildLimits,
    /// Whether the child runs at idle priority.
    pub idle: bool,
}

/// Result of an examination.
#[derive(Debug, Clone, PartialEq)]
pub enum Ended {
    Examined(Examination),
    /// The model cannot be used on this robot.
    Unfit(Unfit),
    /// The process ended without a result.
    Died {
        /// The last step that it reported.
        doing: String,
        /// Exit status, signal or time-out, with the last line of its standard error.
        how: String,
    },
}

/// Examines a model in a child process.
///
/// # Errors
/// If the process cannot be started.
pub fn examine(task: &Task<'_>) -> Result<Ended> {
    let ChildLimits { memory_mib, time_s } = task.limits;
    let mut command = Command::new(task.program);
    command.args(["model", "examine"]);
    for (flag, path) in [("--resident", task.resident.as_deref()), ("--config", task.config)] {
        if let Some(path) = path {
            command.arg(flag).arg(path);
        }
    }
    for recordings in task.recordings {
        command.arg("--recordings").arg(recordings);
    }
    for (flag, number) in [
        ("--frames", task.frames as u64),
        ("--memory-mib", memory_mib),
        ("--cpu-s", time_s.saturating_mul(2)),
    ] {
        command.args([flag, &number.to_string()]);
    }
    if task.idle {
        command.arg("--idle");
    }
    let mut child = command
        // The paths in `task` are absolute. A relative path inside a malicious model must not lead
        // to a file of ours.
        .current_dir("/")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {}", task.program.display()))?;
    let mut stdin = child.stdin.take().context("the child has no standard input")?;
    let candidate = task.candidate.to_vec();
    // If the child does not read its input, the time-out below ends it and this thread.
    std::thread::spawn(move || stdin.write_all(&candidate));
    let (sender, reports) = sync_channel(64);
    let stdout = child.stdout.take().context("the child has no standard output")?;
    let stderr = child.stderr.take().context("the child has no standard error")?;
    std::thread::spawn(move || {
        for line in BufReader::new(stdout.take(MAX_STDOUT)).lines() {
            // A line that is not a report means that the output cannot be trusted any more.
            let report = line.ok().and_then(|line| serde_json::from_str::<Report>(&line).ok());
            if report.is_none_or(|report| sender.send(report).is_err()) {
                return;
            }
        }
    });
    let last_line = std::thread::spawn(move || last_line_of(stderr));
    let end = Instant::now() + Duration::from_secs(time_s);
    let mut doing = "starting".to_owned();
    let ended = loop {
        match reports.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(Report::Doing(next)) => doing = next,
            Ok(Report::Examined(examination)) => break Some(Ended::Examined(examination)),
            Ok(Report::Unfit(unfit)) => break Some(Ended::Unfit(unfit)),
            Err(RecvTimeoutError::Timeout) => {
                let _ = child.kill();
                break Some(Ended::Died {
                    doing: doing.clone(),
                    how: format!("it had not finished after {time_s} s"),
                });
            }
            Err(RecvTimeoutError::Disconnected) => break None,
        }
    };
    // No further report is expected.
    if ended.is_some() {
        let _ = child.kill();
    }
    let status = child.wait().context("cannot wait for the examining process")?;
    Ok(ended.unwrap_or_else(|| {
        let last_line = last_line.join().unwrap_or_default();
        Ended::Died { doing, how: format!("{}{last_line}", how(status)) }
    }))
}

fn how(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(6) => "it aborted (signal 6), which happens when it runs out of memory".to_owned(),
        Some(9 | 24) => "it was killed because it exceeded its memory or time limit".to_owned(),
        Some(signal) => format!("it was killed by signal {signal}"),
        None => format!("it exited early ({status})"),
    }
}

/// The last line of the child's standard error, after a colon; empty if there is none.
fn last_line_of(mut stderr: impl Read) -> String {
    let mut text = Vec::new();
    let _ = stderr.by_ref().take(MAX_STDERR).read_to_end(&mut text);
    // Read the rest as well, so that the child never blocks on a full pipe.
    let _ = std::io::copy(&mut stderr, &mut std::io::sink());
    let text = String::from_utf8_lossy(&text);
    let last = text.lines().rev().find(|line| !line.trim().is_empty());
    last.map_or_else(String::new, |line| format!(": {}", line.trim()))
}
