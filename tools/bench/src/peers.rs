//! Peers in Python: a script that runs an operation on request and reports its duration.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, ensure};

/// A running script of `tools/bench/peers`. It reads the name of one operation per line, runs it, and answers with a line
/// with the seconds that it took. Before the first request it prints `ready`.
#[derive(Debug)]
pub struct PeerProcess {
    script: String,
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl PeerProcess {
    /// Starts a script with the Python interpreter in `BENCH_PYTHON`. `None` if it is not set: the rows then have no peer.
    ///
    /// # Errors
    /// When the script does not start or does not print `ready`.
    pub fn start(script: &str, arguments: &[&str]) -> Result<Option<Self>> {
        let Some(python) = std::env::var_os("BENCH_PYTHON") else { return Ok(None) };
        Self::spawn(Command::new(python), script, arguments).map(Some)
    }

    /// Starts a script with the trainer's Python interpreter, in `BENCH_TRAINER`.
    ///
    /// # Errors
    /// When the script does not start or does not print `ready`.
    pub fn start_trainer(script: &str, arguments: &[&str]) -> Result<Option<Self>> {
        let Some(python) = std::env::var_os("BENCH_TRAINER") else { return Ok(None) };
        let mut command = Command::new(python);
        // The trainer's own packages, not those of the other peers.
        command.env("PYTHONPATH", Path::new(env!("CARGO_MANIFEST_DIR")).join("../trainer/src"));
        Self::spawn(command, script, arguments).map(Some)
    }

    fn spawn(mut python: Command, script: &str, arguments: &[&str]) -> Result<Self> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers").join(script);
        let mut child = python
            .arg(&path)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| {
                format!("starting {} with {}", path.display(), python.get_program().display())
            })?;
        let input = child.stdin.take().context("a peer without input")?;
        let output = BufReader::new(child.stdout.take().context("a peer without output")?);
        let mut peer = Self { script: script.to_owned(), child, input, output };
        let answer = peer.answer()?;
        ensure!(answer == "ready", "{script} answered `{answer}` instead of `ready`");
        Ok(peer)
    }

    /// Runs the operation `name` and returns its duration in seconds, as the script measures it.
    ///
    /// # Errors
    /// When the script fails.
    pub fn seconds(&mut self, name: &str) -> Result<f64> {
        let answer = self.ask(name)?;
        answer.parse().with_context(|| format!("{} answered `{answer}` to `{name}`", self.script))
    }

    /// Sends one line and returns the script's answer.
    ///
    /// # Errors
    /// When the script ends without an answer.
    pub fn ask(&mut self, line: &str) -> Result<String> {
        writeln!(self.input, "{line}")
            .and_then(|()| self.input.flush())
            .with_context(|| self.script.clone())?;
        self.answer()
    }

    fn answer(&mut self) -> Result<String> {
        let mut line = String::new();
        self.output.read_line(&mut line).with_context(|| self.script.clone())?;
        ensure!(!line.is_empty(), "{} ended early; its output is above", self.script);
        Ok(line.trim().to_owned())
    }
}

impl Drop for PeerProcess {
    fn drop(&mut self) {
        // The script may have ended already.
        _ = self.child.kill();
        _ = self.child.wait();
    }
}
