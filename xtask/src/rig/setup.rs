//! Installs QEMU with apt, and prepares Debian's kernels with a small initial root file system each in `target/rig`.

use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, Result, bail};

use super::scenario::Kernel;
use crate::{command, paths};

/// Packages that the host needs, and those that the guest needs, because it has the same root file system.
const PACKAGES: [&str; 12] = [
    "qemu-system-x86",
    "busybox-static",
    "kmod",
    "cpio",
    "iproute2",
    "can-utils",
    "v4l-utils",
    "xz-utils",
    "rt-tests",
    "systemd",
    "udev",
    "procps",
];

/// Groups of kernel modules. The modules that they depend on are added.
const MODULES: [(&str, &[&str]); 5] = [
    (
        "base",
        &["virtio_pci", "9pnet_virtio", "9p", "overlay", "virtio_console", "virtio_blk", "ext4"],
    ),
    ("can", &["kvaser_pci", "can_raw", "vcan", "vxcan"]),
    ("video", &["vivid"]),
    ("serial", &["uhci_hcd", "ftdi_sio"]),
    ("imu", &["uhid", "hid_sensor_hub", "hid_sensor_gyro_3d"]),
];

/// Files of a kernel.
pub fn folder(kernel: Kernel) -> PathBuf {
    paths::target().join("rig").join(kernel.name())
}

/// Installs everything that is missing.
///
/// # Errors
/// When this computer does not run Debian 12, or packages cannot be installed.
pub fn install() -> Result<()> {
    let missing: Vec<_> = PACKAGES.into_iter().filter(|name| !installed(name)).collect();
    let kernels: Vec<_> = Kernel::ALL
        .into_iter()
        .filter(|kernel| !folder(*kernel).join("vmlinux").exists())
        .collect();
    if !missing.is_empty() || !kernels.is_empty() {
        command::run(command::program("apt-get").args(["-qq", "update"]))
            .context("the rig needs root on Debian 12 once, for apt")?;
    }
    if !missing.is_empty() {
        println!("installing {}", missing.join(", "));
        let mut apt = command::program("apt-get");
        apt.args(["-qq", "install", "-y", "--no-install-recommends"]).args(&missing);
        command::run(apt.env("DEBIAN_FRONTEND", "noninteractive").stdout(Stdio::null()))?;
    }
    for kernel in kernels {
        println!("fetching the kernel `{}`", kernel.name());
        fetch(kernel)?;
    }
    // The file system is created every time, because it contains the project's init.
    Kernel::ALL.into_iter().try_for_each(first_root)
}

fn installed(package: &str) -> bool {
    command::works(command::program("dpkg").args(["-s", package]))
}

fn fetch(kernel: Kernel) -> Result<()> {
    let folder = folder(kernel);
    if folder.exists() {
        std::fs::remove_dir_all(&folder)?;
    }
    std::fs::create_dir_all(&folder)?;
    let depends =
        command::output(command::program("apt-cache").args(["depends", kernel.package()]))?;
    let package = depends
        .lines()
        .find_map(|line| {
            line.trim().strip_prefix("Depends: ").filter(|name| name.starts_with("linux-image-"))
        })
        .with_context(|| format!("apt has no kernel for {}", kernel.package()))?;
    let mut apt = command::program("apt-get");
    command::run(
        apt.args(["-qq", "download", package]).current_dir(&folder).stderr(Stdio::null()),
    )?;
    let archive = find(&folder, |name| name.ends_with(".deb"))?;
    command::run(command::program("dpkg-deb").arg("--extract").arg(&archive).arg(&folder))?;
    std::fs::remove_file(&archive)?;
    let image = find(&folder.join("boot"), |name| name.starts_with("vmlinuz-"))?;
    command::run(command::program("depmod").arg("-b").arg(&folder).arg(version(kernel)?))?;
    // The kernel is unpacked here, because the guest would take 5 s to do so. It is written last, so that it exists
    // only if all of its files are complete.
    let unpacked = unpack(&std::fs::read(&image)?)?;
    Ok(std::fs::write(folder.join("vmlinux"), unpacked)?)
}

/// The kernel's version: the name of its modules' folder.
fn version(kernel: Kernel) -> Result<String> {
    let path = find(&folder(kernel).join("lib/modules"), |_| true)?;
    Ok(path.file_name().unwrap_or_default().to_string_lossy().into_owned())
}

fn find(folder: &Path, wanted: impl Fn(&str) -> bool) -> Result<PathBuf> {
    let entries =
        std::fs::read_dir(folder).with_context(|| format!("reading {}", folder.display()))?;
    entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.file_name().and_then(OsStr::to_str).is_some_and(&wanted))
        .with_context(|| format!("{} has none of the expected files", folder.display()))
}

/// Unpacks the kernel inside a bzImage, which is an xz stream followed by other data.
fn unpack(image: &[u8]) -> Result<Vec<u8>> {
    const XZ: &[u8] = b"\xfd7zXZ\0";
    let start = image
        .windows(XZ.len())
        .position(|bytes| bytes == XZ)
        .context("the kernel is not packed with xz")?;
    let mut xz = command::program("xz");
    xz.args(["-dcq", "--single-stream"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    let mut xz = xz.spawn().context("cannot start `xz`")?;
    let mut input = xz.stdin.take().context("xz without input")?;
    let packed = image[start..].to_vec();
    // xz stops reading at the end of its stream, so writing the rest fails.
    let writer = std::thread::spawn(move || _ = input.write_all(&packed));
    let output = xz.wait_with_output()?.stdout;
    _ = writer.join();
    if !output.starts_with(b"\x7fELF") {
        bail!("the content of the xz stream is not a kernel");
    }
    Ok(output)
}

/// Packs busybox, the modules in the order in which they are loaded, and tests/rig/init.sh.
fn first_root(kernel: Kernel) -> Result<()> {
    let folder = folder(kernel);
    let root = folder.join("initrd");
    if root.exists() {
        std::fs::remove_dir_all(&root)?;
    }
    for name in ["bin", "modules", "proc", "sys", "dev", "root", "host", "above"] {
        std::fs::create_dir_all(root.join(name))?;
    }
    let busybox =
        ["/bin/busybox", "/usr/bin/busybox"].into_iter().find(|path| Path::new(path).exists());
    std::fs::copy(busybox.context("busybox-static is not installed")?, root.join("bin/busybox"))?;
    for name in command::output(command::program("busybox").arg("--list"))?
        .lines()
        .filter(|name| *name != "busybox")
    {
        std::os::unix::fs::symlink("busybox", root.join("bin").join(name))?;
    }
    let version = version(kernel)?;
    for (group, modules) in MODULES {
        let mut order: Vec<String> = Vec::new();
        for module in modules {
            let mut modprobe = command::program("modprobe");
            modprobe.arg("-d").arg(&folder).args(["-S", &version, "--show-depends", module]);
            let listed = command::output(&mut modprobe)?;
            for path in listed.lines().filter_map(|line| line.strip_prefix("insmod ")) {
                let path = Path::new(path.trim());
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                if !order.contains(&name) {
                    std::fs::copy(path, root.join("modules").join(&name))?;
                    order.push(name);
                }
            }
        }
        std::fs::write(root.join("modules").join(group), order.join("\n") + "\n")?;
    }
    std::fs::copy(paths::root().join("tests/rig/init.sh"), root.join("init"))?;
    command::run(command::program("chmod").arg("+x").arg(root.join("init")))?;
    let mut cpio = command::program("sh");
    command::run(
        cpio.current_dir(&root).args(["-c", "find . | cpio -o -H newc --quiet >../initrd.img"]),
    )
}
