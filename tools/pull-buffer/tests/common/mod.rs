//! A robot behind an ssh server on loopback.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers, not all of which every test file uses"
)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use hil::noise;
use hil::sshd::Sshd;
use tempfile::{TempDir, tempdir};

/// Removes the markers that say which of the robot's segments were pulled.
pub fn unmark(robot: &Path, segments: u64) {
    for number in 0..segments {
        let _ = fs::remove_file(robot.join(format!("run/recording_{number:04}.mcap.pulled")));
    }
}

/// An ssh server on loopback.
pub struct Server {
    pub sshd: Sshd,
    /// Contains the server's keys and configuration.
    _dir: TempDir,
}

impl Server {
    /// Starts the server. Tests that call this are ignored where sshd is not installed.
    pub fn start() -> Self {
        let dir = tempdir().unwrap();
        let sshd = Sshd::start(dir.path()).unwrap().expect("sshd is missing or cannot run here");
        Self { sshd, _dir: dir }
    }

    /// The number of logins.
    pub fn logins(&self) -> usize {
        let log = fs::read_to_string(self.sshd.dir().join("sshd.log")).unwrap();
        log.matches("Accepted publickey").count()
    }

    pub fn pull(&self, robot: &Path, here: &Path) -> Command {
        self.pull_with(&serving(), robot, here)
    }

    pub fn pull_with(&self, remote_command: &Path, robot: &Path, here: &Path) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pull-buffer"));
        command
            .arg(format!("robot=127.0.0.1:{}", robot.display()))
            .arg(here)
            .arg(format!("--program={}", remote_command.display()))
            .args(self.sshd.options().iter().map(|option| format!("--ssh={option}")))
            // Without this directory pulls do not share connections.
            .env_remove("XDG_RUNTIME_DIR")
            .stdin(Stdio::null());
        command
    }
}

/// A wrapper of the system's ssh that logs its arguments.
pub struct SpiedSsh(TempDir);

impl SpiedSsh {
    pub fn new() -> Self {
        let dir = tempdir().unwrap();
        let script = format!(
            "#!/bin/sh\necho \"$@\" >> {}/calls\nexec /usr/bin/ssh \"$@\"\n",
            dir.path().display()
        );
        fs::write(dir.path().join("ssh"), script).unwrap();
        fs::set_permissions(dir.path().join("ssh"), fs::Permissions::from_mode(0o700)).unwrap();
        Self(dir)
    }

    /// A value of `PATH` in which the wrapper is found first.
    pub fn path(&self) -> String {
        format!("{}:/usr/bin:/bin", self.0.path().display())
    }

    /// The arguments of all calls except those that only print the configuration.
    pub fn calls(&self) -> Vec<String> {
        let text = fs::read_to_string(self.0.path().join("calls")).unwrap_or_default();
        text.lines().filter(|call| !call.starts_with("-G ")).map(str::to_owned).collect()
    }
}

/// The path of this package's example `serve`, which acts as `firmware-host buffer serve`.
pub fn serving() -> PathBuf {
    let path =
        Path::new(env!("CARGO_BIN_EXE_pull-buffer")).with_file_name("examples").join("serve");
    assert!(path.exists(), "{} is missing: cargo build -p pull-buffer --examples", path.display());
    path
}

/// Creates segments of random bytes; pulling from a robot does not parse them.
pub fn robot(segments: u64, bytes: usize) -> TempDir {
    let dir = tempdir().unwrap();
    fs::create_dir(dir.path().join("run")).unwrap();
    for number in 0..segments {
        let path = dir.path().join(format!("run/recording_{number:04}.mcap"));
        fs::write(&path, noise(number + 1, bytes + number as usize)).unwrap();
        // RefuseAll writes to it any more.
        fs::File::open(&path).unwrap().set_modified(std::time::UNIX_EPOCH).unwrap();
    }
    dir
}

pub fn assert_same(robot: &Path, here: &Path, segments: u64) {
    for number in 0..segments {
        let file = format!("run/recording_{number:04}.mcap");
        assert!(
            fs::read(robot.join(&file)).unwrap()
                == fs::read(here.join("robot").join(&file)).unwrap(),
            "{file}"
        );
    }
}

pub fn stderr_of(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
