//! Kills `push-model` at random times while it sends a model over real ssh: the robot then has either the old or the new model.
//! The environment variable `KILLS` sets the number of kills.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its programs has failed"
)]

mod over_ssh;

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use hil::kills::{self, KillSchedule};
use over_ssh::{Site, firmware_host, model, push_model, stdout_of};
use serde_json::Value;

/// The robot's side must end within this time after `push-model` was killed.
const END_TIMEOUT: Duration = Duration::from_secs(60);

/// Enlarges a model beyond the capacity of all pipes, so that most pushes are killed before they have sent it: appends
/// ModelProto's `doc_string`, field 6, with 2^23 spaces.
fn padded(mut model: Vec<u8>) -> Vec<u8> {
    model.extend([0x32, 0x80, 0x80, 0x80, 0x04]);
    model.resize(model.len() + (1 << 23), b' ');
    model
}

/// Whether the command line of a running process contains `text`.
fn is_any_process_using(text: &str) -> bool {
    std::fs::read_dir("/proc")
        .unwrap()
        .flatten()
        .filter_map(|entry| std::fs::read(entry.path().join("cmdline")).ok())
        .any(|line| String::from_utf8_lossy(&line).contains(text))
}

/// A robot behind an ssh server, and signed models on a workstation.
struct Scene(Site);

impl Scene {
    /// Starts the ssh server and signs two models.
    fn new() -> Self {
        let scene = Self(Site::new());
        let limits = "[camera]\nwidth = 160\nheight = 64\n[models]\nmax_p99_ms = 1000\n";
        std::fs::write(scene.path("robot.toml"), limits).unwrap();
        for name in ["guess", "better"] {
            let path = scene.path(&format!("{name}.onnx"));
            std::fs::write(&path, padded(std::fs::read(model(name)).unwrap())).unwrap();
            stdout_of(push_model().arg("sign").arg(path).arg("--key").arg(scene.path("key")));
        }
        scene
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path(name)
    }

    fn push(&self, name: &str) -> Child {
        let mut push = self.0.push();
        push.arg(self.path(name)).arg(self.0.target("store"));
        for (flag, file) in [("--config", "robot.toml"), ("--trusted-keys", "trusted_keys")] {
            push.arg(format!("--gate={flag}={}", self.path(file).display()));
        }
        for flag in ["--unproven", "--again", "--normal-priority"] {
            push.arg(format!("--gate={flag}"));
        }
        push.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    }

    /// The JSON output of `firmware-host model`.
    fn model(&self, words: &[&str]) -> Value {
        let mut command = Command::new(firmware_host());
        command.arg("model").args(words).arg("--json").arg("--store").arg(self.path("store"));
        serde_json::from_str(&stdout_of(command.arg("--config").arg(self.path("robot.toml"))))
            .unwrap()
    }

    /// Waits until the robot's side of a killed push has ended. Returns the state of the store.
    fn settled(&self) -> Value {
        let began = Instant::now();
        let store = self.path("store").display().to_string();
        while is_any_process_using(&store) {
            assert!(began.elapsed() < END_TIMEOUT, "the robot's side did not end");
            std::thread::yield_now();
        }
        let list = self.model(&["list"]);
        assert!(list["problem"].is_null() && list["history"].is_array(), "{list}");
        for digest in list["state"]["models"].as_array().unwrap() {
            let digest = digest.as_str().unwrap();
            let model =
                std::fs::read(self.path("store/models").join(format!("{digest}.onnx"))).unwrap();
            assert_eq!(blake3::hash(&model).to_hex().as_str(), digest);
        }
        list["state"].clone()
    }

    /// Both models are on trial, so a rollback leads to no model at all.
    fn begin_again(&self, old: &Value) {
        self.model(&["rollback"]);
        assert!(self.push("guess.onnx").wait().unwrap().success());
        assert_eq!(self.settled(), *old);
    }
}

#[test]
#[cfg_attr(
    not(all(has_sshd, has_onnx_runtime)),
    ignore = "needs /usr/sbin/sshd and ORT_DYLIB_PATH, which `cargo xtask test` sets"
)]
fn a_push_killed_at_any_moment_leaves_the_old_model_or_the_new_one() {
    let scene = Scene::new();
    assert!(scene.push("guess.onnx").wait().unwrap().success());
    let old = scene.settled();
    let began = Instant::now();
    assert!(scene.push("better.onnx").wait().unwrap().success());
    let mut moments = KillSchedule::new(3, began.elapsed());
    let new = scene.settled();
    assert_ne!(old, new);
    scene.begin_again(&old);
    let mut kills = 0;
    let mut tries = 0;
    let mut arrived = 0;
    while kills < kills::kill_count() {
        tries += 1;
        assert!(tries <= 50 + 4 * kills::kill_count(), "the pushes end before they can be killed");
        let mut child = scene.push("better.onnx");
        moments.wait(&mut child, || kills::listing(&scene.path("store"))).unwrap();
        kills += u64::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        let state = scene.settled();
        assert!(state == old || state == new, "{state}");
        if state == new {
            arrived += 1;
            scene.begin_again(&old);
        }
    }
    println!("{kills} kills in {tries} pushes, {arrived} models arrived nevertheless");
}
