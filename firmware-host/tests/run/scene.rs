//! A robot whose devices are simulated, driven by the whole program in real time.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use assert_cmd::cargo::CommandCargoExt;
use drivers::can::messages::SafetyInput;
use drivers::can::{CanBus, Protocol, UnixBus};
use firmware_host::run::status::Status;
use hal::{CameraModel, Clock};
use hil::world::{LiveOptions, LiveWorld};
use monotonic_clock::MonotonicClock;
use rustix::process::{Pid, Signal, kill_process};

/// Long enough for a computer that does something else as well; a robot that works needs a tenth of it.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Real time passes, milliseconds.
pub fn pause(ms: u64) {
    let mut clock = MonotonicClock;
    clock.sleep_until_ns(clock.now_ns() + ms * 1_000_000);
}

pub struct Scene {
    pub folder: tempfile::TempDir,
    pub world: LiveWorld,
    pub robot: Child,
}

impl Scene {
    pub fn new(protocol: Protocol) -> Self {
        Self::with(protocol, "", &[])
    }

    /// With more lines of configuration and more arguments. `{}` is the scene's folder.
    pub fn with(protocol: Protocol, more: &str, args: &[&str]) -> Self {
        Self::with_file(protocol, more, args, None)
    }

    /// With a file in its folder that is there before the program starts, by its name and content.
    pub fn with_file(
        protocol: Protocol,
        more: &str,
        args: &[&str],
        file: Option<(&str, &[u8])>,
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        if let Some((name, content)) = file {
            std::fs::write(folder.path().join(name), content).unwrap();
        }
        let options = LiveOptions {
            protocol,
            // Small images, because this test is about devices.
            camera: CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2),
            ..LiveOptions::default()
        };
        let world = LiveWorld::start(folder.path(), &options).unwrap();
        let config = std::fs::read_to_string(world.config()).unwrap();
        std::fs::write(world.config(), config + &in_folder(more, folder.path())).unwrap();
        let args: Vec<String> = args.iter().map(|arg| in_folder(arg, folder.path())).collect();
        let robot = start(&world, folder.path(), "run", &args);
        Self { folder, world, robot }
    }

    /// With an inertial measurement unit.
    pub fn with_imu() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
        let options = LiveOptions { camera, imu: true, ..LiveOptions::default() };
        let world = LiveWorld::start(folder.path(), &options).unwrap();
        let robot = start(&world, folder.path(), "run", &[]);
        Self { folder, world, robot }
    }

    /// With a part of its configuration replaced. `{}` is the scene's folder.
    pub fn with_another(from: &str, to: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
        let options = LiveOptions { camera, ..LiveOptions::default() };
        let world = LiveWorld::start(folder.path(), &options).unwrap();
        let config = std::fs::read_to_string(world.config()).unwrap();
        let to = to.replace("{}", folder.path().to_str().unwrap());
        let changed = config.replace(from, &to);
        assert_ne!(config, changed);
        std::fs::write(world.config(), changed).unwrap();
        let robot = start(&world, folder.path(), "run", &[]);
        Self { folder, world, robot }
    }

    /// With a safety board on the bus, which is configured. Its first frame already says whether its stop is pressed.
    pub fn with_board(pressed: bool) -> (Self, Board) {
        let scene = Self::with_another("safety_board = false", "safety_board = true");
        let board = Board::start(&scene.path("can"), pressed);
        (scene, board)
    }

    /// Ends the program and starts another one.
    pub fn restart(&mut self, out: &str) {
        self.signal(Signal::TERM);
        assert!(self.robot.wait().unwrap().success());
        self.robot = start(&self.world, self.folder.path(), out, &[]);
    }

    pub fn needs_person(&self, why: &str) {
        self.wait(why, |scene| {
            scene.status().is_some_and(|status| status.safety.needs_person)
                && scene.health().1.contains(why)
        });
    }

    /// It stands for three seconds, and drives after a person has armed it.
    pub fn stands_until_armed(&self) {
        let (_, before_m) = self.world.home().score();
        pause(3000);
        let gone_m = self.world.home().score().1 - before_m;
        assert!(gone_m < 0.02, "{gone_m} m without being armed; {:#?}", self.status());
        let (_, before_m) = self.world.home().score();
        self.wait("driving after SIGUSR1", |scene| {
            scene.signal(Signal::USR1);
            pause(2000);
            scene.world.home().score().1 > before_m + 0.1
        });
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn skipped(&self) -> u64 {
        self.status().map_or(0, |status| status.exploration.skipped)
    }

    pub fn status(&self) -> Option<Status> {
        Status::read(&self.folder.path().join("status.json")).ok()
    }

    pub fn wait(&self, what: &str, mut done: impl FnMut(&Self) -> bool) {
        let began = Instant::now();
        while !done(self) {
            assert!(began.elapsed() < PATIENCE, "{what} did not happen; {:#?}", self.status());
            pause(20);
        }
    }

    /// Waits for its first drive. The simulated motors may be late at the start on a busy computer;
    /// a person then arms the robot again.
    pub fn drives_first(&self) {
        self.wait("the first drive", |scene| {
            if scene.status().is_some_and(|status| status.safety.needs_person) {
                scene.signal(Signal::USR1);
                pause(500);
            }
            scene.world.home().score().1 > 0.1
        });
    }

    /// Waits until it has driven a hand's breadth from here.
    pub fn drives(&self, when: &str) {
        let (_, before_m) = self.world.home().score();
        self.wait(when, |scene| scene.world.home().score().1 > before_m + 0.1);
    }

    pub fn state_is(&self, state: &str) {
        self.wait(state, |scene| scene.status().is_some_and(|status| status.safety.state == state));
    }

    /// How far the robot drives in half a second, metres.
    pub fn driven_m(&self) -> f64 {
        let (_, before_m) = self.world.home().score();
        pause(500);
        self.world.home().score().1 - before_m
    }

    pub fn health(&self) -> (bool, String) {
        let status = self.folder.path().join("status.json");
        let output = Command::cargo_bin("firmware-host")
            .unwrap()
            .args(["health", "--status"])
            .arg(status)
            .output()
            .unwrap();
        (output.status.success(), String::from_utf8(output.stdout).unwrap())
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_raw(self.robot.id() as i32).unwrap(), signal).unwrap();
    }

    pub fn ends_well(&mut self) {
        self.ends_and_replays(&[]);
    }

    pub fn ends_and_replays(&mut self, args: &[&Path]) {
        self.signal(Signal::TERM);
        assert!(self.robot.wait().unwrap().success());
        let (same, text) = replayed(&self.folder.path().join("run"), args);
        assert!(same && text.contains("mismatches=0"), "{text}");
        assert_eq!(self.world.home().score().0, 0, "it touched something");
    }
}

pub fn in_folder(text: &str, folder: &Path) -> String {
    text.replace("{}", folder.to_str().unwrap())
}

pub fn start(world: &LiveWorld, folder: &Path, out: &str, args: &[String]) -> Child {
    Command::cargo_bin("firmware-host")
        .unwrap()
        .args(["run", "--config"])
        .arg(world.config())
        .arg("--out")
        .arg(folder.join(out))
        .args(args)
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

/// A safety board on the simulated bus.
pub struct Board {
    inputs: Arc<BoardInputs>,
    thread: Option<JoinHandle<()>>,
}

/// What the board reads, and whether it is there.
struct BoardInputs {
    pressed: AtomicBool,
    cliff: AtomicBool,
    plugged: AtomicBool,
    running: AtomicBool,
}

impl Board {
    pub fn start(hub: &Path, is_pressed: bool) -> Self {
        let inputs = Arc::new(BoardInputs {
            pressed: AtomicBool::new(is_pressed),
            cliff: AtomicBool::new(false),
            plugged: AtomicBool::new(true),
            running: AtomicBool::new(true),
        });
        let mut bus = UnixBus::new(hub.to_str().unwrap());
        let now = Arc::clone(&inputs);
        let thread = Some(std::thread::spawn(move || {
            let mut clock = MonotonicClock;
            let mut counter = 0;
            while now.running.load(Ordering::Relaxed) {
                while bus.receive(clock.now_ns()).is_some() {}
                counter = (counter + 1) % 16;
                let estop = now.pressed.load(Ordering::Relaxed);
                let cliff = now.cliff.load(Ordering::Relaxed);
                if now.plugged.load(Ordering::Relaxed) {
                    let input = SafetyInput { counter, estop, bumper: false, cliff };
                    let _ = bus.send(&input.encode());
                }
                clock.sleep_until_ns(clock.now_ns() + 20_000_000);
            }
        }));
        Self { inputs, thread }
    }

    /// Unplugs the board from the bus, or plugs it in again.
    pub fn plug(&self, on: bool) {
        self.inputs.plugged.store(on, Ordering::Relaxed);
    }

    pub fn press(&self, pressed: bool) {
        self.inputs.pressed.store(pressed, Ordering::Relaxed);
    }

    /// Lets the cliff sensors see no floor, or see it again.
    pub fn put_before_cliff(&self, cliff: bool) {
        self.inputs.cliff.store(cliff, Ordering::Relaxed);
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.inputs.running.store(false, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        let _ = self.robot.kill();
        let _ = self.robot.wait();
    }
}

pub fn replayed(run: &Path, args: &[&Path]) -> (bool, String) {
    let output = Command::cargo_bin("firmware-host")
        .unwrap()
        .arg("replay")
        .arg(run)
        .args(args)
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap()).concat();
    (output.status.success(), text)
}
