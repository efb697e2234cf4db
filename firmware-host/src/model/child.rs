//! Starts the examination in a process of its own and waits for it, no longer than it may take.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use runtime::model_gate::Examination;

use super::examine::{Said, Unfit};

/// More than any examination says: 300 pictures are 200 KB.
const MOST_SAID: u64 = 16 << 20;
/// Of what the child complains about, so much is shown.
const MOST_COMPLAINT: u64 = 4096;

/// What the child may use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChildLimits {
    /// Of address space.
    pub memory_mib: u64,
    /// Of wall-clock time, seconds; processor time is limited to twice as much.
    pub time_s: u64,
}

/// What the child is given.
#[derive(Debug, Clone)]
pub struct Task<'a> {
    /// The program: this one.
    pub program: &'a Path,
    /// The model that nobody has run yet. It gets it through a pipe: no file of it is left behind, whatever is killed when.
    pub candidate: &'a [u8],
    /// The model that drives.
    pub resident: Option<PathBuf>,
    /// Where held-out pictures are found.
    pub recordings: &'a [PathBuf],
    /// The robot's configuration.
    pub config: Option<&'a Path>,
    /// Held-out pictures at most.
    pub frames: usize,
    /// What it may use.
    pub limits: ChildLimits,
    /// Whether it uses only otherwise idle time.
    pub idle: bool,
}

/// How an examination ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Ended {
    /// Everything was measured.
    Examined(Examination),
    /// The model cannot be the robot's.
    Unfit(Unfit),
    /// The process did not live to say anything: what it was doing, and how it ended.
    Died {
        /// The last thing that it said it would do.
        doing: String,
        /// How it ended.
        how: String,
    },
}

/// Examines a model.
///
/// # Errors
/// When the process cannot be started.
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
        // Relative paths in a model lead nowhere; ours are absolute.
        .current_dir("/")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {}", task.program.display()))?;
    let (mut stdin, candidate) =
        (child.stdin.take().context("no standard input")?, task.candidate.to_vec());
    // One that does not read is ended when its time is over.
    std::thread::spawn(move || stdin.write_all(&candidate));
    let (sender, heard) = sync_channel(64);
    let stdout = child.stdout.take().context("no standard output")?;
    let stderr = child.stderr.take().context("no standard error")?;
    std::thread::spawn(move || {
        for line in BufReader::new(stdout.take(MOST_SAID)).lines() {
            // A line that is none of ours ends the conversation.
            let said = line.ok().and_then(|line| serde_json::from_str::<Said>(&line).ok());
            if said.is_none_or(|said| sender.send(said).is_err()) {
                return;
            }
        }
    });
    let complaint = std::thread::spawn(move || complaint(stderr));
    let end = Instant::now() + Duration::from_secs(time_s);
    let mut doing = "starting".to_owned();
    let ended = loop {
        match heard.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(Said::Doing(next)) => doing = next,
            Ok(Said::Examined(examination)) => break Some(Ended::Examined(examination)),
            Ok(Said::Unfit(unfit)) => break Some(Ended::Unfit(unfit)),
            Err(RecvTimeoutError::Timeout) => {
                let _ = child.kill();
                break Some(Ended::Died {
                    doing: doing.clone(),
                    how: format!("it was not done after {time_s} s"),
                });
            }
            Err(RecvTimeoutError::Disconnected) => break None,
        }
    };
    // It has nothing more to say.
    if ended.is_some() {
        let _ = child.kill();
    }
    let status = child.wait().context("the examining process is lost")?;
    Ok(ended.unwrap_or_else(|| {
        let complaint = complaint.join().unwrap_or_default();
        Ended::Died { doing, how: format!("{}{complaint}", how(status)) }
    }))
}

fn how(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(6) => "it was aborted (signal 6), as when memory is used up".to_owned(),
        Some(9 | 24) => "it was ended by its limits of memory or time".to_owned(),
        Some(signal) => format!("it was ended by signal {signal}"),
        None => format!("it ended by itself ({status})"),
    }
}

fn complaint(stderr: impl Read) -> String {
    let mut text = Vec::new();
    let mut stderr = stderr;
    let _ = stderr.by_ref().take(MOST_COMPLAINT).read_to_end(&mut text);
    // It must not wait for us.
    let _ = std::io::copy(&mut stderr, &mut std::io::sink());
    let text = String::from_utf8_lossy(&text);
    let last = text.lines().rev().find(|line| !line.trim().is_empty());
    last.map_or_else(String::new, |line| format!(": {}", line.trim()))
}
