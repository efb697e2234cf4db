//! Mutants of the safety plane: every small change of it that could be a mistake must fail a test of its own folder.
//!
//! A build of all of `runtime` for each of hundreds of mutants would take days. `safety/` needs only `hal` and the words of
//! `event.rs`, so it is copied into a crate of its own under the target directory, where a mutant costs two seconds.

use std::fs;
use std::path::Path;

use anyhow::Result;

use crate::command;
use crate::paths;

/// The version that is installed where there is none; any other that is already there will do.
const VERSION: &str = "27.1.0";

const MANIFEST: &str = r#"
[workspace]
[package]
name = "safety"
version = "0.0.0"
edition = "2024"
[dependencies]
hal = { path = "HAL", features = ["serde"] }
serde = { version = "1.0", features = ["derive"] }
bytemuck = "1"
postcard = { version = "1.1", default-features = false, features = ["use-std"] }
thiserror = "2"
[dev-dependencies]
proptest = { version = "1.12", default-features = false, features = ["std"] }
[profile.dev]
debug = false
[profile.dev.package."*"]
opt-level = 3
"#;

/// `event.rs` names one type of perception.
const LIBRARY: &str = "
pub mod event;
pub mod safety;
pub mod snapshot;
pub mod perception {
    #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    pub enum NoDepth {}
}
";

/// Runs them all, with the arguments passed on to `cargo mutants`. One core, an hour.
///
/// # Errors
/// When cargo-mutants cannot be installed, and when a mutant survives that is not in `.cargo/mutants.toml`.
pub fn run(arguments: &[String]) -> Result<()> {
    if !command::works(command::cargo().args(["mutants", "--version"])) {
        let mut install = command::cargo();
        install.args(["install", "--quiet", "--locked", "cargo-mutants", "--version", VERSION, "--root"]);
        command::run(install.arg(paths::target().join("tools")))?;
    }
    let to = paths::target().join("mutants");
    let source = paths::root().join("runtime/src");
    fs::create_dir_all(to.join("src/safety"))?;
    let hal = paths::root().join("hal");
    fs::write(to.join("Cargo.toml"), MANIFEST.replace("HAL", &hal.to_string_lossy()))?;
    fs::write(to.join("src/lib.rs"), LIBRARY)?;
    fs::copy(paths::root().join("Cargo.lock"), to.join("Cargo.lock"))?;
    for file in ["event.rs", "snapshot.rs"] {
        fs::copy(source.join(file), to.join("src").join(file))?;
    }
    copy_tests_and_all(&source.join("safety"), &to.join("src/safety"))?;
    let mut mutants = command::cargo();
    // Few random cases and a shallower search: what only they notice is listed as missed.
    mutants.current_dir(&to).env("PROPTEST_CASES", "4").env_remove("RUST_BACKTRACE");
    mutants.args(["mutants", "--in-place", "--file", "src/safety/*.rs", "--timeout", "40", "--cargo-test-arg=--lib"]);
    command::run(mutants.args(arguments))
}

fn copy_tests_and_all(from: &Path, to: &Path) -> Result<()> {
    for entry in fs::read_dir(from)? {
        let path = entry?.path();
        let text = fs::read_to_string(&path)?.replace("const DEPTH: u32 = 8;", "const DEPTH: u32 = 5;");
        fs::write(to.join(path.file_name().unwrap_or_default()), text)?;
    }
    Ok(())
}
