//! What can go wrong between a robot's buffer and a workstation.

use std::io;
use std::path::PathBuf;

use crate::name::BadName;
use crate::wire::{Refusal, WireError};

/// What to do about a [`BufferError`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The connection failed: what was pulled is kept, and another try goes on from there.
    Link,
    /// This computer's disk refuses.
    Disk,
    /// The other side refuses or breaks the rules: trying again changes nothing.
    Refused,
    /// What was asked for cannot be.
    Usage,
}

/// Why something about a buffer failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BufferError {
    /// A buffer's directory or file cannot be read.
    #[error("cannot read {}: {source}; give the directory that holds the robot's runs, or one run", path.display())]
    Read {
        /// Directory or file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The destination cannot be written.
    #[error(
        "cannot write {}: {source}; free disk space or check permissions there; what is complete is kept, and the next \
         pull goes on from there",
        path.display()
    )]
    Write {
        /// File or directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file is there already.
    #[error("{} is there already and is not written over; choose another --out", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Another pull is at work.
    #[error("another pull writes into {}; wait until it has ended, or choose another destination", dir.display())]
    Busy {
        /// The destination.
        dir: PathBuf,
    },
    /// The connection cannot be made or broke off.
    #[error(
        "connection to {to}: {source}; what is there is kept, and the next pull goes on from there"
    )]
    Link {
        /// Whom.
        to: String,
        /// Why.
        source: io::Error,
    },
    /// Nothing came for too long.
    #[error(
        "nothing came from {from} for {seconds} s; check the network; the next pull goes on from where this one ended"
    )]
    Stalled {
        /// Whom.
        from: String,
        /// For how long.
        seconds: u64,
    },
    /// The other side ended before it said anything.
    #[error(
        "{from} ended before it said anything{status}; what it says itself stands above; check that firmware-host is \
         installed there, or say where with --remote-command"
    )]
    Silent {
        /// Whom.
        from: String,
        /// How it ended, if that is known.
        status: String,
    },
    /// ssh itself failed.
    #[error(
        "ssh did not get through to {host} ({status}); its own words stand above; try `ssh {host} true`"
    )]
    Unreached {
        /// Whom.
        host: String,
        /// How it ended.
        status: String,
    },
    /// The other side does not speak the protocol.
    #[error("{from}: {source}")]
    Protocol {
        /// Whom.
        from: String,
        /// What came.
        source: WireError,
    },
    /// The other side says no.
    #[error("{from} refuses: {refusal}")]
    Refused {
        /// Whom.
        from: String,
        /// Its words.
        refusal: Refusal,
    },
    /// An object store cannot be used as it is asked to.
    #[error("{url}: {detail}")]
    Store {
        /// Which.
        url: String,
        /// What is wrong, and the way out.
        detail: String,
    },
    /// What arrived is not what was sent.
    #[error(
        "{name} arrived with another digest than it was sent with and was thrown away; pull again; check the link and the memory"
    )]
    Digest {
        /// The file.
        name: String,
    },
    /// A name that could lead elsewhere.
    #[error("{0}; nothing was written")]
    Name(#[from] BadName),
    /// Not a segment.
    #[error("{}: {detail}", path.display())]
    Segment {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        detail: String,
    },
    /// A source or option that cannot be.
    #[error("{0}")]
    Usage(String),
}

impl BufferError {
    /// What to do about it.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self {
            Self::Link { .. } | Self::Stalled { .. } | Self::Digest { .. } => Kind::Link,
            // A frame that cannot be: the link broke it, or the other side is hostile. Another try tells which.
            Self::Protocol { source, .. } if !source.is_foreign() => Kind::Link,
            Self::Refused { refusal, .. } if refusal.passes() => Kind::Link,
            Self::Write { .. } | Self::Exists { .. } | Self::Busy { .. } => Kind::Disk,
            Self::Refused { .. }
            | Self::Protocol { .. }
            | Self::Name(_)
            | Self::Silent { .. }
            | Self::Unreached { .. }
            | Self::Store { .. } => Kind::Refused,
            Self::Read { .. } | Self::Segment { .. } | Self::Usage(_) => Kind::Usage,
        }
    }

    pub(crate) fn read(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Read { path, source }
    }

    pub(crate) fn write(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Write { path, source }
    }
}
