//! A rollout over a real ssh server to three robots with the real program: its gate judges the model, a simulated drive ends the
//! trial of the canary, and a rollback in the next ring halts the rollout.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its programs has failed"
)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use hil::sshd::Sshd;
use serde_json::Value;
use tempfile::{TempDir, tempdir};

/// As in `firmware-host/tests/robot/mod.rs`, with a short trial.
const CONFIG: &str = "\
[camera]\nwidth = 160\nheight = 64\npitch_down_deg = 0.0\n\
[map]\ndrop_range_m = 4.0\n\
[models]\nmax_p99_ms = 1000\ngate_timeout_s = 120\ngate_memory_mib = 4096\ntrial_ticks = 20\ntrial_m = 0.1\n";

/// The robot's program, which is in the same directory as `push-model`.
fn firmware_host() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_push-model")).with_file_name("firmware-host");
    assert!(program.is_file(), "build it first: cargo build -p firmware-host");
    program
}

fn succeeded(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Three robots behind an ssh server, and a signed model on a workstation.
struct Scene {
    dir: TempDir,
    sshd: Sshd,
    library: String,
}

impl Scene {
    /// Tests that call this are ignored without sshd and ONNX Runtime.
    fn new() -> Self {
        let library = std::env::var("ORT_DYLIB_PATH").expect("ORT_DYLIB_PATH is not set");
        let dir = tempdir().unwrap();
        let sshd = Sshd::start(&dir.path().join("ssh")).unwrap().expect("sshd cannot run here");
        let scene = Self { dir, sshd, library };
        let mut push = Command::new(env!("CARGO_BIN_EXE_push-model"));
        let key = succeeded(push.args(["keygen", "--no-password"]).arg(scene.path("key")));
        std::fs::write(scene.path("trusted_keys"), key).unwrap();
        let keys = format!("[models]\ntrusted_keys = {:?}\n", scene.path("trusted_keys"));
        std::fs::write(scene.path("robot.toml"), CONFIG.replace("[models]\n", &keys)).unwrap();
        let model = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../firmware-host/tests/models/better.onnx");
        std::fs::copy(model, scene.path("better.onnx")).unwrap();
        let mut fleet = "[rollout]\nrings_percent = [50, 100]\n".to_owned();
        for name in ["canary", "hall", "attic"] {
            let target = format!("127.0.0.1:{}", scene.path(name).display());
            let is_canary = name == "canary";
            fleet +=
                &format!("[[robot]]\nname = {name:?}\ntarget = {target:?}\ncanary = {is_canary}\n");
        }
        std::fs::write(scene.path("fleet.toml"), fleet).unwrap();
        scene
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// One pass of the rollout.
    fn push(&self) -> Output {
        let firmware = format!("env ORT_DYLIB_PATH={} {}", self.library, firmware_host().display());
        let mut push = Command::new(env!("CARGO_BIN_EXE_push-model"));
        push.arg(self.path("better.onnx")).arg("--key").arg(self.path("key")).arg("--json");
        push.arg("--fleet").arg(self.path("fleet.toml")).arg("--program").arg(firmware);
        push.args(self.sshd.options().iter().map(|option| format!("--ssh={option}")));
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
    succeeded(drive.arg("--out").arg(scene.path("drive")));
    let (_, status) = scene.pass(0);
    assert_eq!(status["robots"][0]["verdict"], "kept", "{status}");
    assert!(status["robots"][0]["reason"].as_str().unwrap().starts_with("kept after"), "{status}");
    let robots = status["robots"].as_array().unwrap();
    let second = robots.iter().find(|robot| robot["verdict"] == "on_trial").unwrap();
    let name = second["name"].as_str().unwrap();
    let mut rollback = scene.robot(&["model", "rollback", "--why", "it drove against the door"]);
    succeeded(rollback.arg("--store").arg(scene.path(name)));
    let (mut verdicts, status) = scene.pass(1);
    verdicts.sort();
    assert_eq!(verdicts, ["kept", "rolled_back", "waiting"], "{status}");
    let why = status["halted"]["why"].as_str().unwrap();
    assert!(why.contains(name) && why.contains("it drove against the door"), "{why}");
    let third = if name == "hall" { "attic" } else { "hall" };
    assert!(!scene.path(third).exists(), "the third robot was sent nothing");
}
