//! The stop that needs a person, on disk: a robot that was stopped by its emergency stop does not
//! move because its program, or the computer, was started again.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use super::status::unix_s;
use crate::report::atomic::{prepare_dir, write_atomically};

/// What the file contains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LastStop {
    /// The reason, in words.
    pub why: String,
    /// Time of the stop, seconds since 1970.
    pub unix_s: f64,
}

/// The file of the last stop.
#[derive(Debug, Clone)]
pub struct StopFile {
    path: PathBuf,
}

impl StopFile {
    /// The file at this path. Returns also the stop after which a person has to arm the robot, if
    /// there is one. A file that cannot be read, or a folder that cannot be written, is such a stop:
    /// the robot must not move on its own if it cannot remember why it stopped.
    #[must_use]
    pub fn open(path: &Path) -> (Self, Option<LastStop>) {
        let file = Self { path: path.to_owned() };
        let last = file.read().unwrap_or_else(|error| {
            Some(LastStop { why: format!("{error:#}; see run.stop_file"), unix_s: unix_s() })
        });
        (file, last)
    }

    fn read(&self) -> Result<Option<LastStop>> {
        let path = &self.path;
        if let Some(folder) = path.parent() {
            prepare_dir(folder)?;
        }
        match std::fs::read_to_string(path) {
            Ok(text) => serde_json::from_str(&text)
                .map(Some)
                .with_context(|| format!("{} does not contain a stop", path.display())),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
        }
    }

    /// Remembers a stop.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn remember(&self, why: &str) -> Result<()> {
        let stop = LastStop { why: why.to_owned(), unix_s: unix_s() };
        let json = serde_json::to_vec_pretty(&stop)?;
        write_atomically(&self.path, &json)
            .with_context(|| format!("cannot remember the stop in {}", self.path.display()))
    }

    /// Forgets the stop, because a person armed the robot.
    ///
    /// # Errors
    /// When the file exists and cannot be removed.
    pub fn forget(&self) -> Result<()> {
        match std::fs::remove_file(&self.path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(error).with_context(|| format!("cannot remove {}", self.path.display()))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_remembered_until_it_is_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state/last_stop.json");
        let (file, last) = StopFile::open(&path);
        assert_eq!(last, None);
        file.remember("emergency stop").unwrap();
        let (file, last) = StopFile::open(&path);
        assert_eq!(last.unwrap().why, "emergency stop");
        file.forget().unwrap();
        file.forget().unwrap();
        assert_eq!(StopFile::open(&path).1, None);
    }

    #[test]
    fn a_file_that_cannot_be_read_or_written_counts_as_a_stop() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("last_stop.json");
        std::fs::write(&path, "{").unwrap();
        let (_, last) = StopFile::open(&path);
        assert!(last.unwrap().why.contains("does not contain a stop"));
        let (_, last) = StopFile::open(&path.join("below a file"));
        assert!(last.unwrap().why.contains("run.stop_file"));
    }
}
