//! `cargo xtask dist`: the Debian package for the robot's computer, in `target/dist`, and a trial of what is in it.

mod cross;
pub mod package;
mod trial;

use std::path::PathBuf;

use anyhow::Result;
use clap::ValueEnum;

use crate::{command, paths};

/// What the robot's computer is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Arch {
    /// 64-bit PC.
    #[value(name = "x86_64")]
    X86,
    /// 64-bit ARM.
    #[value(name = "aarch64")]
    Arm,
}

impl Arch {
    /// What this computer is.
    pub fn of_this_computer() -> Self {
        if Self::Arm.is_this_computers() { Self::Arm } else { Self::X86 }
    }

    /// As Rust, Linux and wheels call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::X86 => "x86_64",
            Self::Arm => "aarch64",
        }
    }

    /// As Debian calls it.
    pub fn debian(self) -> &'static str {
        match self {
            Self::X86 => "amd64",
            Self::Arm => "arm64",
        }
    }

    pub fn is_this_computers(self) -> bool {
        self.name() == std::env::consts::ARCH
    }
}

/// Builds the package for `arch`; without one, for computers like this one.
pub fn run(arch: Option<Arch>) -> Result<()> {
    let arch = arch.unwrap_or_else(Arch::of_this_computer);
    let program = if arch.is_this_computers() { build()? } else { cross::build(arch)? };
    let package = package::make(arch, &program, &paths::target().join("dist"))?;
    trial::run(arch, &package)?;
    println!(
        "\n{}: `apt install ./NAME.deb` on the robot; docs/install.md goes on from there",
        package.display()
    );
    Ok(())
}

/// The robot's program has no simulator. Its folder is not that of other builds, whose program has one.
fn build() -> Result<PathBuf> {
    let folder = paths::target().join("package");
    let arguments = "build --locked --release --package firmware-host --no-default-features";
    let mut cargo = command::cargo();
    cargo.args(arguments.split_whitespace()).arg("--target-dir").arg(&folder);
    command::run(&mut cargo)?;
    Ok(folder.join("release/firmware-host"))
}
