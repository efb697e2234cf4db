//! Installs the trainer into a virtual environment of its own, in the target directory.

use std::num::NonZero;
use std::path::PathBuf;

use anyhow::Result;

use crate::{command, paths, python};

/// Imports PyTorch, which the command's help does without, and the packages of the tests that were added last.
const NEWEST_PACKAGES: &str =
    "import torch, xdist, pyarrow, rosbags, mcap_ros2, yaml, huggingface_hub";

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
    let python = environment.join("bin/python");
    if !is_installed() {
        eprintln!(
            "installing PyTorch (5 GB) into {}, once; this takes some minutes",
            environment.display()
        );
        python::environment(&environment)?;
    }
    // An environment of an earlier version lacks some packages, and keeps its PyTorch.
    if !command::works(command::program(&python).args(["-c", NEWEST_PACKAGES])) {
        let mut pip = command::program(&python);
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--editable"]);
        command::run(pip.arg(format!("{}[dev]", paths::root().join("tools/trainer").display())))?;
    }
    Ok(python)
}

/// Number of processes among which the trainer's tests are divided. Each had 1.2 GB of memory, and those that they start as much.
pub fn test_processes() -> usize {
    std::thread::available_parallelism().map_or(1, NonZero::get).min(4)
}

fn environment() -> PathBuf {
    paths::target().join("tools/trainer")
}
