//! Runs the package's content as the robot would, by emulation if it is for another architecture.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use super::Arch;
use crate::{command, paths};

/// Unpacks the package into a folder and runs its programs.
pub fn run(arch: Arch, package: &Path) -> Result<()> {
    let folder = paths::target().join("dist/trial").join(arch.name());
    if folder.exists() {
        std::fs::remove_dir_all(&folder)
            .with_context(|| format!("removing {}", folder.display()))?;
    }
    let root = folder.join("root");
    std::fs::create_dir_all(&root)?;
    command::run(command::program("dpkg-deb").arg("--extract").arg(package).arg(&root))?;
    command::run(&mut firmware(arch, &root, &["--version"]))?;
    live_view(arch, &root, &folder)?;
    // The endpoints of the robot's own motors are the only values that the packaged configuration lacks.
    let config = read(&root.join("etc/embodied-depth/robot.toml"))?;
    let completed = folder.join("robot.toml");
    std::fs::write(&completed, config.replace("_endpoint = 0", "_endpoint = 1"))?;
    command::run(
        firmware(arch, &root, &["check", "--config"])
            .arg(completed)
            .stdout(std::process::Stdio::null()),
    )?;
    // The package's program has no simulator. This computer's own build explores, and the package's program replays.
    let simulated = simulated(&folder)?;
    let recording = simulated.explore("coarse", &["--frames", "20"])?;
    command::run(firmware(arch, &root, &["replay"]).arg(&recording))?;
    if arch.is_this_computers() {
        // ONNX Runtime crashes under emulation when it queries the processor's model.
        let model = root.join("usr/share/embodied-depth/default.onnx");
        let model = model.to_string_lossy();
        let recording = simulated.explore("network", &["--frames", "5", "--model", &model])?;
        command::run(firmware(arch, &root, &["replay", "--model", &model]).arg(recording))?;
        models(arch, &root, &folder, &simulated)?;
    }
    service(&root)
}

fn firmware(arch: Arch, root: &Path, arguments: &[&str]) -> Command {
    let mut firmware = program(arch, &root.join("usr/bin/firmware-host"));
    firmware.args(arguments).env_remove("ORT_DYLIB_PATH");
    firmware
}

/// This computer's build of the program, which has the simulator.
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

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}

/// Initializes the model store of robot.toml as the service does: the package's network becomes its first model.
fn models(arch: Arch, root: &Path, folder: &Path, simulated: &Simulated) -> Result<()> {
    let config = read(&root.join("etc/embodied-depth/robot.toml"))?;
    let unit = read(&root.join("lib/systemd/system/embodied-depth.service"))?;
    let store = config.lines().find_map(|line| line.strip_prefix("store = \"")?.strip_suffix('"'));
    let store = store.context("robot.toml has no models.store")?;
    // The service may write into its `StateDirectory=` only.
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
    let mut list = firmware(arch, root, &["model", "list", "--json", "--store"]);
    list.arg(&store).arg("--config").arg(root.join("etc/embodied-depth/robot.toml"));
    let said = String::from_utf8_lossy(&list.output()?.stdout).into_owned();
    ensure!(
        said.contains("\"name\":\"default\""),
        "the package's network is not the store's first: {said}"
    );
    Ok(())
}

/// The robot's program, ready to run.
pub fn program(arch: Arch, path: &Path) -> Command {
    let mut program = emulated(arch, path);
    // The program sets this variable by executing itself again, which the emulator cannot do.
    program.env("ORT_DISABLE_TELEMETRY", "1");
    program
}

fn emulated(arch: Arch, path: &Path) -> Command {
    if arch.is_this_computers() {
        return command::program(path);
    }
    let libraries = format!("/usr/{}-linux-gnu", arch.name());
    let mut emulator = command::program(format!("qemu-{}-static", arch.name()));
    // Two C libraries are installed: one with the cross compiler, another by multiarch with Rust's library. With the loader of
    // one and the library of the other, the program hangs when it starts its first thread, because they disagree about the
    // address of the list of stacks.
    emulator.args(["-L", &libraries, "-E", &format!("LD_LIBRARY_PATH={libraries}/lib")]).arg(path);
    emulator
}

/// Runs the live view as far as that goes without a robot: it writes its layout for Foxglove, and refuses to serve a network without
/// tokens.
fn live_view(arch: Arch, root: &Path, folder: &Path) -> Result<()> {
    let path = root.join("usr/bin/live-view");
    command::run(program(arch, &path).arg("--version"))?;
    let layout = folder.join("foxglove.json");
    let mut refused = program(arch, &path);
    refused.args(["--listen", "0.0.0.0:0", "--layout"]).arg(layout);
    let output = refused.output()?;
    ensure!(
        output.status.code() == Some(2)
            && String::from_utf8_lossy(&output.stderr).contains("--tokens"),
        "live-view does not refuse an open address without tokens: {output:?}"
    );
    Ok(())
}

/// Checks the units with systemd-analyze, if it is installed.
fn service(root: &Path) -> Result<()> {
    if !command::works(command::program("systemd-analyze").arg("--version")) {
        println!("systemd-analyze is not installed: the service is not checked");
        return Ok(());
    }
    for name in ["embodied-depth.service", "embodied-depth-live.service"] {
        let unit = root.join("lib/systemd/system").join(name);
        command::run(command::program("systemd-analyze").args(["verify", "--man=no"]).arg(&unit))?;
        // On a scale to 10. The robot's score is 2.1, from its access to devices and the network.
        let mut security = command::program("systemd-analyze");
        security.args(["security", "--no-pager", "--offline=yes", "--threshold=25"]).arg(&unit);
        command::run(security.stdout(std::process::Stdio::null()))
            .with_context(|| format!("{name} has more rights than it had"))?;
    }
    Ok(())
}
