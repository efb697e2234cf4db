//! `cargo xtask dist`: builds the Debian package for the robot's computer in `target/dist`, and tries its content.

mod cross;
pub mod package;
mod trial;

use std::path::PathBuf;

use anyhow::Result;
use clap::ValueEnum;

use crate::{command, paths};

/// Architecture of the robot's computer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Arch {
    /// A 64-bit PC (Debian: amd64).
    #[value(name = "x86_64")]
    X86,
    /// A 64-bit ARM board (Debian: arm64).
    #[value(name = "aarch64")]
    Arm,
}

impl Arch {
    /// The architecture of this computer.
    pub fn of_this_computer() -> Self {
        if Self::Arm.is_this_computers() { Self::Arm } else { Self::X86 }
    }

    /// Its name in Rust, Linux and Python's wheels.
    pub fn name(self) -> &'static str {
        match self {
            Self::X86 => "x86_64",
            Self::Arm => "aarch64",
        }
    }

    /// Its name in Debian.
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

/// Builds the package for `arch`, by default this computer's.
pub fn run(arch: Option<Arch>) -> Result<()> {
    let arch = arch.unwrap_or_else(Arch::of_this_computer);
    let built = if arch.is_this_computers() { build()? } else { cross::build(arch)? };
    let package = package::make(arch, &built, &paths::target().join("dist"))?;
    trial::run(arch, &package)?;
    println!(
        "\n{}: install it on the robot with `apt install ./NAME.deb`; docs/install.md has the next steps",
        package.display()
    );
    Ok(())
}

/// The simulator is a default feature.
const FEATURES: &str = "--no-default-features";
const BUILD: [&str; 4] = ["build", "--locked", "--release", FEATURES];

/// Cargo's arguments for the packages of the programs.
fn packages() -> impl Iterator<Item = &'static str> {
    package::PROGRAMS.iter().flat_map(|program| ["--package", program])
}

/// Builds the robot's programs, without the simulator; returns their folder. Its target directory is its own, so that it does not
/// replace the program of other builds, which has a simulator.
fn build() -> Result<PathBuf> {
    let folder = paths::target().join("package");
    let mut cargo = command::cargo();
    cargo.args(BUILD).args(packages()).arg("--target-dir").arg(&folder);
    command::run(&mut cargo)?;
    Ok(folder.join("release"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names of all crates that a build of the package's programs contains.
    fn crates(features: Option<&str>) -> Vec<String> {
        let mut cargo = command::cargo();
        cargo.args(["tree", "--offline", "--locked", "--edges=normal", "--prefix=none"]);
        cargo.args(["--format={p}"]).args(features).args(packages());
        let text = command::output(&mut cargo).unwrap();
        text.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
    }

    fn has_simulator(features: Option<&str>) -> bool {
        crates(features).iter().any(|name| name == "simulator")
    }

    /// Crates that make keys or sign.
    const SIGNERS: [&str; 3] = ["minisign", "scrypt", "rpassword"];

    #[test]
    fn the_robots_package_contains_no_simulator() {
        assert!(has_simulator(None), "a build that has one is recognized");
        assert!(!has_simulator(Some(FEATURES)));
    }

    #[test]
    fn the_robots_package_verifies_signatures_and_cannot_sign() {
        let packaged = crates(Some(FEATURES));
        assert!(packaged.iter().any(|name| name == "minisign-verify"));
        assert!(!packaged.iter().any(|name| SIGNERS.contains(&name.as_str())));
    }
}
