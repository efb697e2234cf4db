//! Copies the safety plane into a crate of its own under the target directory.
//!
//! `safety/` needs only `hal`, the types of `event.rs`, and `snapshot.rs`. A build of this crate
//! with its tests takes two seconds. A build of the whole `runtime` crate for each of hundreds of
//! mutants would take days.

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
nalgebra = { version = "0.35", default-features = false, features = ["libm", "alloc"] }
postcard = { version = "1.1", default-features = false, features = ["use-std"] }
thiserror = "2"
[dev-dependencies]
proptest = { version = "1.12", default-features = false, features = ["std"] }
[profile.dev]
debug = false
# A mutant takes 3 s: building it takes 2 s instead of 1 s, and its tests 1 s instead of 4 s.
opt-level = 1
[profile.dev.package."*"]
opt-level = 3
"#;

/// The crate's `lib.rs`. `event.rs` uses types of other modules, which are replaced here.
const LIBRARY: &str = "
pub mod event;
pub mod operator;
pub mod safety;
pub mod snapshot;
pub mod calibration_watch {
    #[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
    pub enum Change {}
}
pub mod perception {
    #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    pub enum NoDepth {}
}
pub mod localization {
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
    pub enum LostReason {}
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
    pub enum WheelError {}
}
";

/// Copies the current sources into the folder `name` under the target directory and returns its
/// path.
pub fn make(name: &str) -> Result<PathBuf> {
    let to = paths::target().join(name);
    let source = paths::root().join("runtime/src");
    fs::create_dir_all(to.join("src/safety"))?;
    let hal = paths::root().join("hal");
    fs::write(to.join("Cargo.toml"), MANIFEST.replace("HAL", &hal.to_string_lossy()))?;
    fs::write(to.join("src/lib.rs"), LIBRARY)?;
    fs::copy(paths::root().join("Cargo.lock"), to.join("Cargo.lock"))?;
    for file in ["event.rs", "operator.rs", "snapshot.rs"] {
        fs::copy(source.join(file), to.join("src").join(file))?;
    }
    copy_safety(&source.join("safety"), &to.join("src/safety"))?;
    Ok(to)
}

fn copy_safety(from: &Path, to: &Path) -> Result<()> {
    for entry in fs::read_dir(from)? {
        let path = entry?.path();
        // The exhaustive search is shallower than in the ordinary tests, to save time. A mutant
        // that only the deeper search detects counts as missed.
        let text =
            fs::read_to_string(&path)?.replace("const DEPTH: u32 = 8;", "const DEPTH: u32 = 5;");
        fs::write(to.join(path.file_name().unwrap_or_default()), text)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What follows `before` at the beginnings of lines, up to the next `::`.
    fn used(text: &str, before: &str) -> Vec<String> {
        let lines = text.lines().filter_map(|line| line.trim_start().strip_prefix(before));
        lines.map(|line| line.split("::").next().unwrap_or_default().to_owned()).collect()
    }

    #[test]
    fn the_crate_has_every_module_and_dependency_that_the_safety_plane_uses() {
        let source = paths::root().join("runtime/src");
        let mut files: Vec<_> = ["event.rs", "operator.rs", "snapshot.rs"]
            .iter()
            .map(|file| source.join(file))
            .collect();
        for entry in fs::read_dir(source.join("safety")).unwrap() {
            files.push(entry.unwrap().path());
        }
        for file in files {
            let text = fs::read_to_string(&file).unwrap();
            for module in used(&text, "use crate::") {
                assert!(LIBRARY.contains(&format!("mod {module}")), "{}: {module}", file.display());
            }
            for package in used(&text, "use ") {
                let is_own = ["crate", "super", "self", "std"].contains(&package.as_str());
                let named = MANIFEST.contains(&format!("\n{package} = "));
                assert!(is_own || named, "{}: {package}", file.display());
            }
        }
    }
}
