//! Finds ONNX Runtime and loads it at run time. The program is not linked against the library, so a
//! robot without a depth network does not need it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ort::environment::Environment;

/// Names under which the system's dynamic loader may find the library.
const SYSTEM_NAMES: [&str; 2] = ["libonnxruntime.so.1", "libonnxruntime.so"];

/// ONNX Runtime could not be loaded from any known place.
#[derive(Debug, thiserror::Error)]
#[error(
    "ONNX Runtime 1.22 or newer was not found; run `cargo xtask setup`, set ORT_DYLIB_PATH to libonnxruntime.so, or leave out `--model`, which needs it. Tried:\n  {}",
    .tried.join("\n  ")
)]
pub struct OnnxRuntimeMissing {
    /// Every place that was tried, with the reason why loading failed.
    pub tried: Vec<String>,
}

/// Loads ONNX Runtime from the first of these places that has it: the folder of the program, the
/// build's `target/onnxruntime`, and the system's library path. If `ORT_DYLIB_PATH` is set, only
/// that file is tried. A process has one environment: later calls return that of the first call.
///
/// # Errors
/// [`OnnxRuntimeMissing`] with every place that was tried.
pub fn init() -> Result<(Environment, PathBuf), OnnxRuntimeMissing> {
    static LOADED: Mutex<Option<(Environment, PathBuf)>> = Mutex::new(None);
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(loaded) = &*loaded {
        return Ok(loaded.clone());
    }
    let mut tried = Vec::new();
    for library in
        candidates(std::env::var_os("ORT_DYLIB_PATH"), std::env::current_exe().ok().as_deref())
    {
        match load(&library) {
            Ok(environment) => return Ok(loaded.insert((environment, library)).clone()),
            Err(reason) => tried.push(format!("{}: {reason}", library.display())),
        }
    }
    Err(OnnxRuntimeMissing { tried })
}

/// Loads the library by its path, because `ort` panics if it fails to load it implicitly.
fn load(library: &Path) -> Result<Environment, String> {
    let builder = ort::init_from(library).map_err(|error| error.to_string())?;
    builder
        .with_name("embodied-depth")
        .with_telemetry(false)
        .build()
        .map_err(|error| error.to_string())
}

/// Files and library names to try, in order. `variable` is the value of `ORT_DYLIB_PATH`.
fn candidates(variable: Option<OsString>, program: Option<&Path>) -> Vec<PathBuf> {
    if let Some(path) = variable.filter(|path| !path.is_empty()) {
        return vec![path.into()];
    }
    // target/release/firmware-host and target/debug/deps/some-test both find target/onnxruntime.
    let folders =
        program.into_iter().flat_map(|program| program.ancestors().skip(1).take(3).enumerate());
    let mut found: Vec<PathBuf> = folders
        .flat_map(|(level, folder)| {
            let beside = if level == 0 { libraries_in(folder) } else { Vec::new() };
            beside.into_iter().chain(libraries_in(&folder.join("onnxruntime")))
        })
        .collect();
    found.extend(SYSTEM_NAMES.map(PathBuf::from));
    found
}

/// Files named `libonnxruntime.so`, with or without a version suffix, newest version first.
fn libraries_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let mut libraries: Vec<_> =
        entries.map(|entry| entry.path()).filter(|path| is_library(path)).collect();
    libraries.sort();
    libraries.reverse();
    libraries
}

fn is_library(path: &Path) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    name == "libonnxruntime.so" || name.starts_with("libonnxruntime.so.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variable_is_the_only_place_when_it_is_set() {
        let program = Path::new("/opt/robot/firmware-host");
        assert_eq!(
            candidates(Some("/x/libonnxruntime.so".into()), Some(program)),
            [PathBuf::from("/x/libonnxruntime.so")]
        );
        assert_eq!(candidates(Some(OsString::new()), None), SYSTEM_NAMES.map(PathBuf::from));
    }

    #[test]
    fn libraries_beside_the_program_come_before_the_builds_and_the_systems() {
        let root = tempfile::tempdir().unwrap();
        let [binaries, installed] = ["release", "onnxruntime"].map(|name| root.path().join(name));
        for folder in [&binaries, &installed] {
            std::fs::create_dir(folder).unwrap();
            std::fs::write(folder.join("libonnxruntime.so.1.31.1"), []).unwrap();
            std::fs::write(folder.join("libonnxruntime_providers_shared.so"), []).unwrap();
        }
        let found = candidates(None, Some(&binaries.join("firmware-host")));
        assert_eq!(found[0], binaries.join("libonnxruntime.so.1.31.1"));
        assert_eq!(found[1], installed.join("libonnxruntime.so.1.31.1"));
        assert_eq!(found[2..], SYSTEM_NAMES.map(PathBuf::from));
    }

    #[test]
    fn a_file_that_is_no_library_is_an_error_and_not_a_panic() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "not a library").unwrap();
        assert!(load(file.path()).is_err());
        assert!(load(Path::new("/nowhere/libonnxruntime.so")).is_err());
    }

    #[test]
    fn the_library_is_loaded_once_for_the_whole_process() {
        // `cargo xtask setup` installs it; `cargo xtask test` always does.
        let first = init().unwrap();
        let second = init().unwrap();
        assert_eq!(first.1, second.1);
    }

    #[test]
    fn the_error_names_the_places_and_the_ways_out() {
        let text = OnnxRuntimeMissing {
            tried: vec!["/a: no such file".to_owned(), "/b: too old".to_owned()],
        }
        .to_string();
        for word in [
            "cargo xtask setup",
            "ORT_DYLIB_PATH",
            "leave out `--model`",
            "/a: no such file",
            "/b: too old",
        ] {
            assert!(text.contains(word), "{text}");
        }
    }
}
