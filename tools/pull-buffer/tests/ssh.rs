//! The real thing: `pull-buffer` over OpenSSH on loopback, with keys of its own. Without an sshd the tests say so and pass.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use drivers::MonotonicClock;
use hal::Clock;
use hil::sshd::Sshd;
use tempfile::{TempDir, tempdir};

fn wait_ms(milliseconds: u64) {
    let mut clock = MonotonicClock;
    let deadline_ns = clock.now_ns() + milliseconds * 1_000_000;
    clock.sleep_until_ns(deadline_ns);
}

/// An ssh server on loopback.
struct Server {
    sshd: Sshd,
    /// Its keys.
    _dir: TempDir,
}

impl Server {
    /// `None` where there is no sshd, or it may not run here.
    fn start() -> Option<Self> {
        let dir = tempdir().unwrap();
        Some(Self { sshd: Sshd::start(dir.path()).unwrap()?, _dir: dir })
    }

    fn pull(&self, robot: &Path, here: &Path) -> Command {
        self.pull_with(&serving(), robot, here)
    }

    fn pull_with(&self, remote_command: &Path, robot: &Path, here: &Path) -> Command {
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
fn serving() -> PathBuf {
    let path = Path::new(env!("CARGO_BIN_EXE_pull-buffer")).with_file_name("examples").join("serve");
    assert!(path.exists(), "{} is missing: cargo build -p pull-buffer --examples", path.display());
    path
}

fn noise(seed: u64, length: usize) -> Vec<u8> {
    let mut state = seed | 1;
    let mut bytes = Vec::with_capacity(length + 8);
    while bytes.len() < length {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        bytes.extend_from_slice(&state.to_le_bytes());
    }
    bytes.truncate(length);
    bytes
}

/// Segments without sense: nothing on the way looks into them.
fn robot(segments: u64, bytes: usize) -> TempDir {
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

fn assert_same(robot: &Path, here: &Path, segments: u64) {
    for number in 0..segments {
        let file = format!("run/recording_{number:04}.mcap");
        assert!(fs::read(robot.join(&file)).unwrap() == fs::read(here.join("robot").join(&file)).unwrap(), "{file}");
    }
}

fn words(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_robot_is_pulled_over_ssh_and_the_second_time_nothing_moves() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(3, 1 << 20), tempdir().unwrap());
    let output = server.pull(robot.path(), here.path()).arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", words(&output));
    assert_same(robot.path(), here.path(), 3);
    assert!(robot.path().join("run/recording_0002.mcap.pulled").exists());
    let output = server.pull(robot.path(), here.path()).arg("--json").output().unwrap();
    let last = String::from_utf8(output.stdout).unwrap().lines().last().unwrap().to_owned();
    let report: serde_json::Value = serde_json::from_str(&last).unwrap();
    assert_eq!((&report["files"], &report["bytes"], &report["there"]), (&0.into(), &0.into(), &3.into()), "{report}");
}

#[test]
fn a_changed_host_key_is_refused_in_sshs_own_words() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(1, 1000), tempdir().unwrap());
    server.sshd.trust("key.pub").unwrap();
    let output = server.pull(robot.path(), here.path()).output().unwrap();
    let words = words(&output);
    assert!(!output.status.success() && words.contains("REMOTE HOST IDENTIFICATION HAS CHANGED"), "{words}");
    assert!(words.contains("127.0.0.1 ended before it said anything") && words.contains("255"), "{words}");
    assert!(!here.path().join("robot/run").exists());
}

#[test]
fn a_robot_without_the_program_is_named_with_the_way_out() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(1, 1000), tempdir().unwrap());
    let output = server.pull_with(Path::new("/no/such/program"), robot.path(), here.path()).output().unwrap();
    let words = words(&output);
    assert!(words.contains("/no/such/program") && words.contains("--remote-command"), "{words}");
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn killed_at_any_moment_it_goes_on_and_ends_with_the_same_bytes() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(4, 3 << 20), tempdir().unwrap());
    let (mut kills, mut seed) = (0, 77_u64);
    for _ in 0..60 {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        // Slow enough that most kills come in the middle of something.
        let mut child =
            server.pull(robot.path(), here.path()).arg("--limit=10MB/s").stderr(Stdio::null()).spawn().unwrap();
        wait_ms(150 + (seed >> 33) % 400);
        let ended = child.try_wait().unwrap().is_some();
        child.kill().unwrap();
        child.wait().unwrap();
        kills += u32::from(!ended);
        for number in 0..4 {
            let file = format!("run/recording_{number:04}.mcap");
            if let Ok(bytes) = fs::read(here.path().join("robot").join(&file)) {
                assert!(bytes == fs::read(robot.path().join(&file)).unwrap(), "{file} has its name and is not whole");
            }
        }
        if ended {
            break;
        }
    }
    let output = server.pull(robot.path(), here.path()).output().unwrap();
    assert!(output.status.success(), "{}", words(&output));
    assert_same(robot.path(), here.path(), 4);
    assert!(kills > 0, "every pull was through before it could be killed");
}
