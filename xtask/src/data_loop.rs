//! `cargo xtask loop`: the whole data loop on this computer. A simulated robot explores and records, `pull-buffer`
//! copies the recordings to the workstation over a real ssh server on loopback, the trainer trains on them,
//! `push-model` sends the network back, the robot's gate judges it, and the robot continues with it, on trial.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::{Context, Result, bail};

use crate::{command, onnx_runtime, paths, trainer};

const SCENE: &str = "builtin:apartment?seed=5";
/// More than the loop takes: the robot explores until this chore stops it.
const FRAMES: &str = "1000000";
/// Number of new frames that begin a round of training. A tenth of them is held out for the gate.
const NEW_FRAMES: &str = "1500";
/// Training steps of a round.
const STEPS: &str = "200";
/// The robot's configuration. Segments and trials are short, so that the loop is. The limit for an inference is high, because
/// robot and workstation share this computer's processors.
const CONFIG: &str = "\
[recording]
segment_s = 30.0
[models]
store = \"STORE\"
trusted_keys = \"KEYS\"
recordings = \"RUNS\"
trial_ticks = 300
trial_m = 3.0
max_p99_ms = 1000.0
";

pub fn run() -> Result<()> {
    let library = onnx_runtime::install()?;
    let python = trainer::install()?;
    println!("building the programs in release; the first time takes some minutes");
    let packages = ["firmware-host", "pull-buffer", "push-model", "hil"]
        .map(|package| format!("--package={package}"));
    command::run(command::cargo().args(["build", "--release", "--locked"]).args(packages))?;
    let dir = paths::target().join("loop");
    if dir.exists() {
        fs::remove_dir_all(&dir)
            .with_context(|| format!("removing the last loop in {}", dir.display()))?;
    }
    let demo = Demo::new(&dir, &library, &python)?;
    demo.play()
}

/// Folders and programs of the loop.
struct Demo {
    robot: PathBuf,
    workstation: PathBuf,
    programs: PathBuf,
    library: PathBuf,
    trainer: PathBuf,
    ssh: Vec<String>,
    /// Stopped when it is dropped.
    _sshd: Running,
}

impl Demo {
    fn new(dir: &Path, library: &Path, python: &Path) -> Result<Self> {
        let programs = paths::target().join("release");
        let robot = dir.join("robot");
        let workstation = dir.join("workstation");
        for folder in [robot.join("runs"), workstation.clone()] {
            fs::create_dir_all(folder)?;
        }
        let mut sshd = Command::new(programs.join("hil"));
        sshd.arg("sshd").arg("--dir").arg(dir.join("ssh")).stdout(Stdio::piped());
        let mut sshd = sshd.spawn().context("cannot start `hil sshd`")?;
        let said = BufReader::new(sshd.stdout.take().context("no output")?);
        let ssh: Vec<String> = said.lines().take(SSH_OPTIONS).map_while(Result::ok).collect();
        let sshd = Running { name: "sshd", child: sshd, printers: Vec::new() };
        if ssh.len() < SSH_OPTIONS {
            bail!("the ssh server cannot be started; `apt-get install openssh-server` may help");
        }
        let trainer = python.with_file_name("embodied-depth");
        let demo = Self {
            robot,
            workstation,
            programs,
            library: library.to_owned(),
            trainer,
            ssh,
            _sshd: sshd,
        };
        command::run(
            demo.program("push-model")
                .args(["keygen", "--no-password", "--comment", "demo"])
                .arg(demo.key()),
        )?;
        fs::copy(demo.key().with_extension("key.pub"), demo.robot.join("trusted_keys"))?;
        let config = CONFIG
            .replace("STORE", &demo.store().to_string_lossy())
            .replace("KEYS", &demo.robot.join("trusted_keys").to_string_lossy())
            .replace("RUNS", &demo.robot.join("runs").to_string_lossy());
        fs::write(demo.config(), config)?;
        Ok(demo)
    }

    fn play(&self) -> Result<()> {
        step("the robot explores a home, in virtual time, without a network");
        // In virtual time the robot uses all processor time that it gets. The workstation needs some too.
        let mut explore = Command::new("nice");
        explore
            .args(["-n", "10"])
            .arg(self.programs.join("firmware-host"))
            .env("ORT_DYLIB_PATH", &self.library);
        explore.args([
            "explore", "--scene", SCENE, "--policy", "active", "--frames", FRAMES, "--seed", "1",
        ]);
        explore.arg("--config").arg(self.config()).arg("--model-store").arg(self.store());
        explore.arg("--out").arg(self.robot.join("runs/one"));
        let mut robot =
            Running::start("robot", explore.env("RUST_LOG", "firmware_host::model=info,warn"))?;
        let mut pull = self.program("pull-buffer");
        pull.arg(format!("robot=127.0.0.1:{}", self.robot.join("runs").display()))
            .arg(self.pulled())
            .arg("--follow");
        pull.arg(format!("--program={}", self.programs.join("firmware-host").display()));
        pull.args(self.ssh.iter().map(|option| format!("--ssh={option}")));
        let pull = Running::start("pull", &mut pull)?;

        step(
            "a first round of training on the pulled recordings: the gate judges it on held-out frames, then a trial",
        );
        self.watch("1")?;
        self.wait_for_trial(&mut robot)?;
        step("a second round: the gate compares it with the first on the same held-out frames");
        self.watch("2")?;
        self.wait_for_trial(&mut robot)?;
        step("a network that was changed after it was signed");
        let forged = Running::start("push", &mut self.shell(&self.push(&self.forge()?)))?.wait()?;

        step("the robot's models");
        drop(pull);
        robot.interrupt()?;
        let mut list = self.program("firmware-host");
        command::run(list.args(["model", "--config"]).arg(self.config()).arg("list"))?;
        step("replay of the run, with the models that it drove with");
        let mut replay = self.program("firmware-host");
        replay
            .arg("replay")
            .arg(self.robot.join("runs/one"))
            .arg("--model-store")
            .arg(self.store());
        command::run(&mut replay)?;
        if forged {
            bail!("the gate accepted an unsigned network; please report this");
        }
        Ok(())
    }

    /// One round of the trainer. Its network is pushed to the robot.
    fn watch(&self, rounds: &str) -> Result<()> {
        let mut watch = Command::new(&self.trainer);
        watch
            .arg("watch")
            .arg("--pulled")
            .arg(self.pulled())
            .arg("--work")
            .arg(self.workstation.join("train"));
        watch.arg("--firmware-host").arg(self.programs.join("firmware-host"));
        watch.args(["--frames", NEW_FRAMES, "--rounds", rounds, "--steps", STEPS]);
        watch
            .arg("--then")
            .arg(format!("{} --key={}", self.push(Path::new("{}")), self.key().display()))
            .env("ORT_DYLIB_PATH", &self.library);
        if !Running::start("train", &mut watch)?.wait()? {
            bail!("the training failed; its output is above");
        }
        Ok(())
    }

    /// The command line that sends a model to the robot.
    fn push(&self, model: &Path) -> String {
        let mut words = vec![
            self.programs.join("push-model").display().to_string(),
            model.display().to_string(),
        ];
        words.push(format!("127.0.0.1:{}", self.store().display()));
        let program = self.programs.join("firmware-host");
        words.push(format!(
            "'--program=env ORT_DYLIB_PATH={} {}'",
            self.library.display(),
            program.display()
        ));
        words.extend(self.ssh.iter().map(|option| format!("--ssh={option}")));
        words.push(format!("--gate=--config={}", self.config().display()));
        // By default the gate has idle priority, and a robot in virtual time leaves no idle processor time.
        words.push("--gate=--normal-priority".to_owned());
        words.join(" ")
    }

    /// The first network and its signature, with one bit of the network changed.
    fn forge(&self) -> Result<PathBuf> {
        let models = self.workstation.join("train/models");
        let forged = self.workstation.join("forged.onnx");
        let mut bytes = fs::read(models.join("model_0000.onnx"))?;
        let middle = bytes.len() / 2;
        if let Some(byte) = bytes.get_mut(middle) {
            *byte ^= 1;
        }
        fs::write(&forged, bytes)?;
        fs::copy(
            models.join("model_0000.onnx.minisig"),
            self.workstation.join("forged.onnx.minisig"),
        )?;
        Ok(forged)
    }

    fn shell(&self, line: &str) -> Command {
        let mut shell = Command::new("sh");
        shell.args(["-c", line]);
        shell
    }

    /// Waits until the trial of the robot's newest model has ended.
    fn wait_for_trial(&self, robot: &mut Running) -> Result<()> {
        println!("waiting for the end of the trial");
        for _ in 0..TRIAL_POLLS {
            let mut list = self.program("firmware-host");
            let output = list
                .args(["model", "--json", "--config"])
                .arg(self.config())
                .arg("list")
                .output()?;
            let models: serde_json::Value =
                serde_json::from_slice(&output.stdout).context("`model list --json`")?;
            if models["state"]["trial_starts"].is_null() {
                return Ok(());
            }
            if robot.child.try_wait()?.is_some() {
                bail!("the robot has ended; its output is above");
            }
            command::run(Command::new("sleep").arg("2"))?;
        }
        println!("the trial has not ended; going on");
        Ok(())
    }

    fn program(&self, name: &str) -> Command {
        let mut program = Command::new(self.programs.join(name));
        program.env("ORT_DYLIB_PATH", &self.library);
        program
    }

    fn key(&self) -> PathBuf {
        self.workstation.join("demo.key")
    }

    fn pulled(&self) -> PathBuf {
        self.workstation.join("pulled")
    }

    fn store(&self) -> PathBuf {
        self.robot.join("models")
    }

    fn config(&self) -> PathBuf {
        self.robot.join("robot.toml")
    }
}

/// Number of options that `hil sshd` prints.
const SSH_OPTIONS: usize = 8;
/// How often the model store is polled for the end of a trial, every 2 s.
const TRIAL_POLLS: u32 = 300;

fn step(what: &str) {
    println!("\n== {what}");
}

/// A program whose output is printed with its name before every line. It is killed when it is dropped.
struct Running {
    name: &'static str,
    child: Child,
    printers: Vec<JoinHandle<()>>,
}

impl Running {
    fn start(name: &'static str, command: &mut Command) -> Result<Self> {
        let line = command::text(command);
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start `{line}`"))?;
        let mut printers = Vec::new();
        printers.extend(child.stdout.take().map(|output| print_lines(name, output)));
        printers.extend(child.stderr.take().map(|output| print_lines(name, output)));
        Ok(Self { name, child, printers })
    }

    /// Waits for its end. Returns whether it succeeded.
    fn wait(mut self) -> Result<bool> {
        let status = self.child.wait()?;
        self.printers.drain(..).for_each(|printer| drop(printer.join()));
        Ok(status.success())
    }

    /// Interrupts it as Ctrl-C does, and waits for its end.
    fn interrupt(mut self) -> Result<()> {
        command::run(Command::new("kill").arg("-INT").arg(self.child.id().to_string()))?;
        let status = self.child.wait()?;
        self.printers.drain(..).for_each(|printer| drop(printer.join()));
        println!("{} ended with {status}", self.name);
        Ok(())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn print_lines(name: &'static str, output: impl Read + Send + 'static) -> JoinHandle<()> {
    std::thread::spawn(move || {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            println!("{name:>6} | {line}");
        }
    })
}
