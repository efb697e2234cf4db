//! Inspection of a segment in an object store, from its end and the objects beside it.

use std::collections::BTreeMap;
use std::io;

use crate::{Bytes, Digest, Entry, KEEP, Name, PULLED, Pulled, State};
use object_store::{Error, GetOptions, GetRange, ObjectMeta, ObjectStore};

/// Suffix of the object with a segment's digest.
pub(crate) const DIGEST: &str = ".blake3";

/// Enough for the usual index: that of a one-minute segment has 20 KB.
const TAIL: u64 = 64 << 10;
/// Enough for the longest index.
const LONG_TAIL: u64 = 17 << 20;
/// Markers and digests are one line.
const MAX_LINE: u64 = 512;

/// One version of an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ObjectVersion(ObjectMeta);

impl ObjectVersion {
    pub fn new(meta: ObjectMeta) -> Self {
        // Listings contain no version id; the ETag identifies the version.
        Self(ObjectMeta { version: None, ..meta })
    }

    pub fn bytes(&self) -> u64 {
        self.0.size
    }

    /// The modification time since 1970.
    pub fn modified_ns(&self) -> u64 {
        self.0
            .last_modified
            .timestamp_nanos_opt()
            .and_then(|ns| u64::try_from(ns).ok())
            .unwrap_or(0)
    }

    /// Reads a range of this version; an error when the object has been replaced.
    pub async fn get(
        &self,
        store: &dyn ObjectStore,
        range: std::ops::Range<u64>,
    ) -> Result<bytes::Bytes, Error> {
        let mut options = GetOptions::default().with_range(Some(GetRange::Bounded(range.clone())));
        options.if_match.clone_from(&self.0.e_tag);
        let path = &self.0.location;
        let result = store.get_opts(path, options).await?;
        // Not every store with the S3 protocol honours If-Match.
        if result.meta.e_tag != self.0.e_tag || result.meta.size != self.0.size {
            return Err(self.replaced());
        }
        let bytes = result.bytes().await?;
        if bytes.len() as u64 != range.end - range.start { Err(self.replaced()) } else { Ok(bytes) }
    }

    fn replaced(&self) -> Error {
        Error::Precondition {
            path: self.0.location.to_string(),
            source: "the object has been replaced".into(),
        }
    }

    /// The contents as a short text; `None` when they are empty, too long or not UTF-8.
    async fn line(&self, store: &dyn ObjectStore) -> Result<Option<String>, Error> {
        if self.bytes() == 0 || self.bytes() > MAX_LINE {
            return Ok(None);
        }
        let bytes = self.get(store, 0..self.bytes()).await?;
        Ok(String::from_utf8(bytes.to_vec()).ok())
    }
}

/// A segment and the objects beside it, as listed.
pub(crate) struct SegmentObjects {
    pub name: Name,
    version: ObjectVersion,
    digest: Option<ObjectVersion>,
    marker: Option<ObjectVersion>,
    keep: bool,
}

/// A segment whose end has been read.
pub(crate) struct InspectedSegment {
    pub entry: Entry,
    pub version: ObjectVersion,
    /// The digest that the uploading or an earlier pulling program computed.
    pub digest: Option<Digest>,
    digest_object: Option<ObjectVersion>,
    marker_object: Option<ObjectVersion>,
}

fn beside(
    name: &Name,
    suffix: &str,
    all: &BTreeMap<String, ObjectVersion>,
) -> Option<ObjectVersion> {
    all.get(&format!("{name}{suffix}")).cloned()
}

impl InspectedSegment {
    /// Whether this inspection still describes the listed objects.
    pub fn is_current(&self, listed: &SegmentObjects) -> bool {
        self.version == listed.version
            && self.digest_object == listed.digest
            && self.marker_object == listed.marker
            && self.entry.keep == listed.keep
            && self.entry.state != State::Open
    }
}

impl SegmentObjects {
    pub fn new(name: Name, version: &ObjectVersion, all: &BTreeMap<String, ObjectVersion>) -> Self {
        // A digest that is older than the segment belongs to an earlier version of it.
        let digest = beside(&name, DIGEST, all)
            .filter(|digest| digest.modified_ns() >= version.modified_ns());
        Self {
            version: version.clone(),
            digest,
            marker: beside(&name, PULLED, all),
            keep: beside(&name, KEEP, all).is_some(),
            name,
        }
    }

    /// Reads the end of the segment and the objects beside it. `None` when the segment was deleted or replaced since it was
    /// listed.
    pub async fn inspect(self, store: &dyn ObjectStore) -> Result<Option<InspectedSegment>, Error> {
        match self.try_inspect(store).await {
            Err(Error::NotFound { .. } | Error::Precondition { .. }) => Ok(None),
            inspected => inspected.map(Some),
        }
    }

    async fn try_inspect(self, store: &dyn ObjectStore) -> Result<InspectedSegment, Error> {
        let mut entry = Entry::new(self.name, self.version.bytes(), self.version.modified_ns());
        entry.keep = self.keep;
        for tail in [TAIL, LONG_TAIL] {
            let start = entry.bytes.saturating_sub(tail);
            if entry.bytes == 0 {
                break;
            }
            let bytes = self.version.get(store, start..entry.bytes).await?;
            let inspected = entry.inspect(&Tail { start, bytes });
            if inspected.is_ok() || entry.state == State::Cut {
                break;
            }
        }
        if let Some(marker) = &self.marker {
            let text = marker.line(store).await?.unwrap_or_default();
            entry.pulled = Pulled::parse(&text, entry.bytes, entry.modified_ns);
        }
        let digest = match &self.digest {
            Some(digest) => digest
                .line(store)
                .await?
                .and_then(|line| line.split_whitespace().next()?.parse().ok()),
            // The marker was written for exactly this version.
            None => entry.pulled_digest(),
        };
        Ok(InspectedSegment {
            entry,
            version: self.version,
            digest,
            digest_object: self.digest,
            marker_object: self.marker,
        })
    }
}

/// The end of an object, addressed by the offsets of the whole object.
struct Tail {
    start: u64,
    bytes: bytes::Bytes,
}

impl Bytes for Tail {
    fn length(&self) -> io::Result<u64> {
        Ok(self.start + self.bytes.len() as u64)
    }

    fn read_exact_at(&self, at: u64, into: &mut [u8]) -> io::Result<()> {
        let at = at.checked_sub(self.start).ok_or(io::ErrorKind::UnexpectedEof)?;
        Bytes::read_exact_at(&self.bytes[..], at, into)
    }
}
