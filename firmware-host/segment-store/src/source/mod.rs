//! Where segments come from.

mod directory;
mod remote;
mod spec;
mod ssh;
mod ssh_config;

use crate::catalogue::Entry;
use crate::digest::Digest;
use crate::error::BufferError;
use crate::name::Name;
use crate::send::{Have, Receive};

pub use directory::Directory;
pub use remote::Remote;
pub use spec::{Place, Spec, is_store};
pub use ssh::{Ssh, SshOptions};

/// A robot's buffer, wherever it is.
pub trait Source: Send {
    /// What is there.
    ///
    /// # Errors
    /// When it cannot be read or reached.
    fn list(&mut self) -> Result<Vec<Entry>, BufferError>;

    /// Roughly so many bytes will be fetched: the way they come may be chosen by that.
    fn expect(&mut self, bytes: u64) {
        let _ = bytes;
    }

    /// Hands `to` the bytes of a file behind what it has, and gives the digest of the whole as the sender computed it. `None`:
    /// nobody there computes one, and the segment's own checksums must vouch for it.
    ///
    /// # Errors
    /// When the file or the link fails, or `to` does.
    fn fetch(
        &mut self,
        name: &Name,
        have: Have,
        to: &mut dyn Receive<BufferError>,
    ) -> Result<Option<Digest>, BufferError>;

    /// Tells the robot that the segment is safe here, so that it may delete it.
    ///
    /// # Errors
    /// When the robot refuses or cannot be reached.
    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), BufferError>;
}
