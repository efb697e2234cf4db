//! What a pull reports while it runs and when it ends.

use crate::digest::Digest;
use crate::name::Name;

/// Receives the progress of a pull. All methods do nothing by default.
pub trait Progress {
    /// The pull will fetch `files` files; the store holds `bytes` bytes, of which `done` are already here.
    fn planned(&mut self, files: u64, bytes: u64, done: u64) {
        let _ = (files, bytes, done);
    }
    /// The transfer of a file of `bytes` bytes starts, of which `have` are already here.
    fn file_started(&mut self, name: &Name, bytes: u64, have: u64) {
        let _ = (name, bytes, have);
    }
    /// `bytes` more bytes were received.
    fn received(&mut self, bytes: u64) {
        let _ = bytes;
    }
    /// A file is complete and verified.
    fn file_completed(&mut self, name: &Name, digest: &Digest) {
        let _ = (name, digest);
    }
    /// Something went wrong that does not end the pull.
    fn warning(&mut self, text: &str) {
        let _ = text;
    }
}

/// Ignores all progress.
impl Progress for () {}

/// The result of a pull that has ended.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Report {
    /// Files that this pull completed.
    pub files: u64,
    /// Bytes that were received.
    pub bytes: u64,
    /// Files that were already here.
    pub there: u64,
    /// Segments that the robot still writes; a later pull fetches them.
    pub open: u64,
    /// Segments among the new ones that have no end; `firmware-host buffer recover` repairs them.
    pub cut: u64,
    /// Segments for which the robot could not write the `.pulled` marker.
    pub unmarked: u64,
    /// Sentences about the segments and directories that cannot be read at the source and are therefore not pulled.
    pub unread: Vec<String>,
}
