//! What is in the package is run as it would run on the robot; ARM's program by emulation.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};

use super::Arch;
use crate::{command, paths};

/// Unpacks the package into a folder and uses what is there.
pub fn run(arch: Arch, package: &Path) -> Result<()> {
    let folder = paths::target().join("dist/trial").join(arch.name());
    if folder.exists() {
        std::fs::remove_dir_all(&folder)
            .with_context(|| format!("removing {}", folder.display()))?;
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
        let mut explore = firmware(&[
            "explore",
            "--scene",
            "builtin:apartment?seed=1",
            "--frames",
            frames,
            "--out",
        ]);
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
        models(&root, &folder, firmware)?;
    }
    service(&root)
}

/// Explores with what the service is given: the package's network becomes the first of the store in robot.toml.
fn models(root: &Path, folder: &Path, firmware: impl Fn(&[&str]) -> Command) -> Result<()> {
    let read = |path: &str| {
        let path = root.join(path);
        std::fs::read_to_string(&path).with_context(|| path.display().to_string())
    };
    let [config, unit] =
        ["etc/embodied-depth/robot.toml", "lib/systemd/system/embodied-depth.service"].map(read);
    let (config, unit) = (config?, unit?);
    let store = config.lines().find_map(|line| line.strip_prefix("store = \"")?.strip_suffix('"'));
    let store = store.context("robot.toml names no models.store")?;
    // Where the service may write: `StateDirectory=`.
    let name = store
        .strip_prefix("/var/lib/embodied-depth/")
        .context("the service cannot write its models.store")?;
    ensure!(
        unit.lines().any(|line| line == "StateDirectory=embodied-depth"),
        "the service has no state directory"
    );
    let arguments = unit
        .lines()
        .find_map(|line| line.strip_prefix("Environment=\"ARGUMENTS=")?.strip_suffix('"'));
    let model = arguments
        .and_then(|words| words.split_whitespace().skip_while(|word| *word != "--model").nth(1));
    let model = root.join(model.context("the service gives no --model")?.trim_start_matches('/'));
    let store = folder.join(name);
    let mut explore =
        firmware(&["explore", "--scene", "builtin:apartment?seed=1", "--frames", "5", "--out"]);
    explore.arg(folder.join("stored")).arg("--model-store").arg(&store).arg("--model").arg(&model);
    command::run(explore.stdout(std::process::Stdio::null()))?;
    let mut list = firmware(&["model", "list", "--json", "--store"]);
    list.arg(&store).arg("--config").arg(root.join("etc/embodied-depth/robot.toml"));
    let said = String::from_utf8_lossy(&list.output()?.stdout).into_owned();
    ensure!(
        said.contains("\"name\":\"default\""),
        "the package's network is not the store's first: {said}"
    );
    Ok(())
}

fn program(arch: Arch, path: &Path) -> Command {
    if arch.is_this_computers() {
        return command::program(path);
    }
    let libraries = format!("/usr/{}-linux-gnu", arch.name());
    let mut emulator = command::program(format!("qemu-{}-static", arch.name()));
    // The cross compiler brings a C library, its Rust library another one by multiarch. Loader and library of different builds
    // hang in the first thread that is started: they disagree where the list of stacks is.
    emulator.args(["-L", &libraries, "-E", &format!("LD_LIBRARY_PATH={libraries}/lib")]).arg(path);
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
    command::run(security.stdout(std::process::Stdio::null()))
        .context("the service has more rights than it had")
}
