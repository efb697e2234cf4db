//! The system's Python and virtual environments.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::command::{self, program};
use crate::paths;

/// The system's Python.
pub fn system() -> Result<Command> {
    if command::works(program("python3").arg("--version")) {
        Ok(program("python3"))
    } else {
        bail!("there is no python3")
    }
}

/// The system's Python if it has pip, else the Python of a virtual environment.
pub fn with_pip() -> Result<Command> {
    if command::works(system()?.args(["-m", "pip", "--version"])) {
        return system();
    }
    Ok(program(environment(&paths::target().join("tools/python"))?))
}

/// Creates a virtual environment in `folder`, in place of an earlier one. Returns its Python.
pub fn environment(folder: &Path) -> Result<PathBuf> {
    command::run(system()?.args(["-m", "venv", "--clear"]).arg(folder))
        .context("python3 has no venv; `apt-get install python3-venv` may help")?;
    Ok(folder.join("bin/python"))
}
