//! Licences, banned crates and sources of all dependencies, by cargo-deny and deny.toml.

use crate::command;
use crate::paths;
use crate::test::{Outcome, step};

/// The version that is installed if there is none. Any other version that is installed already is used.
const VERSION: &str = "0.20.2";

/// Checks all dependencies. With `install`, installs cargo-deny if it is missing. Security advisories are not checked: their
/// database changes independently of this repository, so that a build could fail without a change.
pub fn check(install: bool) -> (Outcome, f64) {
    if !is_there() && install {
        eprintln!("installing cargo-deny {VERSION}, once; this takes some minutes");
        let mut install = command::cargo();
        install.args(["install", "--quiet", "--locked", "cargo-deny", "--version", VERSION]);
        install.arg("--no-default-features").arg("--root").arg(paths::target().join("tools"));
        if let Err(error) = command::run(&mut install) {
            eprintln!("{error:#}");
            return (Outcome::Failed, 0.0);
        }
    }
    if !is_there() {
        return (Outcome::Skipped("`cargo xtask test --all` installs cargo-deny for it"), 0.0);
    }
    step(command::cargo().args(["deny", "check", "bans", "licenses", "sources"]))
}

fn is_there() -> bool {
    command::works(command::cargo().args(["deny", "--version"]))
}
