//! A robot's segments in an object store: Amazon S3 and compatible ones, Google Cloud Storage, Azure, or a directory.
//!
//! ```text
//! PREFIX/RUN/recording_0007.mcap           a segment
//! PREFIX/RUN/recording_0007.mcap.blake3    its digest in the format of b3sum, written by the uploading program
//! PREFIX/RUN/recording_0007.mcap.pulled    a workstation has a copy: digest, size and modification time
//! PREFIX/RUN/recording_0007.mcap.keep      a marker for operators and for --order valuable
//! PREFIX/RUN/recording_0007.mcap.age       an encrypted segment; what lies beside it is called recording_0007.mcap.age.blake3 etc.
//! ```
//!
//! Object stores do not compute BLAKE3 digests. A segment with a `.blake3` object is pulled as from a robot: the received bytes
//! must have that digest. Without one, every request must return the same version of the object (its `ETag`), and the segment's
//! own checksums must be right.
//!
//! An encrypted segment is an age file. The `.blake3` object beside it has two lines: the digest of the object, and that of the
//! segment without encryption, by which the uploading program sees that the segment is there. If there are an encrypted and a plain
//! object of one segment, the newer one counts.

mod decrypt;
mod download;
mod encrypt;
mod error;
mod fetch;
mod keys;
mod layout;
mod object;
mod object_file;
mod object_name;
mod object_sink;
mod open;
mod unread;
mod upload;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::SystemTime;

use futures_util::{StreamExt, TryStreamExt};
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt};
use tokio::runtime::Runtime;

pub use keys::Keys;

use object::{InspectedSegment, ObjectVersion, SegmentObjects};
use object_name::{ObjectName, is_of_segment};

use crate::source::{Listing, Source};
use crate::wire::{Refusal, RefusalKind};
use crate::{Catalogue, Digest, FileSink, LocalCopy, Name, PULLED, Pulled, StoreError};

/// A prefix with more objects of segments is refused, because their names would fill the memory. One robot makes 10 million of
/// them in six years (400,000 in 92 days).
const MOST_OBJECTS: usize = 10_000_000;

/// This many segments are inspected at the same time.
const PARALLEL_INSPECTIONS: usize = 32;

/// The segments under a prefix of an object store.
pub struct Bucket {
    url: String,
    /// Runs the asynchronous requests; the rest of the program is synchronous.
    runtime: Runtime,
    store: Arc<dyn ObjectStore>,
    prefix: Path,
    keys: Keys,
    /// The segments of the last listing. A segment that has not changed is not inspected again.
    inspected: BTreeMap<Name, InspectedSegment>,
    /// The size and modification time of the robot's segments that this program has uploaded.
    uploaded: BTreeMap<Name, (u64, u64)>,
}

impl Bucket {
    /// Opens the store at `url` with credentials from the usual environment variables. A request fails when nothing is received
    /// for `stall_s` seconds. No request is made yet.
    ///
    /// # Errors
    /// When the URL is invalid, or the credentials are malformed.
    pub fn open(url: &str, stall_s: u64) -> Result<Self, StoreError> {
        let (store, prefix) = open::open_store(url, stall_s)?;
        Self::from_store(store, prefix, url)
    }

    /// Uses `prefix` of an opened store, which is called `url` in errors.
    ///
    /// # Errors
    /// When the asynchronous runtime cannot be started.
    pub fn from_store(
        store: Arc<dyn ObjectStore>,
        prefix: Path,
        url: &str,
    ) -> Result<Self, StoreError> {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.map_err(|source| StoreError::Link { to: url.to_owned(), source })?;
        Ok(Self {
            url: url.to_owned(),
            runtime,
            store,
            prefix,
            keys: Keys::default(),
            inspected: BTreeMap::new(),
            uploaded: BTreeMap::new(),
        })
    }

    /// The same store, into which segments are encrypted, or from which they are decrypted, with `keys`.
    #[must_use]
    pub fn with_keys(self, keys: &Keys) -> Self {
        Self { keys: keys.clone(), ..self }
    }

    fn explain(&self, error: &Error, doing: &str) -> StoreError {
        error::explain(&self.url, error, doing)
    }

    fn refused(&self, kind: RefusalKind, text: String) -> StoreError {
        StoreError::Refused { from: self.url.clone(), refusal: Refusal { kind, text } }
    }

    fn path_of(&self, name: &str) -> Path {
        name.split('/').fold(self.prefix.clone(), Path::join)
    }

    /// Lists the objects of segments, by their path below the prefix. Other objects are passed over.
    fn list_objects(&self) -> Result<BTreeMap<String, ObjectVersion>, StoreError> {
        let mut objects = BTreeMap::new();
        let mut listing = self.store.list(Some(&self.prefix));
        self.runtime.block_on(async {
            while let Some(object) =
                listing.try_next().await.map_err(|error| self.explain(&error, "list"))?
            {
                let path = self.below_prefix(&object.location).filter(|path| is_of_segment(path));
                let Some(path) = path else { continue };
                if objects.len() == MOST_OBJECTS {
                    return Err(StoreError::ObjectStore {
                        url: self.url.clone(),
                        detail: too_many(),
                    });
                }
                objects.insert(path, ObjectVersion::new(object));
            }
            Ok(objects)
        })
    }

    fn below_prefix(&self, path: &Path) -> Option<String> {
        let parts: Vec<_> =
            path.prefix_match(&self.prefix)?.map(|part| part.as_ref().to_owned()).collect();
        Some(parts.join("/"))
    }

    /// Whether the store refused a write because the credentials or the store are read-only.
    fn is_read_only(error: &Error) -> bool {
        matches!(
            error,
            Error::PermissionDenied { .. }
                | Error::Unauthenticated { .. }
                | Error::NotSupported { .. }
        )
    }
}

fn too_many() -> String {
    format!(
        "there are more than {MOST_OBJECTS} objects of segments under this prefix; give the prefix of one robot, or move old runs elsewhere"
    )
}

impl Bucket {
    /// The segments that are listed, and the objects beside them. Of two objects of a segment, the newer one counts.
    fn segments(objects: &BTreeMap<String, ObjectVersion>) -> BTreeMap<Name, SegmentObjects> {
        let mut segments = BTreeMap::<Name, SegmentObjects>::new();
        for (text, version) in objects {
            let Some(name) = ObjectName::parse(text) else { continue };
            let other = segments.get(&name.segment);
            // The encrypted object comes behind the plain one.
            if other.is_none_or(|other| other.version.modified_ns() <= version.modified_ns()) {
                let segment = name.segment.clone();
                segments.insert(segment, SegmentObjects::new(name, version, objects));
            }
        }
        segments
    }

    /// Lists the segments, and inspects those that are new or have changed.
    fn inspect_all(&mut self) -> Result<(), StoreError> {
        let objects = self.list_objects()?;
        let mut known = std::mem::take(&mut self.inspected);
        let mut new = Vec::new();
        for (name, listed) in Self::segments(&objects) {
            match known.remove(&name).filter(|segment| segment.is_current(&listed)) {
                Some(segment) => drop(self.inspected.insert(name, segment)),
                None => new.push(listed),
            }
        }
        let inspections = futures_util::stream::iter(new)
            .map(|listed| listed.inspect(self.store.as_ref(), &self.keys))
            .buffer_unordered(PARALLEL_INSPECTIONS);
        let inspected = self
            .runtime
            .block_on(inspections.try_collect::<Vec<_>>())
            .map_err(|error| self.explain(&error, "read"))?;
        for segment in inspected.into_iter().flatten() {
            self.inspected.insert(segment.entry.name.clone(), segment);
        }
        Ok(())
    }
}

impl Source for Bucket {
    fn list(&mut self) -> Result<Listing, StoreError> {
        self.inspect_all()?;
        let unread = self.inspected.values().filter_map(|segment| segment.unread.clone()).collect();
        let readable = self.inspected.values().filter(|segment| segment.unread.is_none());
        let entries = readable.map(|segment| segment.entry.clone()).collect();
        let now_ns = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |d| d.as_nanos() as u64);
        Ok(Listing { entries: Catalogue::new(entries, now_ns).entries, unread })
    }

    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        let Some(segment) = self.inspected.get(name) else {
            return Err(self.refused(RefusalKind::NotThere, format!("{name} is not there")));
        };
        if let Some(why) = &segment.unread {
            return Err(StoreError::Unread(why.clone()));
        }
        let from = fetch::first_byte(segment, &local);
        to.start(from, segment.entry.bytes)?;
        let digest = segment.digest;
        if from == segment.entry.bytes {
            return Ok(digest);
        }
        let fetched = match segment.layout {
            Some(layout) => self.fetch_encrypted(segment, layout, from, to),
            None => self.fetch_plain(segment, from, to),
        };
        if let Err(StoreError::Unread(why)) = fetched {
            return Err(self.damaged(name, why));
        }
        fetched.map(|()| digest)
    }

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        let Some(segment) = self.inspected.get(name) else {
            return Err(self.refused(RefusalKind::NotThere, format!("{name} is not there")));
        };
        let object = segment.objects.name.to_string();
        let now = self.runtime.block_on(self.store.head(&self.path_of(&object)));
        match now.map(ObjectVersion::new) {
            Ok(now) if now == segment.objects.version => {
                let text = Pulled::text(digest, segment.entry.bytes, now.modified_ns());
                let mark = self.path_of(&format!("{object}{PULLED}"));
                let put = self.runtime.block_on(self.store.put(&mark, text.into_bytes().into()));
                // A refusal and not an error: pulling is possible with read-only credentials.
                put.map(drop).map_err(|error| match error {
                    error if Self::is_read_only(&error) => {
                        let text = format!(
                            "{name} cannot be marked as pulled: no permission to write; use --no-mark"
                        );
                        self.refused(RefusalKind::Disk, text)
                    }
                    error => self.explain(&error, "write"),
                })
            }
            Ok(_) | Err(Error::NotFound { .. }) => {
                let text =
                    format!("{name} is not marked as pulled: it is not what was read; pull again");
                Err(self.refused(RefusalKind::Changed, text))
            }
            Err(error) => Err(self.explain(&error, "read")),
        }
    }
}
