//! The whole binary on simulated devices, in real time and through the real drivers: what it promises when devices come and go.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use assert_cmd::cargo::CommandCargoExt;
use drivers::can::Protocol;
use firmware_host::model::{State, Store, What};
use firmware_host::run::status::Status;
use hal::{CameraModel, Clock};
use hil::world::{LiveOptions, LiveWorld};
use monotonic_clock::MonotonicClock;
use rustix::process::{Pid, Signal, kill_process};

/// Long enough for a computer that does something else as well; a robot that works needs a tenth of it.
const PATIENCE: Duration = Duration::from_secs(60);

/// Real time passes, milliseconds.
fn pause(ms: u64) {
    let mut clock = MonotonicClock;
    clock.sleep_until_ns(clock.now_ns() + ms * 1_000_000);
}

struct Scene {
    folder: tempfile::TempDir,
    world: LiveWorld,
    robot: Child,
}

impl Scene {
    fn new(protocol: Protocol) -> Self {
        Self::with(protocol, "", &[])
    }

    /// With more lines of configuration and more arguments. `{}` is the scene's folder.
    fn with(protocol: Protocol, more: &str, args: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let options = LiveOptions {
            protocol,
            // Small images, because this test is about devices.
            camera: CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2),
            ..LiveOptions::default()
        };
        let world = LiveWorld::start(folder.path(), &options).unwrap();
        let in_folder = |text: &str| text.replace("{}", folder.path().to_str().unwrap());
        let config = std::fs::read_to_string(world.config()).unwrap();
        std::fs::write(world.config(), config + &in_folder(more)).unwrap();
        let robot = Command::cargo_bin("firmware-host")
            .unwrap()
            .args(["run", "--config"])
            .arg(world.config())
            .arg("--out")
            .arg(folder.path().join("run"))
            .args(args.iter().map(|arg| in_folder(arg)))
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Self { folder, world, robot }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn status(&self) -> Option<Status> {
        Status::read(&self.folder.path().join("status.json")).ok()
    }

    fn wait(&self, what: &str, mut done: impl FnMut(&Self) -> bool) {
        let began = Instant::now();
        while !done(self) {
            assert!(began.elapsed() < PATIENCE, "{what} did not happen; {:#?}", self.status());
            pause(20);
        }
    }

    /// Waits until it has driven a hand's breadth from here.
    fn drives(&self, when: &str) {
        let (_, before_m) = self.world.home().score();
        self.wait(when, |scene| scene.world.home().score().1 > before_m + 0.1);
    }

    fn state_is(&self, state: &str) {
        self.wait(state, |scene| scene.status().is_some_and(|status| status.safety.state == state));
    }

    /// How far it goes in half a second.
    fn way_m(&self) -> f64 {
        let (_, before_m) = self.world.home().score();
        pause(500);
        self.world.home().score().1 - before_m
    }

    fn health(&self) -> (bool, String) {
        let status = self.folder.path().join("status.json");
        let output = Command::cargo_bin("firmware-host")
            .unwrap()
            .args(["health", "--status"])
            .arg(status)
            .output()
            .unwrap();
        (output.status.success(), String::from_utf8(output.stdout).unwrap())
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_raw(self.robot.id() as i32).unwrap(), signal).unwrap();
    }

    fn ends_well(&mut self) {
        self.ends_and_replays(&[]);
    }

    fn ends_and_replays(&mut self, args: &[&Path]) {
        self.signal(Signal::TERM);
        assert!(self.robot.wait().unwrap().success());
        let (same, text) = replayed(&self.folder.path().join("run"), args);
        assert!(same && text.contains("mismatches=0"), "{text}");
        assert_eq!(self.world.home().score().0, 0, "it touched something");
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        let _ = self.robot.kill();
        let _ = self.robot.wait();
    }
}

fn replayed(run: &Path, args: &[&Path]) -> (bool, String) {
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

#[test]
fn a_second_program_for_the_same_base_is_refused_and_the_first_drives_on() {
    let mut scene = Scene::new(Protocol::Odrive);
    scene.drives("the first drive");
    // Without --out, in a folder of its own: nothing may be made there.
    let elsewhere = tempfile::tempdir().unwrap();
    let second = Command::cargo_bin("firmware-host")
        .unwrap()
        .args(["run", "--config"])
        .arg(scene.world.config())
        .current_dir(elsewhere.path())
        .output()
        .unwrap();
    let said = String::from_utf8(second.stderr).unwrap();
    assert!(
        second.status.code() == Some(1)
            && said.contains("another `firmware-host run` drives the base"),
        "{said}"
    );
    assert_eq!(std::fs::read_dir(elsewhere.path()).unwrap().count(), 0);
    scene.drives("driving on");
    scene.ends_well();
}

#[test]
fn it_explores_stands_while_a_device_is_gone_says_so_and_goes_on_without_help() {
    let mut scene = Scene::new(Protocol::Odrive);
    scene.drives("the first drive");

    scene.world.lidar().unplug();
    scene.state_is("fault: the LiDAR is silent");
    assert!(scene.way_m() < 0.01, "it drives without a scanner");
    let (well, text) = scene.health();
    assert!(!well && text.contains("! LiDAR") && text.contains("goes on by itself"), "{text}");
    scene.world.lidar().plug_in().unwrap();
    scene.drives("driving after the scanner was plugged in again");

    scene.world.plug_camera(false);
    scene.wait("a camera that is gone", |scene| {
        scene.status().is_some_and(|status| status.camera.state != "working")
    });
    pause(2000);
    assert!(scene.way_m() < 0.01, "it drives blindly");
    scene.world.plug_camera(true);
    scene.drives("driving after the camera was plugged in again");

    scene.world.wheels()[0].faults().silent = true;
    scene.wait("wheels that are missed", |scene| {
        scene.status().is_some_and(|status| status.safety.state.contains("wheels do not tell"))
    });
    assert!(scene.way_m() < 0.05, "it drives without knowing how far");
    scene.world.wheels()[0].faults().silent = false;
    scene.drives("driving after the wheels speak again");
    scene.ends_well();
}

#[test]
fn a_motor_that_broke_down_needs_a_person_and_sigusr1_is_that_person() {
    let mut scene = Scene::new(Protocol::Cia402);
    scene.drives("the first drive");
    scene.world.wheels()[1].faults().broken = true;
    scene.wait("a fault", |scene| scene.status().is_some_and(|status| status.safety.needs_person));
    assert!(scene.way_m() < 0.01);
    assert!(scene.health().1.contains("kill -USR1"));
    scene.world.wheels()[1].faults().broken = false;
    assert!(scene.way_m() < 0.01, "nobody has looked yet");
    let (_, before_m) = scene.world.home().score();
    scene.wait("driving after SIGUSR1", |scene| {
        scene.signal(Signal::USR1);
        pause(500);
        scene.world.home().score().1 > before_m + 0.1
    });
    scene.signal(Signal::USR2);
    scene.state_is("disarmed");
    assert!(scene.way_m() < 0.05, "it brakes within centimetres");
    scene.ends_well();
}

#[test]
fn killed_in_the_middle_the_wheels_stand_and_the_recording_replays() {
    let mut scene = Scene::new(Protocol::Vesc);
    scene.drives("the first drive");
    scene.drives("some more");
    scene.signal(Signal::KILL);
    scene.robot.wait().unwrap();
    // The controllers' watchdogs: 100 ms, and the wheels' own lag.
    pause(400);
    assert!(scene.world.wheels().iter().all(|node| node.wheel().velocity_radps().abs() < 0.1));
    let (_, text) = replayed(&scene.folder.path().join("run"), &[]);
    assert!(text.contains("mismatches=0") && text.contains("truncated after tick"), "{text}");
    pause(3000);
    let (well, text) = scene.health();
    assert!(!well && text.contains("the program (pid"), "{text}");
}

/// The robot's models, as another process sees them.
struct Models {
    store: Store,
    /// Turns that were left out while nothing happened but this swap.
    left_out: Vec<u64>,
}

impl Models {
    /// Makes a change in the store, and waits until `digest` drives.
    fn swap(&mut self, scene: &Scene, digest: &str, change: impl FnOnce(&mut Store)) {
        let left_out = || scene.status().map_or(0, |status| status.exploration.skipped);
        let before = left_out();
        change(&mut self.store);
        scene.wait("another model", |scene| drives(scene).as_deref() == Some(digest));
        self.left_out.push(left_out() - before);
    }

    fn install(&mut self, scene: &Scene, name: &str) -> String {
        let model = std::fs::read(model(name)).unwrap();
        let digest = blake3::hash(&model).to_hex().to_string();
        self.swap(scene, &digest, |store| store.install(&model, "", name).unwrap());
        digest
    }

    fn state(&self) -> State {
        self.store.state().unwrap()
    }

    /// What became of the newest model.
    fn last(&self) -> What {
        self.store.history().entries.last().unwrap().what
    }
}

fn model(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/models/{name}.onnx"))
}

fn drives(scene: &Scene) -> Option<String> {
    scene.status()?.exploration.model
}

#[test]
fn models_are_swapped_while_it_drives_kept_or_taken_back_and_no_turn_is_left_out_for_it() {
    let more = "\n[models]\nstore = \"{}/models\"\ntrial_ticks = 20\ntrial_m = 0.1\n";
    let guess = model("guess");
    let mut scene = Scene::with(Protocol::Odrive, more, &["--model", guess.to_str().unwrap()]);
    scene.drives("the first drive");
    // The network that came with the program is the store's first.
    let mut models =
        Models { store: Store::open(&scene.path("models")).unwrap(), left_out: Vec::new() };
    let first = models.state().current().unwrap().to_owned();
    assert_eq!(first, blake3::hash(&std::fs::read(guess).unwrap()).to_hex().to_string());
    assert_eq!(drives(&scene).as_ref(), Some(&first));

    let better = models.install(&scene, "better");
    scene.wait("the trial's end", |_| models.last() == What::Kept);
    assert_eq!(
        models.state(),
        State { models: vec![better.clone(), first.clone()], trial_starts: None }
    );
    // An operator goes back and forth.
    for _ in 0..3 {
        models.swap(&scene, &first, |store| drop(store.roll_back("an operator").unwrap()));
        models.install(&scene, "better");
    }
    scene.wait("the trial's end", |_| models.last() == What::Kept);
    // One that misbehaves is taken back by the robot itself.
    let bad = std::fs::read(model("nan_in_the_dark")).unwrap();
    models.store.install(&bad, "", "nan_in_the_dark").unwrap();
    scene.wait("a rollback", |_| models.last() == What::RolledBack);
    let why = models.store.history().entries.last().unwrap().why.clone();
    assert!(why.contains("NaN"), "{why}");
    assert_eq!(models.state().current(), Some(&*better));
    scene.wait("the model before it", |scene| drives(scene).as_ref() == Some(&better));
    scene.drives("driving on");

    // Nobody promises that this computer does nothing else. A swap that waits for the disk or for the network to load would
    // cost turns every time.
    let without = models.left_out.iter().filter(|turns| **turns == 0).count();
    assert!(
        2 * without > models.left_out.len(),
        "turns left out at each swap: {:?}",
        models.left_out
    );
    println!("turns left out at each swap: {:?}", models.left_out);
    let store = scene.path("models");
    scene.ends_and_replays(&[Path::new("--model-store"), &store]);
}
