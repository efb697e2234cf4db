//! `hil world` as a program.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    reason = "a test that cannot set up its scene has failed"
)]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use assert_cmd::cargo::CommandCargoExt;
use rustix::process::{Pid, Signal, kill_process};
use simulator::{OpenOptions, World};

/// A world, and the lines that it prints, after it is ready.
fn world(folder: &Path) -> (Child, impl Iterator<Item = String>) {
    let mut world = Command::cargo_bin("hil")
        .unwrap()
        .args(["world", "--frame-size", "160x64", "--dir"])
        .arg(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(world.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|line| line.contains("is ready")));
    (world, lines)
}

fn send(world: &Child, signal: Signal) {
    kill_process(Pid::from_raw(world.id() as i32).unwrap(), signal).unwrap();
}

#[test]
fn a_world_that_is_ended_by_a_signal_says_how_the_robot_drove() {
    for signal in [Signal::INT, Signal::TERM, Signal::HUP] {
        let folder = tempfile::tempdir().unwrap();
        let (mut world, mut lines) = world(folder.path());
        send(&world, signal);
        assert!(lines.any(|line| line.starts_with("world: path_m=")), "{signal:?}");
        assert!(world.wait().unwrap().success(), "{signal:?}");
    }
}

#[test]
fn a_world_whose_output_is_not_read_any_more_ends_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let (world, lines) = world(folder.path());
    drop(lines);
    send(&world, Signal::TERM);
    let output = world.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    assert!(output.status.success());
}

#[test]
fn signals_cut_the_power_of_the_motors_and_restore_it() {
    let folder = tempfile::tempdir().unwrap();
    let (mut world, mut lines) = world(folder.path());
    for (signal, message) in
        [(Signal::USR1, "the motors have no power"), (Signal::USR2, "the motors have power again")]
    {
        send(&world, signal);
        assert!(lines.any(|line| line.contains(message)), "{signal:?}");
    }
    send(&world, Signal::TERM);
    assert!(lines.any(|line| line.starts_with("world: path_m=")));
    assert!(world.wait().unwrap().success());
}

#[test]
fn lines_that_are_written_to_its_pipe_carry_push_and_hold_the_robot() {
    let folder = tempfile::tempdir().unwrap();
    let (mut world, mut lines) = world(folder.path());
    let control = folder.path().join("control");
    let home = World::open("builtin:apartment?seed=1", &OpenOptions::default()).unwrap();
    let place = home.floor_plan().start_pose(7);
    let carried = format!("carried to ({:.2}, {:.2}) m, 90 degrees", place.x_m, place.y_m);
    for (order, message) in [
        (format!("carry {} {} 90", place.x_m, place.y_m), carried.as_str()),
        ("carry 100 100 0".to_owned(), "the robot does not fit at (100.00, 100.00) m; it does at"),
        ("spin 3".to_owned(), "the wheels have no grip for 3 s"),
        ("fly 1 2".to_owned(), "`fly 1 2` is not understood: write `carry X Y DEGREES`"),
    ] {
        std::fs::write(&control, order + "\n").unwrap();
        assert!(lines.any(|line| line.contains(message)), "{message}");
    }
    send(&world, Signal::TERM);
    assert!(lines.any(|line| line.starts_with("world: path_m=")));
    assert!(world.wait().unwrap().success());
}
