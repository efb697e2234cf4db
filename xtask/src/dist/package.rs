//! Lays out the package's files as on the robot, and packs them with `dpkg-deb`.

use std::fs;
use std::io;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, Result, bail};

use super::{Arch, FEATURES, trial};
use crate::{command, onnx_runtime, paths};

/// Files that are copied unchanged: path in the repository, path on the robot.
const FILES: [(&str, &str); 12] = [
    ("firmware-host/models/default.onnx", "usr/share/embodied-depth/default.onnx"),
    ("firmware-host/models/README.md", "usr/share/doc/embodied-depth/default.onnx.md"),
    ("firmware-host/robot.default.toml", "usr/share/doc/embodied-depth/robot.default.toml"),
    ("docs/install.md", "usr/share/doc/embodied-depth/install.md"),
    ("firmware-host/packaging/copyright", "usr/share/doc/embodied-depth/copyright"),
    ("firmware-host/packaging/robot.toml", "etc/embodied-depth/robot.toml"),
    ("firmware-host/packaging/embodied-depth.service", "lib/systemd/system/embodied-depth.service"),
    (
        "firmware-host/packaging/embodied-depth-live.service",
        "lib/systemd/system/embodied-depth-live.service",
    ),
    ("docs/live-view.md", "usr/share/doc/embodied-depth/live-view.md"),
    ("firmware-host/packaging/60-embodied-depth.rules", "lib/udev/rules.d/60-embodied-depth.rules"),
    ("firmware-host/packaging/sysusers.conf", "usr/lib/sysusers.d/embodied-depth.conf"),
    ("firmware-host/packaging/modules-load.conf", "usr/lib/modules-load.d/embodied-depth.conf"),
];
/// Files that the user may change, and that an upgrade keeps.
const CONFFILES: &str = "/etc/embodied-depth/robot.toml\n";
const SCRIPTS: [&str; 3] = ["postinst", "prerm", "postrm"];
/// The programs of the package, which are also the crates that they are built from.
pub const PROGRAMS: [&str; 2] = ["firmware-host", "live-view"];
/// Folder of the programs and of ONNX Runtime, which `firmware-host` finds beside itself.
const LIBRARIES: &str = "usr/lib/embodied-depth";
const DOCUMENTS: &str = "usr/share/doc/embodied-depth";

/// Packs the programs, which were built in the folder `built`, into a package in `folder`. Returns the package's path.
pub fn make(arch: Arch, built: &Path, folder: &Path) -> Result<PathBuf> {
    let root = folder.join(arch.name());
    if root.exists() {
        fs::remove_dir_all(&root).with_context(|| format!("removing {}", root.display()))?;
    }
    for (from, to) in FILES {
        copy(&paths::root().join(from), &root.join(to), 0o644)?;
    }
    fs::create_dir_all(root.join("usr/bin"))?;
    let library = onnx_runtime(arch, &root)?;
    let mut glibc = needed_glibc(&library)?;
    for program in PROGRAMS {
        glibc = glibc.max(needed_glibc(&install(arch, &built.join(program), &root, program)?)?);
    }
    manual(arch, &root)?;
    fs::write(root.join(DOCUMENTS).join("third-party.txt"), crates()?)?;
    control(arch, &root, glibc)?;
    pack(arch, &root, folder)
}

/// Copies a program into the package. Returns its path there.
fn install(arch: Arch, program: &Path, root: &Path, name: &str) -> Result<PathBuf> {
    let installed = root.join(LIBRARIES).join(name);
    copy(program, &installed, 0o755)?;
    // Most of a program's size is line numbers. The names of functions are kept, for the trace of a panic.
    command::run(command::program(strip(arch)).arg("--strip-debug").arg(&installed))?;
    symlink(format!("../lib/embodied-depth/{name}"), root.join("usr/bin").join(name))?;
    Ok(installed)
}

fn onnx_runtime(arch: Arch, root: &Path) -> Result<PathBuf> {
    let wheel = onnx_runtime::with_notices(arch.name())?;
    let library = root.join(LIBRARIES).join(wheel.library.file_name().unwrap_or_default());
    copy(&wheel.library, &library, 0o644)?;
    for notice in wheel.notices {
        let name = notice.file_name().unwrap_or_default();
        copy(&notice, &root.join(DOCUMENTS).join("onnxruntime").join(name), 0o644)?;
    }
    Ok(library)
}

/// Where each shell looks for completion scripts.
const COMPLETIONS: [(&str, &str); 3] = [
    ("bash", "usr/share/bash-completion/completions/firmware-host"),
    ("zsh", "usr/share/zsh/vendor-completions/_firmware-host"),
    ("fish", "usr/share/fish/vendor_completions.d/firmware-host.fish"),
];

/// Man pages and completion scripts, made by the packaged program itself.
fn manual(arch: Arch, root: &Path) -> Result<()> {
    let program = root.join("usr/bin/firmware-host");
    for (shell, path) in COMPLETIONS {
        let script = output(trial::program(arch, &program).args(["completions", shell]))?;
        let path = root.join(path);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(&path, script).with_context(|| format!("writing {}", path.display()))?;
    }
    let pages = root.join("usr/share/man/man1");
    command::run(trial::program(arch, &program).arg("man-pages").arg(&pages))?;
    // `-n`: without the time, so that the same commit gives the same package.
    let compress = "gzip -9n *.1";
    command::run(command::program("sh").args(["-c", compress]).current_dir(pages))
}

fn copy(from: &Path, to: &Path, mode: u32) -> Result<()> {
    copy_with_folder(from, to, mode)
        .with_context(|| format!("copying {} to {}", from.display(), to.display()))
}

/// Copies a file, and makes its folder if there is none.
fn copy_with_folder(from: &Path, to: &Path, mode: u32) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::copy(from, to)?;
    fs::set_permissions(to, fs::Permissions::from_mode(mode))
}

fn strip(arch: Arch) -> String {
    if arch.is_this_computers() {
        "strip".to_owned()
    } else {
        format!("{}-linux-gnu-strip", arch.name())
    }
}

/// The crates in the programs with their licences.
fn crates() -> Result<String> {
    let mut tree = command::cargo();
    tree.args(["tree", "--locked", "--quiet", "--edges", "normal", "--prefix", "none", FEATURES]);
    tree.args(PROGRAMS.iter().flat_map(|program| ["--package", program]));
    let listed = output(tree.args(["--format", "{p}  {l}", "--target", "all"]))?;
    // The project's crates are listed with their paths, and repeated crates with a star.
    let mut lines: Vec<_> = listed
        .lines()
        .filter(|line| !line.contains("(/"))
        .map(|line| line.trim_end_matches(" (*)"))
        .collect();
    lines.sort_unstable();
    lines.dedup();
    Ok(lines.join("\n") + "\n")
}

/// The newest version of glibc that an ELF file needs. The file contains its name, such as `GLIBC_2.34`.
fn needed_glibc(file: &Path) -> Result<(u32, u32)> {
    const NAME: &[u8] = b"GLIBC_2.";
    let bytes = fs::read(file).with_context(|| format!("reading {}", file.display()))?;
    let minors = bytes
        .windows(NAME.len() + 2)
        .filter(|window| window.starts_with(NAME))
        .filter_map(|window| {
            let digits: String = window[NAME.len()..]
                .iter()
                .map(|byte| char::from(*byte))
                .take_while(char::is_ascii_digit)
                .collect();
            digits.parse().ok()
        });
    minors
        .max()
        .map(|minor| (2, minor))
        .with_context(|| format!("{} names no version of glibc", file.display()))
}

fn control(arch: Arch, root: &Path, (major, minor): (u32, u32)) -> Result<()> {
    let folder = root.join("DEBIAN");
    fs::create_dir_all(&folder)?;
    let installed_kib = output(command::program("du").args(["-sk", "--apparent-size"]).arg(root))?;
    let installed_kib = installed_kib.split_whitespace().next().unwrap_or("0").to_owned();
    let text = format!(
        "Package: embodied-depth\n\
         Version: {}\n\
         Architecture: {}\n\
         Maintainer: Embodied Depth <embodied-depth@localhost>\n\
         Installed-Size: {installed_kib}\n\
         Depends: libc6 (>= {major}.{minor}), libgcc-s1, libstdc++6, systemd, udev, iproute2\n\
         Suggests: can-utils, v4l-utils\n\
         Section: science\n\
         Priority: optional\n\
         Description: robot that explores a home and learns how far things are\n\
         \x20Drives a robot with a camera (V4L2), a scanner (Hokuyo, RPLIDAR,\n\
         \x20LD06) and two motors (CAN),\n\
         \x20explores, records, and computes depth from its own motion. With ONNX Runtime,\n\
         \x20a depth network, and a live view for browsers.\n",
        env!("CARGO_PKG_VERSION"),
        arch.debian(),
    );
    fs::write(folder.join("control"), text)?;
    fs::write(folder.join("conffiles"), CONFFILES)?;
    for script in SCRIPTS {
        copy(
            &paths::root().join("firmware-host/packaging/debian").join(script),
            &folder.join(script),
            0o755,
        )?;
    }
    let sums = "find . -type f ! -path './DEBIAN/*' -printf '%P\\0' | sort -z | xargs -0 md5sum > DEBIAN/md5sums";
    command::run(command::program("sh").args(["-c", sums]).current_dir(root))
}

fn pack(arch: Arch, root: &Path, folder: &Path) -> Result<PathBuf> {
    let name = format!("embodied-depth_{}_{}.deb", env!("CARGO_PKG_VERSION"), arch.debian());
    let package = folder.join(name);
    let mut dpkg = command::program("dpkg-deb");
    // The same commit gives the same package.
    if let Ok(time) = output(command::program("git").args(["log", "-1", "--format=%ct"])) {
        dpkg.env("SOURCE_DATE_EPOCH", time.trim());
    }
    // This is Debian's default compression. Ubuntu's dpkg-deb has another default, which Debian 11 cannot read.
    dpkg.args(["--root-owner-group", "-Zxz", "--build"]).arg(root).arg(&package);
    command::run(dpkg.stdout(Stdio::null()))?;
    Ok(package)
}

/// The output of a program.
fn output(command: &mut std::process::Command) -> Result<String> {
    let output = command.stderr(Stdio::inherit()).output()?;
    if !output.status.success() {
        bail!("`{}` failed", command::text(command));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
