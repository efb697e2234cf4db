//! `firmware-host init` as a new user runs it, against the devices of `hil world`.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its fixture has failed")]

use std::ffi::CStr;
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use drivers::can::Protocol;
use hal::{CameraModel, Clock};
use hil::world::{LiveOptions, LiveWorld};
use monotonic_clock::MonotonicClock;
use rustix::fs::{Mode, OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tempfile::TempDir;

/// A home with small frames, whose motors need no numbers that only their maker knows.
fn world(dir: &Path) -> LiveWorld {
    let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
    let options = LiveOptions { protocol: Protocol::Vesc, camera, ..LiveOptions::default() };
    let world = LiveWorld::start(dir, &options).unwrap();
    // The camera listens in a thread of its own.
    let mut clock = MonotonicClock;
    while !dir.join("camera").exists() {
        clock.sleep_until_ns(clock.now_ns() + 5_000_000);
    }
    world
}

fn init(dir: &Path, out: &Path) -> Command {
    let program = assert_cmd::cargo::cargo_bin("firmware-host");
    assert!(program.is_file(), "build it first: cargo build -p firmware-host");
    let mut command = Command::new(program);
    command.arg("init").arg("--simulated").arg(dir).arg("--out").arg(out);
    command
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

fn folder() -> (TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("my-robot.toml");
    let devices = folder.path().join("devices");
    std::fs::create_dir(&devices).unwrap();
    (folder, devices, out)
}

#[test]
fn a_file_of_answers_makes_a_configuration_with_which_every_device_works() {
    let (folder, devices, out) = folder();
    let _world = world(&devices);
    let answers = folder.path().join("answers.toml");
    std::fs::write(&answers, "camera_place_m = [0.8, 0]\nfootprint_radius_m = 0.16\n").unwrap();
    let output = init(&devices, &out).arg("--answers").arg(&answers).output().unwrap();
    let said = text(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    for part in ["160x64; YUYV", "heard: VESC 1, VESC 2", "The robot is ready"] {
        assert!(said.contains(part), "{part} in {said}");
    }
    assert_eq!(said.matches("working").count(), 3, "{said}");
    let file = std::fs::read_to_string(&out).unwrap();
    assert!(file.contains("devices.base.protocol = \"vesc\""), "{file}");
    assert!(file.contains("devices.camera.width = 160"), "{file}");
}

/// Types lines on a terminal of 60 columns, and returns the exit code and everything that the terminal showed.
fn on_a_terminal(mut command: Command, lines: &str) -> (Option<i32>, String) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    command.stdin(terminal(&name)).stdout(terminal(&name));
    command.stderr(terminal(&name)).env("COLUMNS", "60");
    let mut child = command.spawn().unwrap();
    // The child alone keeps the terminal open now, so that reading ends with it.
    drop(command);
    let mut master = File::from(master);
    // A question too many gets the end of the input instead of waiting for ever.
    master.write_all(format!("{lines}\x04").as_bytes()).unwrap();
    let mut shown = Vec::new();
    // The end of the last process on a terminal is an error (EIO) of its master.
    _ = master.read_to_end(&mut shown);
    let code = child.wait().unwrap().code();
    (code, String::from_utf8_lossy(&shown).into_owned())
}

fn terminal(name: &CStr) -> OwnedFd {
    open(name, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap()
}

#[test]
fn a_person_on_a_terminal_accepts_defaults_corrects_a_wrong_answer_and_gets_a_robot_that_works() {
    let (_folder, devices, out) = folder();
    let _world = world(&devices);
    let lines = format!("3\n1\n0.8\n0.8 0\n{}", "\n".repeat(12));
    let (code, shown) = on_a_terminal(init(&devices, &out), &lines);
    assert_eq!(code, Some(0), "{shown}");
    for part in [
        "!  there is no number 3: give 1, or a name",
        "!  two numbers are wanted, and 1 given",
        "What do the motor controllers speak?",
        "The robot is ready",
    ] {
        assert!(shown.contains(part), "{part} in {shown}");
    }
    assert!(out.is_file());
}

#[test]
fn a_terminal_that_closes_before_the_last_answer_leaves_no_file() {
    let (_folder, devices, out) = folder();
    let (code, shown) = on_a_terminal(init(&devices, &out), "unix:/camera\n");
    assert_eq!(code, Some(1), "{shown}");
    assert!(shown.contains("the input ended before the last answer"), "{shown}");
    assert!(!out.exists());
}

#[test]
fn without_devices_the_file_is_written_and_says_what_to_plug_in() {
    let (folder, devices, out) = folder();
    let answers = folder.path().join("answers.toml");
    std::fs::write(
        &answers,
        "camera = \"unix:/nowhere/camera\"\nlidar_port = \"/nowhere/lidar\"\nbus = \"unix:/nowhere/can\"\nprotocol = \"vesc\"\n",
    )
    .unwrap();
    let output = init(&devices, &out).arg("--answers").arg(&answers).output().unwrap();
    let said = text(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert_eq!(said.matches("plug it in and start again").count(), 3, "{said}");
    assert_eq!(said.matches("disconnected").count(), 3, "{said}");
    assert!(said.contains("then: firmware-host check --devices --config"), "{said}");
    assert!(out.is_file() && !said.contains("The robot is ready"), "{said}");
}
