//! A rollout over a real ssh server to three robots with the real program: its gate judges the model, a simulated drive ends the
//! trial of the canary, and a rollback in the next ring halts the rollout.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its programs has failed"
)]

mod over_ssh;

use std::path::PathBuf;
use std::process::{Command, Output};

use over_ssh::{Site, firmware_host, model, stdout_of};
use serde_json::Value;

/// As in `firmware-host/tests/robot/mod.rs`, with a short trial.
const CONFIG: &str = "\
[camera]\nwidth = 160\nheight = 64\npitch_down_deg = 0.0\n\
[map]\ndrop_range_m = 4.0\n\
[models]\nmax_p99_ms = 1000\ngate_timeout_s = 120\ngate_memory_mib = 4096\ntrial_ticks = 20\ntrial_m = 0.1\n";

/// Three robots behind an ssh server, and a model on a workstation.
struct Scene(Site);

impl Scene {
    fn new() -> Self {
        let scene = Self(Site::new());
        let keys = format!("[models]\ntrusted_keys = {:?}\n", scene.path("trusted_keys"));
        std::fs::write(scene.path("robot.toml"), CONFIG.replace("[models]\n", &keys)).unwrap();
        std::fs::copy(model("better"), scene.path("better.onnx")).unwrap();
        let mut fleet = "[rollout]\nrings_percent = [50, 100]\n".to_owned();
        for name in ["canary", "hall", "attic"] {
            let target = scene.0.target(name);
            let is_canary = name == "canary";
            fleet +=
                &format!("[[robot]]\nname = {name:?}\ntarget = {target:?}\ncanary = {is_canary}\n");
        }
        std::fs::write(scene.path("fleet.toml"), fleet).unwrap();
        scene
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path(name)
    }

    /// One pass of the rollout.
    fn push(&self) -> Output {
        let mut push = self.0.push();
        push.arg(self.path("better.onnx")).arg("--key").arg(self.path("key")).arg("--json");
        push.arg("--fleet").arg(self.path("fleet.toml"));
        push.arg(format!("--gate=--config={}", self.path("robot.toml").display()));
        push.args(["--gate=--unproven", "--gate=--normal-priority"]).output().unwrap()
    }

    /// Makes a pass, which ends with this exit code. Returns the verdicts of the robots and the whole status.
    #[track_caller]
    fn pass(&self, code: i32) -> (Vec<String>, Value) {
        let output = self.push();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{errors}");
        let status: Value = serde_json::from_slice(&output.stdout).unwrap();
        let robots = status["robots"].as_array().unwrap();
        let verdicts = robots.iter().map(|robot| robot["verdict"].as_str().unwrap().to_owned());
        (verdicts.collect(), status)
    }

    fn robot(&self, words: &[&str]) -> Command {
        let mut command = Command::new(firmware_host());
        command.args(words).arg("--config").arg(self.path("robot.toml"));
        command
    }
}

#[test]
#[cfg_attr(
    not(all(has_sshd, has_onnx_runtime)),
    ignore = "needs /usr/sbin/sshd and ORT_DYLIB_PATH, which `cargo xtask test` sets"
)]
fn real_robots_judge_the_model_and_a_rollback_after_the_canary_halts_the_rollout() {
    let scene = Scene::new();
    let (verdicts, status) = scene.pass(0);
    assert_eq!(verdicts, ["on_trial", "waiting", "waiting"], "{status}");
    let mut drive = scene.robot(&["explore", "--scene", "builtin:apartment?seed=1"]);
    drive.args(["--frames", "80", "--seed", "2", "--model-store"]).arg(scene.path("canary"));
    stdout_of(drive.arg("--out").arg(scene.path("drive")));
    let (_, status) = scene.pass(0);
    assert_eq!(status["robots"][0]["verdict"], "kept", "{status}");
    assert!(status["robots"][0]["reason"].as_str().unwrap().starts_with("kept after"), "{status}");
    let robots = status["robots"].as_array().unwrap();
    let second = robots.iter().find(|robot| robot["verdict"] == "on_trial").unwrap();
    let name = second["name"].as_str().unwrap();
    let mut rollback = scene.robot(&["model", "rollback", "--why", "it drove against the door"]);
    stdout_of(rollback.arg("--store").arg(scene.path(name)));
    let (mut verdicts, status) = scene.pass(1);
    verdicts.sort();
    assert_eq!(verdicts, ["kept", "rolled_back", "waiting"], "{status}");
    let why = status["halted"]["why"].as_str().unwrap();
    assert!(why.contains(name) && why.contains("it drove against the door"), "{why}");
    let third = if name == "hall" { "attic" } else { "hall" };
    assert!(!scene.path(third).exists(), "the third robot was sent nothing");
}
