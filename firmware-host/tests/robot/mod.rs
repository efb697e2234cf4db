//! A robot's folder with keys, configuration and models.
#![allow(
    dead_code,
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests; not all use all"
)]

use std::fs::File;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use firmware_host::model::{State, Store};
use serde_json::Value;
use tempfile::TempDir;

/// The camera is level: the models that these tests judge become blind around the middle row of the image, where a level camera has
/// the horizon. Its goals are near frontiers: it enters rooms which the default looks into from their doors, so that its recordings show more
/// places than the 8 to 12 of the default.
pub const CONFIG: &str = "\
[camera]\nwidth = 160\nheight = 64\npitch_down_deg = 0.0\n\
[map]\ndrop_range_m = 4.0\n\
[exploration]\ngoal_choice = \"nearest\"\n\
[models]\nmax_p99_ms = 1000\ngate_timeout_s = 120\ngate_memory_mib = 4096\ntrial_ticks = 60\ntrial_m = 0.2\n";

/// The homes of the drives that models are judged by. One drive shows 8 to 12 places, which are sometimes too few to show that a model is as
/// good as another one.
const HOMES: [&str; 2] = ["builtin:house?seed=1", "builtin:house?seed=2"];
const DRIVE: [&str; 6] = ["--policy", "frontier", "--frames", "4500", "--seed", "4"];

pub fn binary() -> PathBuf {
    assert_cmd::cargo::cargo_bin!("firmware-host").to_owned()
}

pub fn run(args: &[&str]) -> Output {
    Command::new(binary()).args(args).env("RUST_LOG", "error").output().unwrap()
}

pub fn model_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/models/{name}.onnx"))
}

/// Holds a lock of the folder until it is dropped.
fn lock(folder: &Path) -> File {
    let file = File::create(folder.join("lock")).unwrap();
    file.lock().unwrap();
    file
}

fn remove_folders_in(folder: &Path) {
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        if entry.file_type().unwrap().is_dir() {
            std::fs::remove_dir_all(entry.path()).unwrap();
        }
    }
}

/// A robot's folder with keys, configuration and store.
pub struct Robot {
    pub dir: TempDir,
    config: String,
}

impl Robot {
    pub fn new() -> Self {
        Self::with(CONFIG)
    }

    pub fn with(config: &str) -> Self {
        let robot = Self { dir: TempDir::new().unwrap(), config: config.to_owned() };
        let line = signed_model::generate_keys(&robot.path("key"), None, "workshop").unwrap();
        std::fs::write(robot.path("trusted_keys"), line).unwrap();
        let keys = format!("[models]\ntrusted_keys = {:?}\n", robot.text("trusted_keys"));
        let config = robot.config.replace("[models]\n", &keys);
        std::fs::write(robot.path("robot.toml"), config).unwrap();
        robot
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    pub fn store(&self) -> Store {
        Store::open(&self.path("store")).unwrap()
    }

    pub fn state(&self) -> State {
        self.store().state().unwrap()
    }

    /// Signs a model's bytes under this name.
    pub fn sign(&self, bytes: &[u8], name: &str) -> PathBuf {
        let path = self.path(&format!("{name}.onnx"));
        std::fs::write(&path, bytes).unwrap();
        let key =
            signed_model::read_secret_key(&self.path("key"), || panic!("no password")).unwrap();
        std::fs::write(
            signed_model::Bundle::signature_path(&path),
            signed_model::sign(bytes, name, &key).unwrap(),
        )
        .unwrap();
        path
    }

    pub fn signed(&self, name: &str) -> PathBuf {
        self.sign(&std::fs::read(model_file(name)).unwrap(), name)
    }

    /// `model install`: whether it was accepted, and what was said.
    pub fn install(&self, bundle: &Path, more: &[&str]) -> Value {
        let (config, store, keys) =
            (self.text("robot.toml"), self.text("store"), self.text("trusted_keys"));
        let mut args =
            vec!["model", "install", bundle.to_str().unwrap(), "--json", "--config", &config];
        // Idle time is scarce on a computer that runs tests.
        args.extend(["--store", &store, "--trusted-keys", &keys, "--normal-priority"]);
        args.extend(more);
        let output = run(&args);
        let said: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| {
            panic!(
                "{}{}",
                String::from_utf8_lossy(&output.stdout),
                String::from_utf8_lossy(&output.stderr)
            )
        });
        assert_eq!(output.status.success(), said["accepted"] == true);
        said
    }

    /// Signs a model and puts it into the store without asking the gate.
    pub fn put(&self, bytes: &[u8], name: &str) {
        let key =
            signed_model::read_secret_key(&self.path("key"), || panic!("no password")).unwrap();
        let signature = signed_model::sign(bytes, name, &key).unwrap();
        self.store().install(bytes, &signature, name).unwrap();
    }

    /// Installs a model without asking the gate, and takes its trial for done.
    pub fn has(&self, name: &str) -> String {
        let bytes = std::fs::read(model_file(name)).unwrap();
        let digest = blake3::hash(&bytes).to_hex().to_string();
        let mut store = self.store();
        self.put(&bytes, name);
        store.keep(&digest, "for the test").unwrap();
        digest
    }

    /// What the robot has seen in two homes. Robots of one configuration share these drives, which take a minute: the first
    /// that needs them makes them, and the other tests of this build wait for them.
    pub fn recordings(&self) -> String {
        let all = Path::new(env!("CARGO_TARGET_TMPDIR")).join("drives");
        std::fs::create_dir_all(&all).unwrap();
        let _only_one_drives = lock(&all);
        let drive = all.join(format!("{:016x}", self.build_and_configuration()));
        if !drive.exists() {
            remove_folders_in(&all);
            let unfinished = all.join("unfinished");
            let config = self.text("robot.toml");
            for (number, home) in HOMES.iter().enumerate() {
                let out = unfinished.join(format!("run_{number}"));
                let mut args = vec!["explore", "--config", &config, "--scene", *home];
                args.extend(DRIVE);
                args.extend(["--out", out.to_str().unwrap()]);
                let explored = run(&args);
                assert!(explored.status.success(), "{}", String::from_utf8_lossy(&explored.stderr));
            }
            std::fs::rename(unfinished, &drive).unwrap();
        }
        drive.to_str().unwrap().to_owned()
    }

    /// A number that differs for another build of the program, another drive and another configuration.
    fn build_and_configuration(&self) -> u64 {
        let program = std::fs::metadata(binary()).unwrap();
        let mut hasher = DefaultHasher::new();
        (program.modified().unwrap(), program.len(), HOMES, DRIVE, &self.config).hash(&mut hasher);
        hasher.finish()
    }

    pub fn judged_by_recordings(&self, name: &str) -> Value {
        self.install(&self.signed(name), &["--recordings", &self.recordings(), "--frames", "120"])
    }

    /// Drives with the store; the summary.
    pub fn explore(&self, name: &str, frames: &str, more: &[&str]) -> Value {
        let (config, store, out) = (self.text("robot.toml"), self.text("store"), self.text(name));
        let mut args =
            vec!["explore", "--frames", frames, "--seed", "2", "--config", &config, "--out", &out];
        args.extend(["--model-store", &store]);
        args.extend(if more.is_empty() {
            &["--scene", "builtin:apartment?seed=1"][..]
        } else {
            more
        });
        let output = run(&args);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&std::fs::read(self.path(name).join("summary.json")).unwrap())
            .unwrap()
    }
}
