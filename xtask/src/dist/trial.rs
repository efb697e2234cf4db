//! What is in the package is run as it would run on the robot; ARM's program by emulation.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use super::Arch;
use crate::{command, paths};

/// Unpacks the package into a folder and uses what is there.
pub fn run(arch: Arch, package: &Path) -> Result<()> {
    let folder = paths::target().join("dist/trial").join(arch.name());
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("removing {}", folder.display()))?;
    }
    let root = folder.join("root");
    std::fs::create_dir_all(&root)?;
    command::run(command::program("dpkg-deb").arg("--extract").arg(package).arg(&root))?;
    let firmware = |arguments: &[&str]| {
        let mut firmware = program(arch, &root.join("usr/bin/firmware-host"));
        // Emulators cannot start a program anew, as it does to set this itself.
        firmware.args(arguments).env_remove("ORT_DYLIB_PATH").env("ORT_DISABLE_TELEMETRY", "1");
        firmware
    };
    command::run(&mut firmware(&["--version"]))?;
    let config = root.join("etc/embodied-depth/robot.toml");
    command::run(firmware(&["check", "--config"]).arg(config).stdout(std::process::Stdio::null()))?;
    let explore = |name: &str, frames: &str, model: Option<&Path>| {
        let run = folder.join(name);
        let mut explore = firmware(&["explore", "--scene", "builtin:apartment?seed=1", "--frames", frames, "--out"]);
        explore.arg(&run);
        if let Some(model) = model {
            explore.arg("--model").arg(model);
        }
        command::run(explore.stdout(std::process::Stdio::null()))?;
        Ok::<_, anyhow::Error>(run)
    };
    let run = explore("coarse", "20", None)?;
    command::run(firmware(&["replay"]).arg(run))?;
    if arch.is_this_computers() {
        // ONNX Runtime does not run under emulation: it crashes when it asks what processor it has.
        explore("network", "5", Some(&root.join("usr/share/embodied-depth/default.onnx")))?;
    }
    service(&root)
}

fn program(arch: Arch, path: &Path) -> Command {
    if arch.is_this_computers() {
        return command::program(path);
    }
    let mut emulator = command::program(format!("qemu-{}-static", arch.name()));
    emulator.arg("-L").arg(format!("/usr/{}-linux-gnu", arch.name())).arg(path);
    emulator
}

/// systemd's own opinion of the unit, where there is one.
fn service(root: &Path) -> Result<()> {
    if !command::works(command::program("systemd-analyze").arg("--version")) {
        println!("systemd-analyze is not installed: the service is not checked");
        return Ok(());
    }
    let unit = root.join("lib/systemd/system/embodied-depth.service");
    command::run(command::program("systemd-analyze").args(["verify", "--man=no"]).arg(&unit))?;
    // Of ten; 2.1 when this was written. What is left of it are the devices and the network.
    let mut security = command::program("systemd-analyze");
    security.args(["security", "--no-pager", "--offline=yes", "--threshold=25"]).arg(&unit);
    command::run(security.stdout(std::process::Stdio::null())).context("the service has more rights than it had")
}
