//! Errors of the model store.

use std::io;
use std::path::PathBuf;

/// The kind of a [`StoreError`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum StoreErrorKind {
    /// The disk cannot be read or written.
    Disk,
    /// A file of the store is damaged.
    Damaged,
    /// There is no such model.
    Missing,
}

/// An error of the model store.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The folder cannot be used.
    #[error("the model store {} cannot be used: {source}; check the path, its permissions and the free space on the disk", dir.display())]
    Folder { dir: PathBuf, source: io::Error },
    /// A file cannot be written. The store is unchanged or, if only the last sync failed,
    /// completely changed.
    #[error("cannot write {}: {source}; free space on the disk or check the permissions, run `firmware-host model list` to see the current state, and try again", path.display())]
    Write { path: PathBuf, source: io::Error },
    /// The file that says which model is current is damaged.
    #[error("{} is damaged ({reason}); `firmware-host model rollback` restores it from the intact models", path.display())]
    State { path: PathBuf, reason: String },
    /// A model is missing, or its content does not match the digest in its name.
    #[error("the model {digest} is missing or damaged in {}; `firmware-host model rollback` goes back to the one before it", dir.display())]
    Model { digest: String, dir: PathBuf },
    /// A model has no signature.
    #[error("the model {digest} in {} has no signature and did not come with the program; install it with `firmware-host model install`", dir.display())]
    Unsigned { digest: String, dir: PathBuf },
    /// A rollback was requested, but no model is installed.
    #[error("there is no model in {} to roll back: the robot already uses depth that needs no network", dir.display())]
    Empty { dir: PathBuf },
}

impl StoreError {
    #[must_use]
    pub fn kind(&self) -> StoreErrorKind {
        match self {
            Self::Folder { .. } | Self::Write { .. } => StoreErrorKind::Disk,
            Self::State { .. } | Self::Model { .. } | Self::Unsigned { .. } => {
                StoreErrorKind::Damaged
            }
            Self::Empty { .. } => StoreErrorKind::Missing,
        }
    }
}
