//! `hil world` as a program.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    reason = "a test that cannot set up its scene has failed"
)]

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use assert_cmd::cargo::CommandCargoExt;
use rustix::process::{Pid, Signal, kill_process};

#[test]
fn a_world_that_is_ended_by_a_signal_says_how_the_robot_drove() {
    for signal in [Signal::INT, Signal::TERM, Signal::HUP] {
        let folder = tempfile::tempdir().unwrap();
        let mut world = Command::cargo_bin("hil")
            .unwrap()
            .args(["world", "--frame-size", "160x64", "--dir"])
            .arg(folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(world.stdout.take().unwrap()).lines().map(Result::unwrap);
        assert!(lines.any(|line| line.contains("is ready")));
        kill_process(Pid::from_raw(world.id() as i32).unwrap(), signal).unwrap();
        assert!(lines.any(|line| line.starts_with("world: path_m=")), "{signal:?}");
        assert!(world.wait().unwrap().success(), "{signal:?}");
    }
}
