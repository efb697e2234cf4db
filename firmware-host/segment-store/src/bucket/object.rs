//! Inspection of a segment in an object store, from its end and the objects beside it.

use std::collections::BTreeMap;
use std::io;

use crate::{Bytes, Digest, Entry, KEEP, PULLED, Pulled, State};
use object_store::{Error, GetOptions, GetRange, ObjectMeta, ObjectStore};

use super::keys::Keys;
use super::layout::Layout;
use super::object_name::ObjectName;
use super::{decrypt, unread};

/// Suffix of the object with a segment's digest.
pub(crate) const DIGEST: &str = ".blake3";

/// Enough for the usual index: that of a one-minute segment has 20 KB.
const TAIL: u64 = 64 << 10;
/// Enough for the longest index.
const LONG_TAIL: u64 = 17 << 20;
/// Enough for the header of an encrypted segment: one for 100 recipients has 10 KB.
const HEAD: u64 = 16 << 10;
/// Markers are one line, digests at most two.
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
        if range.is_empty() {
            // No range of HTTP is empty.
            return Ok(bytes::Bytes::new());
        }
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
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SegmentObjects {
    pub name: ObjectName,
    pub version: ObjectVersion,
    digest: Option<ObjectVersion>,
    marker: Option<ObjectVersion>,
    keep: bool,
}

/// A segment whose end has been read.
pub(super) struct InspectedSegment {
    /// Size, state and times are those of the segment without encryption.
    pub entry: Entry,
    pub objects: SegmentObjects,
    /// The digest of the segment without encryption, which the uploading or an earlier pulling program computed.
    pub digest: Option<Digest>,
    /// Where the contents of an encrypted segment are; `None` for others, and for one that is damaged.
    pub layout: Option<Layout>,
    /// Why an encrypted segment cannot be pulled, and what to do.
    pub unread: Option<String>,
    /// An encrypted segment arrived damaged once.
    pub arrived_damaged: bool,
}

fn beside(
    name: &ObjectName,
    suffix: &str,
    all: &BTreeMap<String, ObjectVersion>,
) -> Option<ObjectVersion> {
    all.get(&format!("{name}{suffix}")).cloned()
}

impl InspectedSegment {
    /// Whether this inspection still describes the listed objects.
    pub fn is_current(&self, listed: &SegmentObjects) -> bool {
        self.objects == *listed && self.entry.state != State::Open
    }

    /// Reads the end of a segment.
    async fn read_end(&mut self, store: &dyn ObjectStore) -> Result<(), Error> {
        let version = &self.objects.version;
        for tail in [TAIL, LONG_TAIL] {
            let start = version.bytes().saturating_sub(tail);
            let bytes = version.get(store, start..version.bytes()).await?;
            let inspected = self.entry.inspect(&Tail { start, bytes });
            if inspected.is_ok() || self.entry.state == State::Cut {
                break;
            }
        }
        Ok(())
    }

    /// Reads the beginning of an encrypted segment and, with a key that decrypts it, its end.
    async fn read_encrypted(&mut self, store: &dyn ObjectStore, keys: &Keys) -> Result<(), Error> {
        let version = &self.objects.version;
        let head = version.get(store, 0..version.bytes().min(HEAD)).await?;
        self.layout = Layout::of(&head, version.bytes());
        let Some(layout) = self.layout else {
            self.unread =
                Some(unread::damaged(&self.objects.name, "its header or its length is wrong"));
            return Ok(());
        };
        self.entry.bytes = layout.plain_bytes;
        if keys.identities.is_empty() {
            self.unread = Some(unread::no_identity(&self.objects.name));
            return Ok(());
        }
        self.read_encrypted_end(store, keys, layout, &head).await
    }

    async fn read_encrypted_end(
        &mut self,
        store: &dyn ObjectStore,
        keys: &Keys,
        layout: Layout,
        head: &[u8],
    ) -> Result<(), Error> {
        let version = &self.objects.version;
        for tail in [TAIL, LONG_TAIL] {
            let start = layout.plain_bytes.saturating_sub(tail);
            let tail_start = layout.chunk_of(start);
            let tail = version.get(store, tail_start..version.bytes()).await?;
            let file = decrypt::Ends { head, tail: &tail, tail_start, at: 0 };
            let bytes = match decrypt::end(file, start, keys) {
                Ok(bytes) => bytes.into(),
                Err(error) => {
                    self.unread = Some(unread::undecrypted(&self.objects.name, &error));
                    return Ok(());
                }
            };
            let inspected = self.entry.inspect(&Tail { start, bytes });
            if inspected.is_ok() || self.entry.state == State::Cut {
                break;
            }
        }
        Ok(())
    }

    /// Reads the marker and the digest beside a segment.
    async fn read_beside(&mut self, store: &dyn ObjectStore) -> Result<(), Error> {
        if let Some(marker) = &self.objects.marker {
            let text = marker.line(store).await?.unwrap_or_default();
            self.entry.pulled = Pulled::parse(&text, self.entry.bytes, self.entry.modified_ns);
        }
        self.digest = match &self.objects.digest {
            Some(digest) => {
                let text = digest.line(store).await?.unwrap_or_default();
                digest_in(&text, &self.objects.name)
            }
            // The marker was written for exactly this version.
            None => self.entry.pulled_digest(),
        };
        Ok(())
    }
}

/// The digest of a segment without encryption, in lines as b3sum writes them. Beside an encrypted segment, the line that names the
/// segment without `.age` has it.
fn digest_in(text: &str, name: &ObjectName) -> Option<Digest> {
    let mut lines = text.lines().map(str::split_whitespace);
    let mut words = match name.is_encrypted {
        true => lines.find(|words| words.clone().nth(1) == Some(name.segment.file()))?,
        false => lines.next()?,
    };
    words.next()?.parse().ok()
}

impl SegmentObjects {
    pub fn new(
        name: ObjectName,
        version: &ObjectVersion,
        all: &BTreeMap<String, ObjectVersion>,
    ) -> Self {
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
    pub async fn inspect(
        self,
        store: &dyn ObjectStore,
        keys: &Keys,
    ) -> Result<Option<InspectedSegment>, Error> {
        match self.try_inspect(store, keys).await {
            Err(Error::NotFound { .. } | Error::Precondition { .. }) => Ok(None),
            inspected => inspected.map(Some),
        }
    }

    async fn try_inspect(
        self,
        store: &dyn ObjectStore,
        keys: &Keys,
    ) -> Result<InspectedSegment, Error> {
        let name = self.name.segment.clone();
        let mut entry = Entry::new(name, self.version.bytes(), self.version.modified_ns());
        entry.keep = self.keep;
        let mut segment = InspectedSegment {
            entry,
            objects: self,
            digest: None,
            layout: None,
            unread: None,
            arrived_damaged: false,
        };
        match segment.objects.name.is_encrypted {
            true => segment.read_encrypted(store, keys).await?,
            false => segment.read_end(store).await?,
        }
        segment.read_beside(store).await?;
        Ok(segment)
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
