//! A buffer on this computer: a mounted disk, or the robot itself.

use std::path::Path;

use super::Source;
use crate::catalogue::{Catalogue, Entry};
use crate::digest::Digest;
use crate::error::BufferError;
use crate::name::Name;
use crate::root::Root;
use crate::send::{Have, Receive, SendError, send};
use crate::serve::{MarkError, mark};
use crate::wire::{Refusal, RefusalKind};

/// A directory.
#[derive(Debug)]
pub struct Directory {
    root: Root,
}

impl Directory {
    /// Opens it.
    ///
    /// # Errors
    /// When it is not there.
    pub fn open(path: &Path) -> Result<Self, BufferError> {
        Ok(Self { root: Root::open(path)? })
    }

    fn refused(&self, kind: RefusalKind, text: String) -> BufferError {
        BufferError::Refused {
            from: self.root.path().display().to_string(),
            refusal: Refusal { kind, text },
        }
    }
}

impl Source for Directory {
    fn list(&mut self) -> Result<Vec<Entry>, BufferError> {
        Ok(Catalogue::read(&self.root)?.entries)
    }

    fn fetch(
        &mut self,
        name: &Name,
        have: Have,
        to: &mut dyn Receive<BufferError>,
    ) -> Result<Option<Digest>, BufferError> {
        let path = self.root.path().join(name.as_str());
        let mut file = self.root.open_file(name).map_err(BufferError::read(&path))?;
        match send(&mut file, have, to) {
            Ok(sent) => Ok(Some(sent.digest)),
            Err(SendError::Sink(error)) => Err(error),
            Err(SendError::Read(error)) => Err(BufferError::read(path)(error)),
            Err(SendError::Changed) => Err(self.refused(
                RefusalKind::Changed,
                format!("{name} was written while it was read; pull again"),
            )),
        }
    }

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), BufferError> {
        mark(&self.root, name, *digest, None).map_err(|error| match error {
            MarkError::Changed => {
                self.refused(RefusalKind::Changed, format!("{name} has changed; pull again"))
            }
            MarkError::Disk(error) => self
                .refused(RefusalKind::Disk, format!("{name} cannot be marked as pulled: {error}")),
        })
    }
}
