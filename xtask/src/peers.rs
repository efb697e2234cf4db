//! Installs Python packages into the target directory: those that the benchmarks compare with, and those that tests use to
//! check the project's output.

use std::path::PathBuf;

use anyhow::{Context, Result};

use crate::{command, paths, python};

/// The folder with the packages of `tools/bench/peers/requirements.txt`, for `PYTHONPATH`.
///
/// # Errors
/// When they cannot be installed.
pub fn of_benchmarks() -> Result<PathBuf> {
    let requirements = paths::root().join("tools/bench/peers/requirements.txt");
    let wanted = std::fs::read_to_string(&requirements)
        .with_context(|| requirements.display().to_string())?;
    let folder = paths::target().join("tools/peers");
    let stamp = folder.join("installed.txt");
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(folder);
    }
    eprintln!("installing the peers of the benchmarks into {}", folder.display());
    if folder.exists() {
        std::fs::remove_dir_all(&folder)
            .with_context(|| format!("removing {}", folder.display()))?;
    }
    let mut pip = python::with_pip()?;
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--only-binary=:all:",
        "--target",
    ]);
    command::run(pip.arg(&folder).arg("--requirement").arg(&requirements))?;
    std::fs::write(&stamp, wanted).with_context(|| stamp.display().to_string())?;
    Ok(folder)
}

/// A Python with the packages of `tests/peers/requirements.txt`, in a virtual environment, because some of them exist as
/// source only. `None` if they are missing and may not be installed.
///
/// # Errors
/// When they cannot be installed.
pub fn of_tests(install: bool) -> Result<Option<PathBuf>> {
    let requirements = paths::root().join("tests/peers/requirements.txt");
    let wanted = std::fs::read_to_string(&requirements)
        .with_context(|| requirements.display().to_string())?;
    let environment = paths::target().join("tools/test-peers");
    let stamp = environment.join("installed.txt");
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(Some(environment.join("bin/python")));
    }
    if !install {
        return Ok(None);
    }
    eprintln!("installing the peers of the tests into {}", environment.display());
    let python_with_peers = python::environment(&environment)?;
    let mut pip = command::program(&python_with_peers);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--requirement"]);
    command::run(pip.arg(&requirements))?;
    std::fs::write(&stamp, wanted).with_context(|| stamp.display().to_string())?;
    Ok(Some(python_with_peers))
}
