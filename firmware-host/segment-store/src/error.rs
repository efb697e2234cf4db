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
    #[error("cannot read {}: {source}{}", path.display(), how_to_read(source))]
    Read { path: PathBuf, source: io::Error },
    /// A file or directory of the destination cannot be written.
    #[error(
        "cannot write {}: {source}; free disk space or check the permissions; complete files are kept, and the next pull \
         resumes there",
        path.display()
    )]
    Write { path: PathBuf, source: io::Error },
    /// The output of an export or a recovery cannot be written.
    #[error(
        "cannot write {}: {source}; create the folder, free space, or choose another --out",
        path.display()
    )]
    Output { path: PathBuf, source: io::Error },
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
    /// A segment that the source cannot read, unlike others: which one, why, and what to do.
    #[error("{0}")]
    Unread(String),
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
            Self::Write { .. } | Self::Output { .. } | Self::Exists { .. } | Self::Busy { .. } => {
                ErrorKind::Disk
            }
            Self::Refused { .. }
            | Self::Unread(_)
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

    pub(crate) fn output(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Output { path, source }
    }
}

/// What to do about a file or directory of a store that cannot be read.
fn how_to_read(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::PermissionDenied => {
            "; run this as the account that recorded it (on a robot: `sudo -u embodied-depth ...`)"
        }
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
            "; give the directory that contains the robot's runs, or the directory of one run"
        }
        // Our own sentences.
        io::ErrorKind::Other | io::ErrorKind::InvalidInput => "",
        _ => "; check the disk",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(kind: io::ErrorKind) -> String {
        StoreError::read("runs/monday")(kind.into()).to_string()
    }

    #[test]
    fn a_store_of_another_account_names_the_account_and_not_another_directory() {
        let said = read(io::ErrorKind::PermissionDenied);
        assert!(said.starts_with("cannot read runs/monday: permission denied"), "{said}");
        assert!(said.contains("sudo -u embodied-depth") && !said.contains("directory"), "{said}");
        let said = read(io::ErrorKind::NotFound);
        assert!(said.contains("give the directory"), "{said}");
    }

    #[test]
    fn an_output_that_cannot_be_written_says_nothing_about_pulling() {
        let error = StoreError::output("nosuchdir/x.mcap")(io::ErrorKind::NotFound.into());
        let said = error.to_string();
        assert!(said.contains("nosuchdir/x.mcap") && said.contains("create the folder"), "{said}");
        assert!(!said.contains("pull"), "{said}");
        assert_eq!(error.kind(), ErrorKind::Disk);
    }
}
