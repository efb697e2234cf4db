//! Marks: files beside a segment, seen by everyone who lists the directory.
//!
//! `SEGMENT.pulled` says that a workstation has the segment: its digest, size in bytes and time of its last change
//! (nanoseconds since 1970), one line. A segment that has changed since then is not pulled. `SEGMENT.keep` is empty: the
//! recorder's quota never deletes that segment.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use crate::digest::Digest;
use crate::name::Name;
use crate::root::{Root, read_small, write_small};

/// Whether a workstation has a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pulled {
    /// No mark.
    No,
    /// There is a mark, but of other contents.
    Stale,
    /// As it is, with this digest.
    Yes(Digest),
}

impl Pulled {
    /// The mark of a segment of `bytes` bytes, last changed at `modified_ns`.
    #[must_use]
    pub fn text(digest: &Digest, bytes: u64, modified_ns: u64) -> String {
        format!("{digest} {bytes} {modified_ns}\n")
    }

    /// What a mark says about a segment that has `bytes` bytes and was last changed at `modified_ns`.
    #[must_use]
    pub fn parse(text: &str, bytes: u64, modified_ns: u64) -> Self {
        let mut words = text.split_ascii_whitespace();
        let digest = words.next().and_then(|word| word.parse().ok());
        let mut number = || words.next().and_then(|word| word.parse::<u64>().ok());
        match (digest, number(), number()) {
            (Some(digest), Some(b), Some(m)) if (b, m) == (bytes, modified_ns) => Self::Yes(digest),
            _ => Self::Stale,
        }
    }
}

/// Behind a segment's name: a workstation has it.
pub const PULLED: &str = ".pulled";
/// Behind a segment's name: it is never deleted.
pub const KEEP: &str = ".keep";

/// Marks a segment as one that the recorder never deletes.
///
/// # Errors
/// When the mark cannot be written.
pub fn keep(root: &Root, name: &Name) -> io::Result<()> {
    write_small(root.folder(name.run())?.as_fd(), &format!("{}{KEEP}", name.file()), "")
}

/// Marks a segment of `bytes` bytes, last changed at `modified_ns`, as pulled.
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

/// Reads the mark of a segment that has `bytes` bytes and was last changed at `modified_ns`.
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
    fn a_mark_holds_for_the_contents_that_were_pulled_and_no_others() {
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
    fn a_mark_never_writes_through_a_link() {
        let (dir, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
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
