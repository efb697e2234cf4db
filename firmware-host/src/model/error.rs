//! Why the store of models cannot do something.

use std::io;
use std::path::PathBuf;

/// What kind of thing went wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum StoreErrorKind {
    /// The disk.
    Disk,
    /// The store's own files.
    Damaged,
    /// What was asked for is not there.
    Missing,
}

/// Why the store of models cannot do something.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The folder cannot be used.
    #[error("the model store {} cannot be used: {source}; check the path, its rights and the room on the disk", dir.display())]
    Folder {
        /// The folder.
        dir: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A file cannot be written. The store is as it was or, where only the last sync failed, as it was to become.
    #[error("cannot write {}: {source}; make room on the disk or check its rights, see `firmware-host model list`, and try again", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The file that says which model is current is damaged.
    #[error("{} is damaged ({reason}); `firmware-host model rollback` writes it anew from the models that are whole", path.display())]
    State {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A model is missing or is not what its name says.
    #[error("the model {digest} is missing or damaged in {}; `firmware-host model rollback` goes back to the one before it", dir.display())]
    Model {
        /// Its digest.
        digest: String,
        /// The store.
        dir: PathBuf,
    },
    /// Nothing to go back from.
    #[error("there is no model in {}: the robot drives with coarse depth already", dir.display())]
    Empty {
        /// The store.
        dir: PathBuf,
    },
}

impl StoreError {
    /// What kind of thing went wrong.
    #[must_use]
    pub fn kind(&self) -> StoreErrorKind {
        match self {
            Self::Folder { .. } | Self::Write { .. } => StoreErrorKind::Disk,
            Self::State { .. } | Self::Model { .. } => StoreErrorKind::Damaged,
            Self::Empty { .. } => StoreErrorKind::Missing,
        }
    }
}
