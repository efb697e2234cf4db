//! Installs the trainer into a virtual environment of its own, in the target directory.

use std::path::PathBuf;

use anyhow::Result;

use crate::{command, paths, python};

/// Whether the trainer is installed.
pub fn is_installed() -> bool {
    command::works(command::program(environment().join("bin/embodied-depth")).arg("--help"))
}

/// The Python with the trainer and the tools that check it. The first time, PyTorch (5 GB) is installed.
///
/// # Errors
/// When it cannot be installed.
pub fn install() -> Result<PathBuf> {
    let environment = environment();
    if !is_installed() {
        eprintln!(
            "installing PyTorch (5 GB) into {}, once; this takes some minutes",
            environment.display()
        );
        let mut pip = command::program(python::environment(&environment)?);
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--editable"]);
        command::run(pip.arg(format!("{}[dev]", paths::root().join("tools/trainer").display())))?;
    }
    Ok(environment.join("bin/python"))
}

fn environment() -> PathBuf {
    paths::target().join("tools/trainer")
}
