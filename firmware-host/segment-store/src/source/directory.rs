//! A store in a local directory: a mounted disk, or the robot's own disk.

use std::path::Path;

use super::interface::{Listing, Source};
use crate::catalogue::Catalogue;
use crate::digest::Digest;
use crate::error::StoreError;
use crate::name::Name;
use crate::root::Root;
use crate::send::{SendError, send};
use crate::serve::{MarkError, mark};
use crate::transfer::{FileSink, LocalCopy};
use crate::wire::{Refusal, RefusalKind};

/// A store in a local directory.
#[derive(Debug)]
pub struct Directory {
    root: Root,
}

impl Directory {
    /// # Errors
    /// When the directory cannot be opened.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Ok(Self { root: Root::open(path)? })
    }

    fn refused(&self, kind: RefusalKind, text: String) -> StoreError {
        StoreError::Refused {
            from: self.root.path().display().to_string(),
            refusal: Refusal { kind, text },
        }
    }
}

impl Source for Directory {
    fn list(&mut self) -> Result<Listing, StoreError> {
        let catalogue = Catalogue::read(&self.root)?;
        let unread = catalogue.unread.iter().map(ToString::to_string).collect();
        Ok(Listing { entries: catalogue.entries, unread })
    }

    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        let path = self.root.path().join(name.as_str());
        let mut file = self.root.open_file(name).map_err(StoreError::read(&path))?;
        match send(&mut file, local, to) {
            Ok(sent) => Ok(Some(sent.digest)),
            Err(SendError::Sink(error)) => Err(error),
            Err(SendError::Read(error)) => Err(StoreError::read(path)(error)),
            Err(SendError::Changed) => Err(self.refused(
                RefusalKind::Changed,
                format!("{name} was written while it was read; pull again"),
            )),
        }
    }

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        mark(&self.root, name, *digest, None).map_err(|error| match error {
            MarkError::Changed => {
                self.refused(RefusalKind::Changed, format!("{name} has changed; pull again"))
            }
            MarkError::Disk(error) => self
                .refused(RefusalKind::Disk, format!("{name} cannot be marked as pulled: {error}")),
        })
    }
}
