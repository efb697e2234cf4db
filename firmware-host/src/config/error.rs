//! What is wrong with a configuration file, said so that the user can mend it.

use std::{fmt, path::PathBuf};

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is not TOML, or a value has the wrong type.
    #[error("{}: {message}", path.display())]
    NotToml {
        /// The file.
        path: PathBuf,
        /// Line, column, the line itself and what was expected there.
        message: String,
    },
    /// Keys that do not exist or values that cannot be: all of them, in the order of the file.
    #[error("{}", list(path, problems))]
    Refused {
        /// The file.
        path: PathBuf,
        /// At least one.
        problems: Vec<Problem>,
    },
}

/// One key that does not exist or one value that cannot be.
#[derive(Debug, Clone, PartialEq)]
pub enum Problem {
    /// Nothing has this name.
    UnknownKey {
        /// Its line, counted from 1.
        line: usize,
        /// Its full dotted name.
        key: String,
        /// What to do: a similar key, or the keys that exist there.
        advice: String,
    },
    /// The value is of another type, NaN, infinite, too small or too large.
    Impossible {
        /// Its line, counted from 1.
        line: usize,
        /// Its full dotted name.
        key: String,
        /// As it stands in the file.
        value: String,
        /// What may stand there.
        allowed: String,
    },
    /// Values that are possible one by one, but not together.
    Together {
        /// The keys and what is wrong between them.
        message: String,
    },
}

fn list(path: &std::path::Path, problems: &[Problem]) -> String {
    let lines: Vec<String> =
        problems.iter().map(|problem| InFile(problem, path).to_string()).collect();
    lines.join("\n")
}

struct InFile<'a>(&'a Problem, &'a std::path::Path);

impl fmt::Display for InFile<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.1.display();
        match self.0 {
            Problem::UnknownKey { line, key, advice } => {
                write!(f, "unknown key `{key}` in {path} line {line}: {advice}")
            }
            Problem::Impossible { line, key, value, allowed } => {
                write!(
                    f,
                    "`{key} = {value}` in {path} line {line} is not possible: allowed is {allowed}"
                )
            }
            Problem::Together { message } => write!(f, "{path}: {message}"),
        }
    }
}
