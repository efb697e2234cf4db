//! Errors of recording.

use std::io;
use std::path::PathBuf;

use runtime::recording::RecordingError;

/// Why a run cannot be recorded, or not any further. A simulated run then ends with `output_failed`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// The output directory cannot be created or read.
    #[error("cannot use output directory {}: {source}; choose another with --out", dir.display())]
    Directory { dir: PathBuf, source: io::Error },
    /// The directory holds a recording already.
    #[error("{} exists already; choose another --out, or move the old run away", path.display())]
    HoldsRecording {
        /// A segment of the old recording.
        path: PathBuf,
    },
    /// A segment cannot be created.
    #[error("cannot create {}: {source}; free disk space, check permissions, or choose another --out", path.display())]
    Create { path: PathBuf, source: io::Error },
    /// A segment cannot be written.
    #[error(
        "cannot write {}: {source}; the ticks before are kept; free disk space or choose another --out",
        path.display()
    )]
    Write { path: PathBuf, source: io::Error },
    /// A tick cannot be recorded exactly, so it could not be replayed.
    #[error("cannot record into {}: {source}", path.display())]
    Content { path: PathBuf, source: RecordingError },
    /// The recording thread could not be started, or it has ended.
    #[error("the recording thread is not running: {0}")]
    Thread(String),
}

impl RecordError {
    pub(super) fn writing(path: PathBuf, error: RecordingError) -> Self {
        match error {
            RecordingError::Io(source) => Self::Write { path, source },
            source => Self::Content { path, source },
        }
    }
}
