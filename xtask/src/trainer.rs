//! Installs the trainer into a virtual environment of its own, in the target directory.

use std::num::NonZero;
use std::path::PathBuf;

use anyhow::Result;

use crate::{command, paths, python};

/// Whether the trainer is installed, with what tests it: an environment of an earlier version lacks pytest-xdist.
pub fn is_installed() -> bool {
    let bin = environment().join("bin");
    let has_program = command::works(command::program(bin.join("embodied-depth")).arg("--help"));
    has_program && command::works(command::program(bin.join("python")).args(["-c", "import xdist"]))
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

/// Number of processes among which the trainer's tests are divided. Each needs up to 2 GB of memory.
pub fn test_processes() -> usize {
    std::thread::available_parallelism().map_or(1, NonZero::get).min(4)
}

fn environment() -> PathBuf {
    paths::target().join("tools/trainer")
}
