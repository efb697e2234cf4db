//! Builds the programs for another architecture with the cross toolchain of Debian 12. Its `rustc-web` is newer than its
//! `rustc`, and has a standard library for every architecture of Debian.

use std::path::PathBuf;
use std::process::Stdio;

use anyhow::{Context, Result, bail};

use super::{Arch, BUILD, packages};
use crate::{command, paths};

const PACKAGES: [&str; 6] = [
    "rustc-web",
    "cargo-web",
    "libstd-rust-web-dev:arm64",
    "gcc-aarch64-linux-gnu",
    "libc6-dev-arm64-cross",
    // The emulator for the trial of the package.
    "qemu-user-static",
];
/// Debian's cargo, because `cargo` on the path is usually that of rustup.
const CARGO: &str = "/usr/bin/cargo";
const RUSTC: &str = "/usr/bin/rustc";

/// Builds the programs and returns their folder. Installs the toolchain if it is missing.
pub fn build(arch: Arch) -> Result<PathBuf> {
    if arch != Arch::Arm {
        bail!(
            "packages for {} can be built on such a computer only: the cross toolchain is for aarch64",
            arch.name()
        );
    }
    install().context("the cross build needs root on Debian 12 once, for apt")?;
    let mut cargo = command::program(CARGO);
    cargo.args(BUILD).args(packages()).args(["--target", "aarch64-unknown-linux-gnu"]);
    // The build has a target directory of its own, because this compiler differs from that of all other builds.
    cargo.arg("--target-dir").arg(paths::target().join("cross"));
    // The environment of this chore is that of another toolchain.
    for variable in ["CARGO", "RUSTUP_TOOLCHAIN", "RUSTC_WRAPPER"] {
        cargo.env_remove(variable);
    }
    cargo.env("RUSTC", RUSTC).env("CC_aarch64_unknown_linux_gnu", "aarch64-linux-gnu-gcc");
    command::run(
        cargo.env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER", "aarch64-linux-gnu-gcc"),
    )?;
    Ok(paths::target().join("cross/aarch64-unknown-linux-gnu/release"))
}

fn install() -> Result<()> {
    let missing: Vec<_> = PACKAGES
        .into_iter()
        .filter(|name| !command::works(command::program("dpkg").args(["-s", name])))
        .collect();
    if missing.is_empty() {
        return Ok(());
    }
    println!("installing {}", missing.join(", "));
    command::run(command::program("dpkg").args(["--add-architecture", "arm64"]))?;
    command::run(command::program("apt-get").args(["-qq", "update"]))?;
    let mut apt = command::program("apt-get");
    apt.args(["-qq", "install", "-y", "--no-install-recommends"]).args(&missing);
    command::run(apt.env("DEBIAN_FRONTEND", "noninteractive").stdout(Stdio::null()))
}
