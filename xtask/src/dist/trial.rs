//! What is in the package is run as it would run on the robot; ARM's program by emulation.

use std::path::{Path, PathBuf};
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
    // The package has no simulator: this computer's own build explores, and the package's program replays every decision.
    let simulated = simulated(&folder)?;
    let recording = simulated.explore("coarse", &["--frames", "20"])?;
    command::run(firmware(&["replay"]).arg(recording))?;
    if arch.is_this_computers() {
        // ONNX Runtime does not run under emulation: it crashes when it asks for the processor's model.
        let model = root.join("usr/share/embodied-depth/default.onnx");
        let model = model.to_string_lossy();
        let recording = simulated.explore("network", &["--frames", "5", "--model", &model])?;
        command::run(firmware(&["replay", "--model", &model]).arg(recording))?;
        models(&root, &folder, &simulated, firmware)?;
    }
    service(&root)
}

/// This computer's own build of the program, which has the simulator.
struct Simulated {
    program: PathBuf,
    folder: PathBuf,
}

fn simulated(folder: &Path) -> Result<Simulated> {
    let arguments = "build --locked --release --package firmware-host";
    command::run(command::cargo().args(arguments.split_whitespace()))?;
    let program = paths::target().join("release/firmware-host");
    Ok(Simulated { program, folder: folder.to_owned() })
}

impl Simulated {
    /// Explores a built-in home into the folder `name`, and returns that folder.
    fn explore(&self, name: &str, arguments: &[&str]) -> Result<PathBuf> {
        let out = self.folder.join(name);
        let mut explore = command::program(&self.program);
        explore.args(["explore", "--scene", "builtin:apartment?seed=1", "--out"]).arg(&out);
        command::run(explore.args(arguments).stdout(std::process::Stdio::null()))?;
        Ok(out)
    }
}

/// Starts a store as the service would: the package's network becomes the first model of the store in robot.toml.
fn models(
    root: &Path,
    folder: &Path,
    simulated: &Simulated,
    firmware: impl Fn(&[&str]) -> Command,
) -> Result<()> {
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
    let texts = [store.to_string_lossy(), model.to_string_lossy()];
    let arguments = ["--frames", "5", "--model-store", &texts[0], "--model", &texts[1]];
    simulated.explore("stored", &arguments)?;
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
