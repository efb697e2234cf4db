//! A robot with recordings behind an ssh server on loopback.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests; not all use all"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use hil::noise;
use hil::sshd::Sshd;
use tempfile::{TempDir, tempdir};

/// An ssh server on loopback.
pub struct Server {
    pub sshd: Sshd,
    /// Its keys.
    _dir: TempDir,
}

impl Server {
    /// `None` where there is no sshd, or it may not run here.
    pub fn start() -> Option<Self> {
        let dir = tempdir().unwrap();
        Some(Self { sshd: Sshd::start(dir.path()).unwrap()?, _dir: dir })
    }

    pub fn pull(&self, robot: &Path, here: &Path) -> Command {
        self.pull_with(&serving(), robot, here)
    }

    pub fn pull_with(&self, remote_command: &Path, robot: &Path, here: &Path) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pull-buffer"));
        command
            .arg(format!("robot=127.0.0.1:{}", robot.display()))
            .arg(here)
            .arg(format!("--remote-command={}", remote_command.display()))
            .args(self.sshd.options().iter().map(|option| format!("--ssh-option={option}")))
            .stdin(Stdio::null());
        command
    }
}

/// Serves as `firmware-host buffer serve` does: this package's example, which stands beside its binary.
pub fn serving() -> PathBuf {
    let path = Path::new(env!("CARGO_BIN_EXE_pull-buffer")).with_file_name("examples").join("serve");
    assert!(path.exists(), "{} is missing: cargo build -p pull-buffer --examples", path.display());
    path
}

/// Segments without sense: nothing on the way looks into them.
pub fn robot(segments: u64, bytes: usize) -> TempDir {
    let dir = tempdir().unwrap();
    fs::create_dir(dir.path().join("run")).unwrap();
    for number in 0..segments {
        let path = dir.path().join(format!("run/recording_{number:04}.mcap"));
        fs::write(&path, noise(number + 1, bytes + number as usize)).unwrap();
        // Nobody writes to it any more.
        fs::File::open(&path).unwrap().set_modified(std::time::UNIX_EPOCH).unwrap();
    }
    dir
}

pub fn assert_same(robot: &Path, here: &Path, segments: u64) {
    for number in 0..segments {
        let file = format!("run/recording_{number:04}.mcap");
        assert!(fs::read(robot.join(&file)).unwrap() == fs::read(here.join("robot").join(&file)).unwrap(), "{file}");
    }
}

pub fn words(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
