//! The gate as a user runs it: every bad model is refused with its reason, a better one drives, and what misbehaves is taken back.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot set up its scene has failed")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use firmware_host::model::{State, Store, What};
use serde_json::Value;
use tempfile::TempDir;

const CONFIG: &str = "\
[camera]\nwidth = 160\nheight = 64\n\
[models]\nmax_p99_ms = 1000\ngate_timeout_s = 120\ngate_memory_mib = 4096\ntrial_turns = 60\ntrial_m = 0.2\n";

fn binary() -> PathBuf {
    assert_cmd::cargo::cargo_bin!("firmware-host").to_owned()
}

fn run(args: &[&str]) -> Output {
    Command::new(binary()).args(args).env("RUST_LOG", "error").output().unwrap()
}

fn model_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/models/{name}.onnx"))
}

/// What the robot has seen, once for all tests of this process.
fn recordings() -> &'static Path {
    static RECORDED: OnceLock<TempDir> = OnceLock::new();
    RECORDED
        .get_or_init(|| {
            let dir = TempDir::new().unwrap();
            let config = dir.path().join("robot.toml");
            std::fs::write(&config, CONFIG).unwrap();
            let out = dir.path().join("run");
            let mut args =
                vec!["explore", "--scene", "builtin:apartment?seed=1", "--policy", "frontier", "--frames", "1500"];
            args.extend(["--config", config.to_str().unwrap(), "--out", out.to_str().unwrap()]);
            let explored = run(&args);
            assert!(explored.status.success(), "{}", String::from_utf8_lossy(&explored.stderr));
            dir
        })
        .path()
}

/// A robot's folder with keys, configuration and store.
struct Robot {
    dir: TempDir,
    config: String,
}

impl Robot {
    fn new() -> Self {
        Self::with(CONFIG)
    }

    fn with(config: &str) -> Self {
        let robot = Self { dir: TempDir::new().unwrap(), config: config.to_owned() };
        let line = bundle::generate_keys(&robot.path("key"), None, "workshop").unwrap();
        std::fs::write(robot.path("trusted_keys"), line).unwrap();
        std::fs::write(robot.path("robot.toml"), &robot.config).unwrap();
        robot
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn store(&self) -> Store {
        Store::open(&self.path("store")).unwrap()
    }

    fn state(&self) -> State {
        self.store().state().unwrap()
    }

    /// Signs a model's bytes under this name.
    fn sign(&self, bytes: &[u8], name: &str) -> PathBuf {
        let path = self.path(&format!("{name}.onnx"));
        std::fs::write(&path, bytes).unwrap();
        let key = bundle::read_secret_key(&self.path("key"), || panic!("no password")).unwrap();
        std::fs::write(bundle::Bundle::signature_path(&path), bundle::sign(bytes, name, &key).unwrap()).unwrap();
        path
    }

    fn signed(&self, name: &str) -> PathBuf {
        self.sign(&std::fs::read(model_file(name)).unwrap(), name)
    }

    /// `model install`: whether it was accepted, and what was said.
    fn install(&self, bundle: &Path, more: &[&str]) -> Value {
        let (config, store, keys) = (self.text("robot.toml"), self.text("store"), self.text("trusted_keys"));
        let mut args = vec!["model", "install", bundle.to_str().unwrap(), "--json", "--config", &config];
        // Idle time is scarce on a computer that runs tests.
        args.extend(["--store", &store, "--trusted-keys", &keys, "--normal-priority"]);
        args.extend(more);
        let output = run(&args);
        let said: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| {
            panic!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
        });
        assert_eq!(output.status.success(), said["accepted"] == true);
        said
    }

    /// Installs a model without asking the gate, and takes its trial for done.
    fn has(&self, name: &str) -> String {
        let bytes = std::fs::read(model_file(name)).unwrap();
        let digest = blake3::hash(&bytes).to_hex().to_string();
        let mut store = self.store();
        store.install(&bytes, "", name).unwrap();
        store.keep(&digest, "for the test").unwrap();
        digest
    }

    fn judged_by_recordings(&self, name: &str) -> Value {
        self.install(&self.signed(name), &["--recordings", recordings().to_str().unwrap(), "--frames", "120"])
    }

    /// Drives with the store; the summary.
    fn explore(&self, name: &str, frames: &str, more: &[&str]) -> Value {
        let (config, store, out) = (self.text("robot.toml"), self.text("store"), self.text(name));
        let mut args = vec!["explore", "--frames", frames, "--seed", "2", "--config", &config, "--out", &out];
        args.extend(["--model-store", &store]);
        args.extend(if more.is_empty() { &["--scene", "builtin:apartment?seed=1"][..] } else { more });
        let output = run(&args);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&std::fs::read(self.path(name).join("summary.json")).unwrap()).unwrap()
    }
}

#[test]
fn every_bad_model_is_refused_with_its_reason_and_none_is_accepted() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let refused = |name: &str, kind: &str, words: &[&str]| {
        let said = robot.install(&robot.signed(name), &[]);
        assert_eq!((said["accepted"].as_bool(), said["kind"].as_str()), (Some(false), Some(kind)), "{name}: {said}");
        let why = said["why"].as_str().unwrap();
        words.iter().for_each(|word| assert!(why.contains(word), "{name}: {why}"));
        assert_eq!(robot.state().current(), Some(&*guess), "{name}");
    };
    refused("wrong_shape", "network", &["80x32", "160x64"]);
    refused("wrong_opset", "file", &["opset 9", "opset 17"]);
    refused("external_data", "file", &["`bias`", "another file"]);
    refused("no_golden_pair", "golden_pair", &["no golden pair"]);
    refused("lying_golden_pair", "golden_pair", &["off by 0.05"]);
    // Without recordings nothing is shown to be as good.
    refused("better", "judged", &["only 0 held-out pictures"]);
    let history = robot.store().history();
    assert_eq!(history.entries.iter().filter(|entry| entry.what == What::Refused).count(), 6);
}

#[test]
fn a_model_that_is_slower_than_the_budget_is_refused_with_both_numbers() {
    let robot = Robot::with(&CONFIG.replace("max_p99_ms = 1000", "max_p99_ms = 20"));
    let said = robot.install(&robot.signed("slow"), &["--unproven"]);
    let why = said["why"].as_str().unwrap();
    assert!(said["kind"] == "judged" && why.contains("too slow") && why.contains("allowed: 20.0 ms"), "{why}");
    assert_eq!(robot.state(), State::default());
}

#[test]
fn a_model_that_takes_all_memory_ends_its_own_process_and_nothing_else() {
    let robot = Robot::new();
    let said = robot.install(&robot.signed("huge_allocation"), &["--unproven"]);
    assert_eq!(said["accepted"], false);
    // ONNX Runtime reports it, or the process ends.
    assert!(["network", "died"].contains(&said["kind"].as_str().unwrap()), "{said}");
    assert_eq!(robot.state(), State::default());
}

#[test]
fn a_model_that_never_ends_is_ended() {
    let robot = Robot::with(&CONFIG.replace("gate_timeout_s = 120", "gate_timeout_s = 5"));
    let said = robot.install(&robot.signed("endless_loop"), &["--unproven"]);
    assert_eq!((said["accepted"].as_bool(), said["kind"].as_str()), (Some(false), Some("died")), "{said}");
    let why = said["why"].as_str().unwrap();
    assert!(why.contains("grey picture") && why.contains("5 s"), "{why}");
}

#[test]
fn what_is_not_signed_by_a_trusted_key_is_not_even_read() {
    let (robot, stranger) = (Robot::new(), Robot::new());
    let kind = |bundle: &Path| {
        let said = robot.install(bundle, &["--unproven"]);
        assert_eq!((said["accepted"].as_bool(), said["kind"].as_str()), (Some(false), Some("signature")), "{said}");
        said["why"].as_str().unwrap().to_owned()
    };
    let unsigned = robot.path("unsigned.onnx");
    std::fs::copy(model_file("guess"), &unsigned).unwrap();
    assert!(kind(&unsigned).contains("not signed"));
    assert!(kind(&stranger.signed("guess")).contains("not trusted"));
    // One character of the metadata.
    let path = robot.signed("guess");
    let bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(5).rposition(|window| window == b"guess").unwrap();
    let mut tampered = bytes.clone();
    tampered[at] = b'G';
    std::fs::write(&path, &tampered).unwrap();
    assert!(kind(&path).contains("does not fit"));
    for length in [0, 1, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(kind(&path).contains("does not fit"), "{length}");
    }
    // Signed, but not whole.
    let cut = robot.sign(&bytes[..bytes.len() - 40], "cut");
    let said = robot.install(&cut, &["--unproven"]);
    assert!(["file", "network", "golden_pair"].contains(&said["kind"].as_str().unwrap()), "{said}");
    assert_eq!(robot.state(), State::default());
}

#[test]
fn a_better_model_is_accepted_a_worse_one_and_one_with_nan_are_not() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let worse = robot.judged_by_recordings("worse");
    assert_eq!((worse["accepted"].as_bool(), worse["kind"].as_str()), (Some(false), Some("judged")), "{worse}");
    assert!(worse["why"].as_str().unwrap().contains("worse than the resident model"), "{worse}");
    let nan = robot.judged_by_recordings("nan_in_the_dark");
    assert!(nan["why"].as_str().unwrap().contains("NaN"), "{nan}");
    assert_eq!(robot.state().current(), Some(&*guess));
    let robot = Robot::new();
    let worse = robot.has("worse");
    let better = robot.judged_by_recordings("better");
    assert_eq!(better["accepted"], true, "{better}");
    let state = robot.state();
    assert_eq!((state.models.len(), state.previous(), state.trial_starts), (2, Some(&*worse), Some(0)));
    // Now it is what others are judged by.
    let mut store = robot.store();
    let current = state.current().unwrap().to_owned();
    store.keep(&current, "for the test").unwrap();
    let back = robot.judged_by_recordings("worse");
    assert_eq!(back["kind"], "judged", "{back}");
    assert_eq!(robot.judged_by_recordings("better")["kind"], "current");
}

#[test]
fn a_model_that_behaves_is_kept_and_its_run_replays_exactly_with_the_store() {
    let robot = Robot::new();
    robot.has("guess");
    let bytes = std::fs::read(model_file("better")).unwrap();
    robot.store().install(&bytes, "", "better").unwrap();
    robot.explore("run", "150", &[]);
    let state = robot.state();
    assert_eq!((state.trial_starts, state.models.len()), (None, 2));
    assert_eq!(robot.store().history().entries.last().unwrap().what, What::Kept);
    let (out, store) = (robot.text("run"), robot.text("store"));
    let replayed = run(&["replay", &out, "--model-store", &store]);
    let said = String::from_utf8_lossy(&replayed.stdout).into_owned();
    assert!(replayed.status.success() && said.contains("replay: ticks=150 mismatches=0"), "{said}");
    let refused = run(&["replay", &out]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--model-store"));
}

#[test]
fn a_model_that_passes_the_gate_and_then_misbehaves_is_rolled_back_within_its_trial() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    // Held-out pictures without dark corners would let it pass; here the operator's word does.
    let mut store = robot.store();
    let bytes = std::fs::read(model_file("nan_in_the_dark")).unwrap();
    store.install(&bytes, "", "nan_in_the_dark").unwrap();
    robot.explore("run", "60", &[]);
    assert_eq!(robot.state(), State { models: vec![guess.clone()], trial_starts: None });
    let history = store.history();
    let last = history.entries.last().unwrap();
    assert!(last.what == What::RolledBack && last.why.contains("NaN"), "{last:?}");
    // The run replays, the change back to the resident model included: the store must still have the other one.
    let again = robot.install(&robot.signed("nan_in_the_dark"), &["--unproven"]);
    assert_eq!(again["kind"], "rolled_back_before", "{again}");
}

#[test]
fn a_first_model_that_misbehaves_leaves_coarse_depth() {
    let robot = Robot::new();
    let said = robot.install(&robot.signed("nan_in_the_dark"), &["--unproven"]);
    assert_eq!(said["accepted"], true, "{said}");
    robot.explore("run", "60", &[]);
    assert_eq!(robot.state(), State::default());
}

#[test]
fn rollback_works_while_the_new_model_is_damaged_on_the_disk() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let better = robot.has("better");
    std::fs::write(robot.store().model_path(&better), b"rot").unwrap();
    let store = robot.text("store");
    let output = run(&["model", "rollback", "--store", &store]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(robot.state().current(), Some(&*guess));
    // A robot that finds it damaged goes back by itself.
    let worse = robot.has("worse");
    std::fs::write(robot.store().model_path(&worse), b"rot").unwrap();
    robot.explore("run", "5", &[]);
    assert_eq!(robot.state().current(), Some(&*guess));
}

#[test]
fn a_kill_at_any_moment_of_an_install_leaves_a_store_that_can_be_used() {
    let robot = Robot::new();
    let bundle = robot.signed("better");
    let (config, store, keys) = (robot.text("robot.toml"), robot.text("store"), robot.text("trusted_keys"));
    let (mut before, mut after) = (0, 0);
    let mut wait_us = 20_000;
    for round in 0..60_u64 {
        let mut child = Command::new(binary())
            .args(["model", "install", bundle.to_str().unwrap(), "--json", "--config", &config, "--store", &store])
            .args(["--trusted-keys", &keys, "--normal-priority", "--unproven"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // Real time: the moments in which the kernel lets the process be are what is wanted.
        let pause = rustix::time::Timespec { tv_sec: wait_us / 1_000_000, tv_nsec: wait_us % 1_000_000 * 1000 };
        let _ = rustix::thread::nanosleep(&pause);
        let _ = child.kill();
        child.wait().unwrap();
        let mut store = robot.store();
        let state = store.state().unwrap();
        state.models.iter().for_each(|digest| drop(store.read_model(digest).unwrap()));
        if state.current().is_none() {
            before += 1;
            // Later and later, until it is done before.
            wait_us += wait_us / 8 + (round as i64 * 7919 % 1000);
        } else {
            after += 1;
            store.roll_back("for the next round").unwrap();
            std::fs::remove_file(robot.path("store/history.json")).unwrap();
            wait_us = wait_us * 3 / 4;
        }
    }
    assert!(before > 5 && after > 0, "{before} {after}");
}
