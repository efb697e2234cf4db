//! `cargo xtask live`: a simulated robot to look at in a browser, and the images of docs/live-view.md.

use std::process::Child;

use anyhow::{Context, Result};

use crate::{command, paths};

/// The run ends after this many frames: an hour in real time.
const FRAMES: &str = "36000";

/// Builds both programs, starts a simulated robot in real time, and serves its live view until Ctrl-C.
pub fn run() -> Result<()> {
    println!("building firmware-host and live-view in release; the first time takes some minutes");
    let build =
        ["build", "--release", "--locked", "--package", "firmware-host", "--package", "live-view"];
    command::run(command::cargo().args(build))?;
    let folder = paths::target().join("live");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
    }
    let socket = folder.join("live.sock");
    let mut explore = command::program(paths::target().join("release/firmware-host"));
    explore
        .args(["explore", "--scene", "builtin:apartment?seed=1", "--frames", FRAMES, "--real-time"])
        .arg("--map")
        .arg(folder.join("home.map"))
        .arg("--out")
        .arg(folder.join("run"))
        .arg("--live")
        .arg(&socket);
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    println!("> {}", command::text(&explore));
    let mut robot = Robot(explore.spawn().context("cannot start firmware-host")?);
    let mut view = command::program(paths::target().join("release/live-view"));
    view.arg("--robot").arg(&socket).arg("--layout").arg(folder.join("foxglove.json"));
    println!("> {}", command::text(&view));
    let served = command::run(&mut view);
    robot.end();
    served
}

/// The simulated robot, which ends with this chore.
struct Robot(Child);

impl Robot {
    fn end(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.end();
    }
}

/// Makes docs/images/live-laptop.png and live-phone.png from a run of a minute and a half. Needs Chromium.
pub fn screenshots() -> Result<()> {
    let test = [
        "test",
        "--locked",
        "--package",
        "firmware-host",
        "--test",
        "live",
        "--",
        "--ignored",
        "--nocapture",
    ];
    command::run(command::cargo().args(test).arg("screenshots_for_the_documentation"))
}
