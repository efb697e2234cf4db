//! The interface of all sources.

use crate::digest::Digest;
use crate::entry::Entry;
use crate::error::StoreError;
use crate::name::Name;
use crate::transfer::{FileSink, LocalCopy};

/// What a store contains.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Listing {
    pub entries: Vec<Entry>,
    /// Sentences about the segments and directories that cannot be read. They are not among the entries.
    pub unread: Vec<String>,
}

/// A store that segments are pulled from.
pub trait Source: Send {
    /// Lists the segments.
    ///
    /// # Errors
    /// When the store cannot be read or reached.
    fn list(&mut self) -> Result<Listing, StoreError>;

    /// Announces that about this many bytes will be fetched, so that the source can choose how to transfer them.
    fn expect(&mut self, bytes: u64) {
        let _ = bytes;
    }

    /// Delivers the bytes of a file that follow the local copy, and returns the digest of the whole file as the sender computed
    /// it. `None` means that the sender does not compute digests: the segment's own checksums must then be verified.
    ///
    /// # Errors
    /// When the file cannot be read, the link fails, or `to` returns an error.
    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError>;

    /// Tells the robot that a copy of the segment exists, so that it may delete its own.
    ///
    /// # Errors
    /// When the robot refuses or cannot be reached.
    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError>;
}
