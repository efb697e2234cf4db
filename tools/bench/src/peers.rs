//! Peers that live in Python: a script that does one piece of work whenever it is asked, and says how long that took.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, ensure};

/// A script of `tools/bench/peers` that is ready to work. It reads one name of a piece of work a line, does it, and answers
/// with one line: the seconds that it took. Before the first it prints `ready`.
#[derive(Debug)]
pub struct PeerProcess {
    script: String,
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl PeerProcess {
    /// Starts a script with the Python that `BENCH_PYTHON` names. `None` where there is none: the rows then have no peer.
    ///
    /// # Errors
    /// When the script does not get ready.
    pub fn start(script: &str, arguments: &[&str]) -> Result<Option<Self>> {
        let Some(python) = std::env::var_os("BENCH_PYTHON") else { return Ok(None) };
        Self::spawn(Command::new(python), script, arguments).map(Some)
    }

    /// The same with the Python that has the trainer, which `BENCH_TRAINER` names.
    ///
    /// # Errors
    /// When the script does not get ready.
    pub fn start_trainer(script: &str, arguments: &[&str]) -> Result<Option<Self>> {
        let Some(python) = std::env::var_os("BENCH_TRAINER") else { return Ok(None) };
        let mut command = Command::new(python);
        // Its own packages, not those of the other peers.
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

    /// Seconds that the piece of work `name` takes now, as the script measures it.
    ///
    /// # Errors
    /// When the script fails.
    pub fn seconds(&mut self, name: &str) -> Result<f64> {
        let answer = self.ask(name)?;
        answer.parse().with_context(|| format!("{} answered `{answer}` to `{name}`", self.script))
    }

    /// The answer to one line.
    ///
    /// # Errors
    /// When the script ends instead.
    pub fn ask(&mut self, line: &str) -> Result<String> {
        writeln!(self.input, "{line}")
            .and_then(|()| self.input.flush())
            .with_context(|| self.script.clone())?;
        self.answer()
    }

    fn answer(&mut self) -> Result<String> {
        let mut line = String::new();
        self.output.read_line(&mut line).with_context(|| self.script.clone())?;
        ensure!(!line.is_empty(), "{} ended early; its words are above", self.script);
        Ok(line.trim().to_owned())
    }
}

impl Drop for PeerProcess {
    fn drop(&mut self) {
        // It may have ended on its own.
        _ = self.child.kill();
        _ = self.child.wait();
    }
}
