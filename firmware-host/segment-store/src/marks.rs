//! Markers: small files beside a segment.
//!
//! `SEGMENT.pulled` says that a workstation has a copy. It is one line with the segment's digest, its size in bytes and the
//! time of its last modification in nanoseconds since 1970. When the segment has changed since, the marker is stale.
//! `SEGMENT.keep` protects a segment from the recorder's quota. The recorder's own begins with `event:` and says what happened;
//! such segments are protected within a budget. Any other, such as an empty one, is an operator's and protects without limit.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use crate::digest::Digest;
use crate::entry::Pulled;
use crate::name::Name;
use crate::root::{Root, open_regular, read_small, write_small};

/// Suffix of the marker that a workstation has a copy.
pub const PULLED: &str = ".pulled";
/// Suffix of the marker that protects a segment from deletion.
pub const KEEP: &str = ".keep";

/// Beginning of a marker that the recorder wrote.
const EVENT: &str = "event: ";

/// Protects a segment from deletion by the recorder's quota, because of an event that happened in it or beside it. A marker
/// that is there stays as it is: an operator's protects more.
///
/// # Errors
/// When the marker cannot be written.
pub fn keep_for_event(root: &Root, name: &Name, why: &str) -> io::Result<()> {
    let folder = root.folder(name.run())?;
    let marker = format!("{}{KEEP}", name.file());
    if open_regular(folder.as_fd(), &marker).is_ok() {
        return Ok(());
    }
    write_small(folder.as_fd(), &marker, &format!("{EVENT}{why}\n"))
}

/// Whether the recorder, and not an operator, protects a segment.
#[must_use]
pub fn is_kept_for_event(root: &Root, name: &Name) -> bool {
    let marker = format!("{}{KEEP}", name.file());
    let text = root.folder(name.run()).ok().and_then(|folder| read_small(folder.as_fd(), &marker));
    text.is_some_and(|text| text.starts_with(EVENT))
}

/// Writes the `.pulled` marker of a segment that has `bytes` bytes and was last modified at `modified_ns`.
pub(crate) fn set_pulled(
    root: &Root,
    name: &Name,
    digest: &Digest,
    bytes: u64,
    modified_ns: u64,
) -> io::Result<()> {
    let text = Pulled::text(digest, bytes, modified_ns);
    write_small(root.folder(name.run())?.as_fd(), &format!("{}{PULLED}", name.file()), &text)
}

/// Reads the `.pulled` marker of a segment that has `bytes` bytes and was last modified at `modified_ns`.
pub(crate) fn read_pulled(
    folder: BorrowedFd<'_>,
    file: &str,
    bytes: u64,
    modified_ns: u64,
) -> Pulled {
    let text = read_small(folder, &format!("{file}{PULLED}")).unwrap_or_default();
    Pulled::parse(&text, bytes, modified_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marker_is_stale_when_the_segments_size_or_time_has_changed() {
        let dir = tempfile::tempdir().unwrap();
        let root = Root::open(dir.path()).unwrap();
        let name = Name::parse("recording_0007.mcap").unwrap();
        let digest = Digest::of(b"contents");
        set_pulled(&root, &name, &digest, 8, 5).unwrap();
        let folder = root.folder("").unwrap();
        assert_eq!(read_pulled(folder.as_fd(), name.file(), 8, 5), Pulled::Yes(digest));
        assert_eq!(read_pulled(folder.as_fd(), name.file(), 9, 5), Pulled::Stale);
        assert_eq!(read_pulled(folder.as_fd(), name.file(), 8, 6), Pulled::Stale);
        std::fs::write(dir.path().join("recording_0007.mcap.pulled"), "touched").unwrap();
        assert_eq!(read_pulled(folder.as_fd(), name.file(), 8, 5), Pulled::Stale);
    }

    #[test]
    fn an_event_never_weakens_the_protection_by_an_operator() {
        let dir = tempfile::tempdir().unwrap();
        let root = Root::open(dir.path()).unwrap();
        let name = Name::parse("recording_0007.mcap").unwrap();
        let marker = dir.path().join("recording_0007.mcap.keep");
        std::fs::write(&marker, "").unwrap();
        keep_for_event(&root, &name, "contact").unwrap();
        assert!(!is_kept_for_event(&root, &name));
        std::fs::remove_file(&marker).unwrap();
        keep_for_event(&root, &name, "contact").unwrap();
        assert!(is_kept_for_event(&root, &name));
    }

    #[test]
    fn a_marker_is_never_written_through_a_symbolic_link() {
        let dir = tempfile::tempdir().unwrap();
        let elsewhere = tempfile::tempdir().unwrap();
        let victim = elsewhere.path().join("victim");
        std::fs::write(&victim, "precious").unwrap();
        for link in ["recording_0000.mcap.pulled", ".recording_0000.mcap.pulled.partial"] {
            std::os::unix::fs::symlink(&victim, dir.path().join(link)).unwrap();
        }
        let root = Root::open(dir.path()).unwrap();
        set_pulled(&root, &Name::parse("recording_0000.mcap").unwrap(), &Digest::of(b""), 0, 0)
            .unwrap();
        assert_eq!(std::fs::read_to_string(&victim).unwrap(), "precious");
    }
}
