//! What is wrong with a configuration file, in words with which the user can correct it.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}", unreadable(path, source))]
    Unreadable { path: PathBuf, source: io::Error },
    /// The file is not TOML, or serde refused a value.
    #[error("{}: {message}", path.display())]
    NotToml {
        path: PathBuf,
        /// Line, column, the line itself and what was expected there.
        message: String,
    },
    /// `calibration` is not the name of a file.
    #[error("`calibration` in {} line {line} is not the name of a file in quotes, as in calibration = \"calibration.toml\"", path.display())]
    CalibrationKey { path: PathBuf, line: usize },
    /// The file of measured values cannot be read.
    #[error(
        "cannot read the calibration {}, which {} names: {source}; `firmware-host calibrate` writes it; without one, remove the line `calibration`",
        path.display(), named_by.display()
    )]
    NoCalibration { path: PathBuf, named_by: PathBuf, source: io::Error },
    /// No measurement bears out what the safety plane assumes.
    #[error(
        "{}: run.commissioning is \"measured\", but {why}. `firmware-host check --drive --config {}` measures it on the floor; set \"by_hand\" \
         if it was measured in another way", path.display(), path.display()
    )]
    NotCommissioned { path: PathBuf, why: String },
    /// The file has unknown keys or values that are not allowed.
    #[error("{}", list(path, problems))]
    Refused {
        path: PathBuf,
        /// All of them, at least one, in the order of the file.
        problems: Vec<Problem>,
    },
}

/// The hint to write a new file is for a missing one only: it would destroy one that exists.
fn unreadable(path: &Path, source: &io::Error) -> String {
    let path = path.display();
    match source.kind() {
        io::ErrorKind::InvalidData => format!("{path} is not UTF-8; save it as UTF-8"),
        kind => {
            let way_out = match kind {
                io::ErrorKind::NotFound => {
                    "`firmware-host check > robot.toml` writes one to begin with"
                }
                io::ErrorKind::PermissionDenied => "run as an account that may read it",
                _ => "choose another --config",
            };
            format!("cannot read the configuration {path}: {source}; {way_out}")
        }
    }
}

/// The parser's words for a key or a section that is there twice.
const TWICE: &str = "duplicate key";
const TWICE_WAY_OUT: &str = ": the section or the key is above already; write there what is to be added, or give its full name at the \
     top of the file, as `devices.camera.latency_ms = 40`";

impl ConfigError {
    pub(super) fn not_toml(path: &Path, error: &toml::de::Error) -> Self {
        let way_out = if error.message() == TWICE { TWICE_WAY_OUT } else { "" };
        let message = format!("{}{way_out}", error.to_string().trim_end());
        Self::NotToml { path: path.to_path_buf(), message }
    }
}

/// One problem of a file. Lines count from 1; `key` is the full dotted name.
#[derive(Debug, Clone, PartialEq)]
pub enum Problem {
    /// There is no key of this name.
    UnknownKey {
        line: usize,
        key: String,
        /// A similar key, or the keys of the section.
        advice: String,
    },
    /// The key has another name now.
    RenamedKey {
        line: usize,
        key: String,
        /// Its full dotted name now.
        now: String,
    },
    /// The value is of another type, NaN, infinite, too small or too large.
    NotAllowed {
        line: usize,
        key: String,
        /// The value as it is written in the file.
        value: String,
        /// The values that are allowed.
        allowed: String,
    },
    /// Each value is allowed, but not together with the others.
    Together {
        /// The section, the keys and the rule between them.
        message: String,
    },
}

fn list(path: &Path, problems: &[Problem]) -> String {
    let lines: Vec<String> =
        problems.iter().map(|problem| InFile(problem, path).to_string()).collect();
    lines.join("\n")
}

struct InFile<'a>(&'a Problem, &'a Path);

impl fmt::Display for InFile<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.1.display();
        match self.0 {
            Problem::UnknownKey { line, key, advice } => {
                write!(f, "unknown key `{key}` in {path} line {line}: {advice}")
            }
            Problem::RenamedKey { line, key, now } => {
                write!(f, "`{key}` in {path} line {line} is now called `{now}`")
            }
            Problem::NotAllowed { line, key, value, allowed } => {
                write!(
                    f,
                    "`{key} = {value}` in {path} line {line} is not allowed: it must be {allowed}"
                )
            }
            Problem::Together { message } => write!(f, "{path}: {message}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::config::Config;

    #[test]
    fn only_for_a_missing_file_the_refusal_names_the_command_that_writes_a_new_one() {
        let dir = tempfile::tempdir().unwrap();
        let missing = refusal(dir.path(), "robot.toml");
        assert!(missing.contains("check > robot.toml` writes one to begin with"), "{missing}");
        let folder = refusal(dir.path(), "");
        assert!(folder.contains("Is a directory") && !folder.contains('>'), "{folder}");
        std::fs::write(dir.path().join("latin.toml"), b"# caf\xe9\n").unwrap();
        let latin = refusal(dir.path(), "latin.toml");
        assert!(latin.ends_with("latin.toml is not UTF-8; save it as UTF-8"), "{latin}");
    }

    fn refusal(dir: &Path, name: &str) -> String {
        Config::load(&dir.join(name)).unwrap_err().to_string()
    }
}
