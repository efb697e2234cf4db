//! How long the gate takes to judge a model by 300 held-out frames, alone and beside a robot that drives in real time through its
//! real drivers, and whether that robot's turns come in time. Without `firmware-host` in `BENCH_PROGRAMS` or ONNX Runtime these
//! rows are absent. Takes about ten minutes, most of it to record.

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

const ROOM: &str = "data";
const HELD_OUT_FRAMES: u64 = 300;
/// 150 of the 3000 frames of a run are held out and far enough from each other.
const RUNS: [&str; 3] =
    ["builtin:apartment?seed=1", "builtin:house?seed=2", "builtin:office?seed=3"];
const FRAMES: &str = "3000";
/// A robot that starts is busier than one that drives.
const SETTLED_TURNS: u64 = 50;
/// Driving without the gate, for comparison.
const ALONE_S: u64 = 60;

/// Measures the gate.
///
/// # Errors
/// When a program fails or judges fewer frames.
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
    let workshop = Workshop::new(&program, dir.path())?;
    let alone_s = workshop.gate(&dir.path().join("alone"))?;
    let robot = Robot::start(&workshop, &dir.path().join("robot"))?;
    let before = robot.turns()?;
    let mut clock = MonotonicClock;
    clock.sleep_until_ns(clock.now_ns() + ALONE_S * 1_000_000_000);
    let without = robot.turns()?.since(before);
    let before = robot.turns()?;
    let beside_s = workshop.gate(&dir.path().join("beside"))?;
    let with = robot.turns()?.since(before);
    let one = |value| Timing::of(vec![value]);
    let seconds = |name, value| Row::seconds(ROOM, name, one(value));
    Ok(vec![
        seconds("gate: 300 held-out pictures of 640x192, two networks, alone", alone_s)
            .goal(60.0, 30.0)
            .note("at idle priority"),
        seconds("gate: the same beside a robot that drives", beside_s).note("at idle priority"),
        Row::new(
            ROOM,
            "turns in time of a robot that drives, the gate beside it",
            Unit::Share,
            one(with.in_time()),
        )
        .peer("without the gate", without.in_time())
        .note(format!(
            "{} of {} turns left out; without {} of {}",
            with.left_out,
            with.all(),
            without.left_out,
            without.all()
        )),
    ])
}

/// What a workstation and its robot have.
struct Workshop {
    program: PathBuf,
    dir: PathBuf,
    resident: PathBuf,
    candidate: PathBuf,
}

impl Workshop {
    /// Keys, recordings, and the default network twice: as itself, and signed under another digest.
    fn new(program: &Path, dir: &Path) -> Result<Self> {
        let resident =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware-host/models/default.onnx");
        let candidate = dir.join("candidate.onnx");
        // ModelProto's `doc_string`, field 6: says nothing, and changes the digest.
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
        // Slowness is shown by the table, not refused.
        std::fs::write(
            dir.join("robot.toml"),
            "[models]\nmax_p99_ms = 10000.0\ngate_timeout_s = 3600\n",
        )?;
        let workshop =
            Self { program: program.to_owned(), dir: dir.to_owned(), resident, candidate };
        for (number, scene) in RUNS.iter().enumerate() {
            let mut explore = workshop.firmware(&["explore", "--frames", FRAMES, "--scene", scene]);
            explore
                .arg("--out")
                .arg(dir.join("runs").join(number.to_string()))
                .stdout(Stdio::null());
            ensure!(explore.status()?.success(), "{explore:?}");
        }
        Ok(workshop)
    }

    fn firmware(&self, args: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(args);
        command
    }

    /// Seconds of `model install` into a new store whose resident is the default network.
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
        let said: Value = serde_json::from_slice(&output.stdout)
            .with_context(|| String::from_utf8_lossy(&output.stderr).into_owned())?;
        ensure!(said["verdict"]["pictures"] == HELD_OUT_FRAMES, "the gate says {said}");
        Ok(seconds)
    }
}

/// A robot in a simulated home, behind simulated devices, in real time.
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
    fn start(workshop: &Workshop, dir: &Path) -> Result<Self> {
        let world = LiveWorld::start(dir, &LiveOptions::default())
            .map_err(|error| anyhow::anyhow!("{error}"))?;
        let mut run = workshop.firmware(&["run"]);
        run.arg("--config")
            .arg(world.config())
            .arg("--model")
            .arg(&workshop.resident)
            .arg("--out")
            .arg(dir.join("run"));
        let child = run.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let mut robot = Self { dir: dir.to_owned(), child, _world: world };
        let mut clock = MonotonicClock;
        while robot.turns().map_or(0, |turns| turns.done) < SETTLED_TURNS {
            ensure!(robot.child.try_wait()?.is_none(), "the robot does not drive");
            clock.sleep_until_ns(clock.now_ns() + 100_000_000);
        }
        Ok(robot)
    }

    fn turns(&self) -> Result<Turns> {
        let exploration = Status::read(&self.dir.join("status.json"))?.exploration;
        Ok(Turns { done: exploration.ticks, left_out: exploration.skipped })
    }
}

/// Turns of the exploration plane; one is left out when the one before takes longer than its period.
#[derive(Debug, Clone, Copy)]
struct Turns {
    done: u64,
    left_out: u64,
}

impl Turns {
    fn since(self, before: Self) -> Self {
        Self { done: self.done - before.done, left_out: self.left_out - before.left_out }
    }

    fn all(self) -> u64 {
        self.done + self.left_out
    }

    fn in_time(self) -> f64 {
        self.done as f64 / self.all().max(1) as f64
    }
}
