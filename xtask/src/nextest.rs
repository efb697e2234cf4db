//! The test runner: cargo-nextest, which runs every test in a process of its own.

use crate::command;
use crate::paths;

/// The version that is installed if there is none. Any other version that is installed already is used.
const VERSION: &str = "0.9.143";

/// Installs cargo-nextest into the target directory if it is missing. `false`: it cannot be installed; use `cargo test`.
pub fn install() -> bool {
    if is_there() {
        return true;
    }
    eprintln!("installing cargo-nextest {VERSION}, once; this takes some minutes");
    let mut install = command::cargo();
    install.args([
        "install",
        "--quiet",
        "--locked",
        "cargo-nextest",
        "--version",
        VERSION,
        "--root",
    ]);
    install.arg(paths::target().join("tools"));
    if let Err(error) = command::run(&mut install) {
        eprintln!("cargo-nextest cannot be installed ({error:#}); using `cargo test`");
    }
    is_there()
}

fn is_there() -> bool {
    command::works(command::cargo().args(["nextest", "--version"]))
}
