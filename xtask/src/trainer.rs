//! Installs the trainer into a virtual environment of its own, in the target directory.

use std::path::PathBuf;

use anyhow::{Context, Result};

use crate::onnx_runtime::python;
use crate::{command, paths};

/// Whether it was installed before.
pub fn is_installed() -> bool {
    command::works(command::program(environment().join("bin/embodied-depth")).arg("--help"))
}

/// The Python that has the trainer and what checks it. The first time, PyTorch (5 GB) is installed.
///
/// # Errors
/// When it cannot be installed.
pub fn install() -> Result<PathBuf> {
    let environment = environment();
    let python_of_ours = environment.join("bin/python");
    if !is_installed() {
        eprintln!("installing PyTorch (5 GB) into {}, once; this takes some minutes", environment.display());
        command::run(python()?.args(["-m", "venv"]).arg(&environment))
            .context("python3 has no venv; `apt-get install python3-venv` may help")?;
        let mut pip = command::program(&python_of_ours);
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--editable"]);
        command::run(pip.arg(format!("{}[dev]", paths::root().join("tools/trainer").display())))?;
    }
    Ok(python_of_ours)
}

fn environment() -> PathBuf {
    paths::target().join("tools/trainer")
}
