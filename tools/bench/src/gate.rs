//! The time in which the gate evaluates a model on 300 held-out frames, alone and beside a robot that drives in real time
//! through its real drivers, and the share of that robot's ticks that are in time. Without `firmware-host` in
//! `BENCH_PROGRAMS` or ONNX Runtime, these rows are absent. Takes about ten minutes, most of it for recording.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use firmware_host::model::Store;
use firmware_host::run::status::Status;
use hal::Clock;
use hil::world::{LiveOptions, LiveWorld};
use monotonic_clock::MonotonicClock;
use serde_json::Value;

use crate::report::{Row, Timing, Unit};

const AREA: &str = "data";
const HELD_OUT_FRAMES: u64 = 300;
/// 150 of the 3000 frames of a run are held out and have enough distance from each other.
const RUNS: [&str; 3] =
    ["builtin:apartment?seed=1", "builtin:house?seed=2", "builtin:office?seed=3"];
const FRAMES: &str = "3000";
/// The robot is measured after this number of ticks: it is busier while it starts.
const SETTLED_TICKS: u64 = 50;
/// Duration of driving without the gate, for comparison, seconds.
const ALONE_S: u64 = 60;

/// Measures the gate.
///
/// # Errors
/// When a program fails, or the gate evaluates fewer frames.
pub fn rows() -> Result<Vec<Row>> {
    let programs = std::env::var_os("BENCH_PROGRAMS")
        .map(|folder| PathBuf::from(folder).join("firmware-host"));
    let Some(program) =
        programs.filter(|path| path.is_file() && std::env::var_os("ORT_DYLIB_PATH").is_some())
    else {
        eprintln!("no rows of the gate: no firmware-host in BENCH_PROGRAMS, or no ONNX Runtime");
        return Ok(Vec::new());
    };
    let dir = tempfile::tempdir()?;
    let setup = Setup::new(&program, dir.path())?;
    let alone_s = setup.gate(&dir.path().join("alone"))?;
    let robot = Robot::start(&setup, &dir.path().join("robot"))?;
    let before = robot.ticks()?;
    let mut clock = MonotonicClock;
    clock.sleep_until_ns(clock.now_ns() + ALONE_S * 1_000_000_000);
    let without = robot.ticks()?.since(before);
    let before = robot.ticks()?;
    let beside_s = setup.gate(&dir.path().join("beside"))?;
    let with = robot.ticks()?.since(before);
    Ok(vec![
        seconds_row("gate: 300 held-out frames of 640x192, two networks, alone", alone_s)
            .goal(60.0, 30.0),
        seconds_row("gate: the same beside a robot that drives", beside_s),
        Row::new(
            AREA,
            "share of ticks in time of a robot that drives, beside the gate",
            Unit::Share,
            Timing::of(vec![with.in_time()]),
        )
        .peer("without the gate", without.in_time())
        .note(format!(
            "{} of {} ticks skipped; without the gate {} of {}",
            with.skipped,
            with.all(),
            without.skipped,
            without.all()
        )),
    ])
}

fn seconds_row(name: &str, seconds: f64) -> Row {
    Row::seconds(AREA, name, Timing::of(vec![seconds])).note("at idle priority")
}

/// The files of a workstation and its robot.
struct Setup {
    program: PathBuf,
    dir: PathBuf,
    resident: PathBuf,
    candidate: PathBuf,
}

impl Setup {
    /// Creates keys, recordings, and the default network twice: unchanged, and signed with another digest.
    fn new(program: &Path, dir: &Path) -> Result<Self> {
        let resident =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware-host/models/default.onnx");
        let candidate = dir.join("candidate.onnx");
        // ModelProto's `doc_string`, field 6, has no effect but changes the digest.
        let bytes = [std::fs::read(&resident)?, b"\x32\x05again".to_vec()].concat();
        std::fs::write(&candidate, &bytes)?;
        std::fs::write(
            dir.join("trusted_keys"),
            signed_model::generate_keys(&dir.join("key"), None, "bench")?,
        )?;
        let key = signed_model::read_secret_key(&dir.join("key"), || Ok(String::new()))?;
        std::fs::write(
            signed_model::Bundle::signature_path(&candidate),
            signed_model::sign(&bytes, "candidate", &key)?,
        )?;
        // The gate must not refuse a slow model here: the table shows its duration.
        std::fs::write(
            dir.join("robot.toml"),
            "[models]\nmax_p99_ms = 10000.0\ngate_timeout_s = 3600\n",
        )?;
        let setup = Self { program: program.to_owned(), dir: dir.to_owned(), resident, candidate };
        for (number, scene) in RUNS.iter().enumerate() {
            let mut explore = setup.firmware(&["explore", "--frames", FRAMES, "--scene", scene]);
            explore
                .arg("--out")
                .arg(dir.join("runs").join(number.to_string()))
                .stdout(Stdio::null());
            ensure!(explore.status()?.success(), "{explore:?}");
        }
        Ok(setup)
    }

    fn firmware(&self, args: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(args);
        command
    }

    /// Seconds that `model install` takes in a new store whose resident model is the default network.
    fn gate(&self, store: &Path) -> Result<f64> {
        Store::open(store)?.adopt(&std::fs::read(&self.resident)?, "default")?;
        let mut install = self.firmware(&["model", "install", "--json"]);
        install
            .arg(&self.candidate)
            .arg("--store")
            .arg(store)
            .arg("--config")
            .arg(self.dir.join("robot.toml"));
        install
            .arg("--trusted-keys")
            .arg(self.dir.join("trusted_keys"))
            .arg("--recordings")
            .arg(self.dir.join("runs"));
        install.args(["--frames", &HELD_OUT_FRAMES.to_string()]);
        let began = Instant::now();
        let output = install.output()?;
        let seconds = began.elapsed().as_secs_f64();
        let answer: Value = serde_json::from_slice(&output.stdout)
            .with_context(|| String::from_utf8_lossy(&output.stderr).into_owned())?;
        ensure!(answer["verdict"]["frames"] == HELD_OUT_FRAMES, "the gate's answer is {answer}");
        Ok(seconds)
    }
}

/// A robot in a simulated home with simulated devices, in real time.
struct Robot {
    dir: PathBuf,
    child: Child,
    _world: LiveWorld,
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Robot {
    fn start(setup: &Setup, dir: &Path) -> Result<Self> {
        let world = LiveWorld::start(dir, &LiveOptions::default())
            .map_err(|error| anyhow::anyhow!("{error}"))?;
        let mut run = setup.firmware(&["run"]);
        run.arg("--config")
            .arg(world.config())
            .arg("--model")
            .arg(&setup.resident)
            .arg("--out")
            .arg(dir.join("run"));
        let child = run.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let mut robot = Self { dir: dir.to_owned(), child, _world: world };
        let mut clock = MonotonicClock;
        while robot.ticks().map_or(0, |ticks| ticks.done) < SETTLED_TICKS {
            ensure!(robot.child.try_wait()?.is_none(), "the robot has stopped");
            clock.sleep_until_ns(clock.now_ns() + 100_000_000);
        }
        Ok(robot)
    }

    fn ticks(&self) -> Result<Ticks> {
        let exploration = Status::read(&self.dir.join("status.json"))?.exploration;
        Ok(Ticks { done: exploration.ticks, skipped: exploration.skipped })
    }
}

/// Ticks of the exploration plane. A tick is skipped when the one before takes longer than its period.
#[derive(Debug, Clone, Copy)]
struct Ticks {
    done: u64,
    skipped: u64,
}

impl Ticks {
    fn since(self, before: Self) -> Self {
        Self { done: self.done - before.done, skipped: self.skipped - before.skipped }
    }

    fn all(self) -> u64 {
        self.done + self.skipped
    }

    fn in_time(self) -> f64 {
        self.done as f64 / self.all().max(1) as f64
    }
}
