//! A robot's buffer in an object store: Amazon's S3 and what speaks like it, Google's, Azure's, or a directory.
//!
//! ```text
//! PREFIX/RUN/recording_0007.mcap           a segment
//! PREFIX/RUN/recording_0007.mcap.blake3    its digest, as b3sum writes it; whoever uploads puts it there
//! PREFIX/RUN/recording_0007.mcap.pulled    a workstation has it: its digest, size and time
//! PREFIX/RUN/recording_0007.mcap.keep      a mark for people and for --order valuable
//! ```
//!
//! A store computes no BLAKE3. With `.blake3` beside it a segment is pulled as from a robot: its digest must be that one.
//! Without, every piece must come from one and the same version of the object (its `ETag`), and the segment's own checksums
//! must be right in the end.

mod error;
mod fetch;
mod look;
mod open;
mod upload;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::SystemTime;

use crate::source::Source;
use crate::wire::{Refusal, RefusalKind};
use crate::{BufferError, Catalogue, Digest, Entry, Have, Name, PULLED, Pulled, Receive};
use futures_util::{StreamExt, TryStreamExt};
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt};
use tokio::runtime::Runtime;

use look::{Looked, Seen};

/// No fleet has more objects under one prefix; another's bucket could fill the memory.
const MAX_OBJECTS: usize = 400_000;

/// Segments that are looked into at the same time.
const LOOKS: usize = 32;

/// Everything under a prefix of an object store.
pub struct Bucket {
    url: String,
    /// The only place where something is asynchronous.
    runtime: Runtime,
    store: Arc<dyn ObjectStore>,
    prefix: Path,
    /// Of the last listing; a segment that has not changed is not looked into again.
    looked: BTreeMap<Name, Looked>,
    /// Size and time of the robot's segments that were put here by this program.
    uploaded: BTreeMap<Name, (u64, u64)>,
}

impl Bucket {
    /// The store at `url`, with credentials from the usual environment variables. A request in which nothing comes for
    /// `stall_s` seconds has failed.
    ///
    /// # Errors
    /// When the address makes no sense, or there can be no credentials for it. Nothing is asked of the store yet.
    pub fn open(url: &str, stall_s: u64) -> Result<Self, BufferError> {
        let (store, prefix) = open::store(url, stall_s)?;
        Self::over(store, prefix, url)
    }

    /// What is under `prefix` in `store`; it is called `url` in errors.
    ///
    /// # Errors
    /// When the system gives no event queue.
    pub fn over(store: Arc<dyn ObjectStore>, prefix: Path, url: &str) -> Result<Self, BufferError> {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.map_err(|source| BufferError::Link { to: url.to_owned(), source })?;
        Ok(Self {
            url: url.to_owned(),
            runtime,
            store,
            prefix,
            looked: BTreeMap::new(),
            uploaded: BTreeMap::new(),
        })
    }

    fn explain(&self, error: &Error, doing: &str) -> BufferError {
        error::explain(&self.url, error, doing)
    }

    fn refused(&self, kind: RefusalKind, text: String) -> BufferError {
        BufferError::Refused { from: self.url.clone(), refusal: Refusal { kind, text } }
    }

    fn path_of(&self, name: &str) -> Path {
        name.split('/').fold(self.prefix.clone(), Path::join)
    }

    /// Names, sizes and times of everything there, by what follows the prefix.
    fn names(&self) -> Result<BTreeMap<String, Seen>, Error> {
        let listing = self.store.list(Some(&self.prefix)).take(MAX_OBJECTS).try_collect::<Vec<_>>();
        let objects = self.runtime.block_on(listing)?;
        let relative = |path: &Path| {
            let parts: Vec<_> =
                path.prefix_match(&self.prefix)?.map(|part| part.as_ref().to_owned()).collect();
            Some(parts.join("/"))
        };
        Ok(objects
            .into_iter()
            .filter_map(|object| Some((relative(&object.location)?, Seen::new(object))))
            .collect())
    }
}

impl Source for Bucket {
    fn list(&mut self) -> Result<Vec<Entry>, BufferError> {
        let seen = self.names().map_err(|error| self.explain(&error, "list"))?;
        let mut known = std::mem::take(&mut self.looked);
        let mut new = Vec::new();
        for (text, segment) in &seen {
            let Ok(name) = Name::parse(text) else { continue };
            let look = look::Look::new(name, segment, &seen);
            match known.remove(&look.name).filter(|looked| looked.is_of(&look)) {
                Some(looked) => drop(self.looked.insert(look.name, looked)),
                None => new.push(look),
            }
        }
        let looks = futures_util::stream::iter(new)
            .map(|look| look.read(self.store.as_ref()))
            .buffer_unordered(LOOKS);
        let looks = self.runtime.block_on(looks.try_collect::<Vec<_>>());
        for looked in looks.map_err(|error| self.explain(&error, "read"))?.into_iter().flatten() {
            self.looked.insert(looked.entry.name.clone(), looked);
        }
        let now_ns = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |d| d.as_nanos() as u64);
        let entries = self.looked.values().map(|looked| looked.entry.clone()).collect();
        Ok(Catalogue::new(entries, now_ns).entries)
    }

    fn fetch(
        &mut self,
        name: &Name,
        have: Have,
        to: &mut dyn Receive<BufferError>,
    ) -> Result<Option<Digest>, BufferError> {
        let Some(looked) = self.looked.get(name) else {
            return Err(self.refused(RefusalKind::NotThere, format!("{name} is not there")));
        };
        let from = fetch::first_byte(looked, &have);
        to.start(from, looked.entry.bytes)?;
        let mut at = from;
        let mut pieces = Box::pin(fetch::pieces(self.store.as_ref(), &looked.seen, from));
        while let Some(piece) = self.runtime.block_on(pieces.next()) {
            let piece = piece.map_err(|error| match error {
                Error::Precondition { .. } | Error::NotFound { .. } => self.refused(
                    RefusalKind::Changed,
                    format!("{name} was replaced or removed while it was read; pull again"),
                ),
                error => self.explain(&error, "read"),
            })?;
            for bytes in piece.chunks(fetch::HANDED_OVER) {
                to.data(at, bytes)?;
                at += bytes.len() as u64;
            }
        }
        Ok(looked.digest)
    }

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), BufferError> {
        let changed =
            || format!("{name} is not marked as pulled: it is not what was read; pull again");
        let path = self.path_of(name.as_str());
        let now = self.runtime.block_on(self.store.head(&path)).map(Seen::new);
        let listed = self.looked.get(name).map(|looked| &looked.seen);
        match now {
            Ok(now) if Some(&now) == listed => {
                let text = Pulled::text(digest, now.bytes(), now.modified_ns());
                let mark = self.path_of(&format!("{name}{PULLED}"));
                let put = self.runtime.block_on(self.store.put(&mark, text.into_bytes().into()));
                put.map(drop).map_err(|error| match error {
                    // Whoever may only read still pulls.
                    Error::PermissionDenied { .. } | Error::Unauthenticated { .. } | Error::NotSupported { .. } => {
                        let text = format!("{name} cannot be marked as pulled: it may not be written; use --no-mark");
                        self.refused(RefusalKind::Disk, text)
                    }
                    error => self.explain(&error, "write"),
                })
            }
            Ok(_) | Err(Error::NotFound { .. }) => {
                Err(self.refused(RefusalKind::Changed, changed()))
            }
            Err(error) => Err(self.explain(&error, "read")),
        }
    }
}
