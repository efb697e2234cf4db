//! The safety plane as a crate of its own, under the target directory.
//!
//! `safety/` needs only `hal`, the words of `event.rs` and `snapshot.rs`. A build of it with its tests costs two seconds; one of all
//! of `runtime`, for each of hundreds of mutants, would take days.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::paths;

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

/// Copies it, as it is now, into a folder of this name; its path.
pub fn make(name: &str) -> Result<PathBuf> {
    let to = paths::target().join(name);
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
    Ok(to)
}

fn copy_tests_and_all(from: &Path, to: &Path) -> Result<()> {
    for entry in fs::read_dir(from)? {
        let path = entry?.path();
        // A shallower search than in the ordinary tests: what only the deep one notices is listed as missed.
        let text =
            fs::read_to_string(&path)?.replace("const DEPTH: u32 = 8;", "const DEPTH: u32 = 5;");
        fs::write(to.join(path.file_name().unwrap_or_default()), text)?;
    }
    Ok(())
}
