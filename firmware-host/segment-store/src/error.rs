//! Errors of a store and of the transfer between a robot and a workstation.

use std::io;
use std::path::PathBuf;

use crate::name::BadName;
use crate::wire::{Refusal, WireError};

/// What a caller can do about a [`StoreError`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// The connection failed. What was received is kept; retrying resumes there.
    Link,
    /// The local disk rejected a write.
    Disk,
    /// The peer refused the request or violated the protocol; retrying does not help.
    Refused,
    /// The arguments or the input files are wrong.
    Usage,
}

/// Why an operation on a store failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// A file or directory of a store cannot be read.
    #[error(
        "cannot read {}: {source}; give the directory that contains the robot's runs, or the directory of one run",
        path.display()
    )]
    Read { path: PathBuf, source: io::Error },
    /// A file or directory of the destination cannot be written.
    #[error(
        "cannot write {}: {source}; free disk space or check the permissions; complete files are kept, and the next pull \
         resumes there",
        path.display()
    )]
    Write { path: PathBuf, source: io::Error },
    /// The output of an export or a recovery exists already.
    #[error("{} is there already and is not overwritten; choose another --out", path.display())]
    Exists { path: PathBuf },
    /// Another pull holds the destination's lock.
    #[error(
        "another pull writes into {}; wait until it has ended, or choose another destination",
        dir.display()
    )]
    Busy { dir: PathBuf },
    /// The connection cannot be made, or it broke.
    #[error(
        "connection to {to}: {source}; what was received is kept, and the next pull resumes there"
    )]
    Link { to: String, source: io::Error },
    /// No data arrived within the time limit.
    #[error(
        "received nothing from {from} for {seconds} s; check the network; the next pull resumes where this one ended"
    )]
    Stalled { from: String, seconds: u64 },
    /// The peer closed the connection before it sent anything.
    #[error(
        "{from} ended without an answer{status}; its own messages are above; check that firmware-host is installed there, \
         or give its path with --program"
    )]
    Silent {
        from: String,
        /// The peer's exit status in parentheses, or empty if it is unknown.
        status: String,
    },
    /// The ssh program itself failed, as its exit status 255 says.
    #[error(
        "ssh could not connect to {host} ({status}); its own messages are above; try `ssh {host} true`"
    )]
    Unreached { host: String, status: String },
    /// The peer sent something that is not a valid message.
    #[error("{from}: {source}")]
    Protocol { from: String, source: WireError },
    /// The peer refused a request.
    #[error("{from} refuses: {refusal}")]
    Refused { from: String, refusal: Refusal },
    /// An object store rejected a request; `detail` includes what to do about it.
    #[error("{url}: {detail}")]
    ObjectStore { url: String, detail: String },
    /// The digest of the received bytes differs from that of the sender.
    #[error(
        "{name} arrived with another digest than it was sent with and was deleted; pull again; check the link and the memory"
    )]
    Digest { name: String },
    /// A name that does not denote a segment, and that could lead out of the store.
    #[error("{0}; nothing was written")]
    Name(#[from] BadName),
    /// A file is not a segment, or its contents cannot be exported.
    #[error("{}: {detail}", path.display())]
    Segment { path: PathBuf, detail: String },
    /// A source or an option is invalid.
    #[error("{0}")]
    Usage(String),
}

impl StoreError {
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Link { .. } | Self::Stalled { .. } | Self::Digest { .. } => ErrorKind::Link,
            // Either the link damaged the frame or the peer is hostile; a retry tells which.
            Self::Protocol { source, .. } if !source.is_foreign() => ErrorKind::Link,
            Self::Refused { refusal, .. } if refusal.is_temporary() => ErrorKind::Link,
            Self::Write { .. } | Self::Exists { .. } | Self::Busy { .. } => ErrorKind::Disk,
            Self::Refused { .. }
            | Self::Protocol { .. }
            | Self::Name(_)
            | Self::Silent { .. }
            | Self::Unreached { .. }
            | Self::ObjectStore { .. } => ErrorKind::Refused,
            Self::Read { .. } | Self::Segment { .. } | Self::Usage(_) => ErrorKind::Usage,
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
