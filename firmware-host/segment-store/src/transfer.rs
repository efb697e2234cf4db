//! The interface between the sender of one file and its receiver.

use crate::digest::Digest;

/// What the receiver already has of a file: the length and the digest of its copy, which may be only the beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LocalCopy {
    pub bytes: u64,
    pub digest: Digest,
}

impl LocalCopy {
    /// The receiver has no byte of the file.
    #[must_use]
    pub fn none() -> Self {
        Self { bytes: 0, digest: Digest::of(b"") }
    }
}

/// Receives the bytes of one file.
pub trait FileSink<E> {
    /// Announces the bytes from offset `from` to `length`, the length of the whole file. `from` is 0 when the receiver's copy is
    /// not the beginning of the file.
    fn start(&mut self, from: u64, length: u64) -> Result<(), E>;

    /// Delivers the next bytes, which begin at offset `at`.
    fn data(&mut self, at: u64, bytes: &[u8]) -> Result<(), E>;

    /// Reports that the sender is still comparing a long local copy, so that the receiver does not time out.
    fn comparing(&mut self) -> Result<(), E>;
}
