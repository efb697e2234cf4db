//! The workstation's side: brings what is new of a buffer into a directory, whole and verified.
//!
//! A file grows as `NAME.part`, is compared with the digest that the sender computed, synced, and renamed; only then the
//! robot is told. Whatever ends a pull, the next one goes on from the last byte. What is complete is written down in
//! `pulled.json` and never read again while its size and time stay the same.

mod disk;
mod index;
mod order;
mod pace;
mod part;
mod puller;

use crate::digest::Digest;
use crate::name::Name;

pub use disk::{Disk, FileSystem, PartFile};
pub use index::{INDEX_FILE, Indexed};
pub use order::Order;
pub use pace::Pace;
pub use puller::{Destination, pull};

/// What is pulled, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Options {
    /// What comes first.
    pub order: Order,
    /// Bytes a second; `None` for as fast as it goes.
    pub limit: Option<u64>,
    /// Leave no mark on the robot.
    pub no_mark: bool,
}

/// Is told how a pull goes.
pub trait Watch {
    /// So much is there to do, and so much is done already.
    fn planned(&mut self, files: u64, bytes: u64, done: u64) {
        let _ = (files, bytes, done);
    }
    /// A file of `bytes` begins, of which `have` are here.
    fn begins(&mut self, name: &Name, bytes: u64, have: u64) {
        let _ = (name, bytes, have);
    }
    /// So many bytes more arrived.
    fn arrived(&mut self, bytes: u64) {
        let _ = bytes;
    }
    /// A file is complete.
    fn complete(&mut self, name: &Name, digest: &Digest) {
        let _ = (name, digest);
    }
    /// Something that does not end the pull.
    fn warns(&mut self, text: &str) {
        let _ = text;
    }
}

/// Watches nothing.
impl Watch for () {}

/// What came of a pull.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Report {
    /// Files that are complete now and were not before.
    pub files: u64,
    /// Bytes that came over the link.
    pub bytes: u64,
    /// Files that were here already.
    pub there: u64,
    /// Segments that are still being written; they come when they are closed.
    pub open: u64,
    /// Segments among the new ones that have no end; `firmware-host buffer recover` makes them whole.
    pub cut: u64,
    /// Segments that the robot could not mark as pulled.
    pub unmarked: u64,
}
