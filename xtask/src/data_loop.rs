//! `cargo xtask loop`: the whole loop on this computer. A simulated robot explores and records; `pull-buffer` brings that to the
//! workstation over a real ssh server on loopback; the trainer learns from it; `push-model` sends the network back; the robot's
//! gate judges it; the robot drives on with it, on trial.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::{Context, Result, bail};

use crate::{command, onnx_runtime, paths, trainer};

const SCENE: &str = "builtin:apartment?seed=5";
/// Until it is told to stop.
const FRAMES: &str = "1000000";
/// New pictures that begin a round of training, and its steps. A tenth of the pictures is held out, and the gate wants to see some.
const PICTURES: &str = "1500";
const STEPS: &str = "200";
/// The robot's own file: short segments and short trials, so that a person can wait for them; and time for an inference, for robot
/// and workstation share their processors here.
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

/// Where everything is.
struct Demo {
    robot: PathBuf,
    workstation: PathBuf,
    programs: PathBuf,
    library: PathBuf,
    trainer: PathBuf,
    ssh: Vec<String>,
    /// Ends with its owner.
    _sshd: Running,
}

impl Demo {
    fn new(dir: &Path, library: &Path, python: &Path) -> Result<Self> {
        let programs = paths::target().join("release");
        let (robot, workstation) = (dir.join("robot"), dir.join("workstation"));
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
            bail!("there is no ssh server to start; `apt-get install openssh-server` may help");
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
        // It never waits in virtual time; the workstation is to have time as well.
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
        pull.arg(format!("--remote-command={}", self.programs.join("firmware-host").display()));
        pull.args(self.ssh.iter().map(|option| format!("--ssh-option={option}")));
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

        step("what became of the models");
        drop(pull);
        robot.interrupt()?;
        let mut list = self.program("firmware-host");
        command::run(list.args(["model", "--config"]).arg(self.config()).arg("list"))?;
        step("every decision of the run again, with the models that it drove with");
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

    /// One round of the trainer; what it makes is pushed.
    fn watch(&self, rounds: &str) -> Result<()> {
        let mut watch = Command::new(&self.trainer);
        watch
            .arg("watch")
            .arg("--pulled")
            .arg(self.pulled())
            .arg("--work")
            .arg(self.workstation.join("train"));
        watch.arg("--firmware-host").arg(self.programs.join("firmware-host"));
        watch.args(["--pictures", PICTURES, "--rounds", rounds, "--steps", STEPS]);
        watch
            .arg("--then")
            .arg(format!("{} --key={}", self.push(Path::new("{}")), self.key().display()))
            .env("ORT_DYLIB_PATH", &self.library);
        if !Running::start("train", &mut watch)?.wait()? {
            bail!("the training failed; what it said is above");
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
        // A robot in virtual time leaves no idle time; a real one does.
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

    /// Until the robot has decided what it thinks of its newest model.
    fn wait_for_trial(&self, robot: &mut Running) -> Result<()> {
        println!("waiting for the end of the trial");
        for _ in 0..TRIAL_LOOKS {
            let mut list = self.program("firmware-host");
            let said = list
                .args(["model", "--json", "--config"])
                .arg(self.config())
                .arg("list")
                .output()?;
            let said: serde_json::Value =
                serde_json::from_slice(&said.stdout).context("`model list --json`")?;
            if said["state"]["trial_starts"].is_null() {
                return Ok(());
            }
            if robot.child.try_wait()?.is_some() {
                bail!("the robot has ended; what it said is above");
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

/// Options that `hil sshd` prints.
const SSH_OPTIONS: usize = 8;
/// Looks at the store, 2 s apart.
const TRIAL_LOOKS: u32 = 300;

fn step(what: &str) {
    println!("\n== {what}");
}

/// A program whose every line is printed with its name before it. Killed when it is dropped.
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

    /// Its end; whether it was well.
    fn wait(mut self) -> Result<bool> {
        let status = self.child.wait()?;
        self.printers.drain(..).for_each(|printer| drop(printer.join()));
        Ok(status.success())
    }

    /// As Ctrl-C does it, and waits.
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
