//! What an object is, from its end and the marks beside it.

use std::collections::BTreeMap;
use std::io;

use crate::{Bytes, Digest, Entry, KEEP, Name, PULLED, Pulled, State};
use object_store::{Error, GetOptions, GetRange, ObjectMeta, ObjectStore};

/// Behind a segment's name: its digest.
pub(crate) const DIGEST: &str = ".blake3";

/// The index of a segment of a minute takes 20 KB.
const TAIL: u64 = 64 << 10;
/// No index is longer.
const LONG_TAIL: u64 = 17 << 20;
/// Marks and digests are a line.
const MAX_LINE: u64 = 512;

/// One version of an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Seen(ObjectMeta);

impl Seen {
    pub fn new(meta: ObjectMeta) -> Self {
        // Listings know no version, and where it is needed the ETag stands for it.
        Self(ObjectMeta { version: None, ..meta })
    }

    pub fn bytes(&self) -> u64 {
        self.0.size
    }

    /// Since 1970.
    pub fn modified_ns(&self) -> u64 {
        self.0
            .last_modified
            .timestamp_nanos_opt()
            .and_then(|ns| u64::try_from(ns).ok())
            .unwrap_or(0)
    }

    /// Bytes of this version and no other.
    pub async fn get(
        &self,
        store: &dyn ObjectStore,
        range: std::ops::Range<u64>,
    ) -> Result<bytes::Bytes, Error> {
        let mut options = GetOptions::default().with_range(Some(GetRange::Bounded(range.clone())));
        options.if_match.clone_from(&self.0.e_tag);
        let path = &self.0.location;
        let result = store.get_opts(path, options).await?;
        // Not every store that calls itself S3 looks at If-Match.
        let differs = || Error::Precondition {
            path: path.to_string(),
            source: "it is another object now".into(),
        };
        if result.meta.e_tag != self.0.e_tag || result.meta.size != self.0.size {
            return Err(differs());
        }
        let bytes = result.bytes().await?;
        if bytes.len() as u64 != range.end - range.start { Err(differs()) } else { Ok(bytes) }
    }

    /// A short text; `None` where it is too long for one, or none.
    async fn line(&self, store: &dyn ObjectStore) -> Result<Option<String>, Error> {
        if self.bytes() == 0 || self.bytes() > MAX_LINE {
            return Ok(None);
        }
        let bytes = self.get(store, 0..self.bytes()).await?;
        Ok(String::from_utf8(bytes.to_vec()).ok())
    }
}

/// A segment, and what stands beside it.
pub(crate) struct Look {
    pub name: Name,
    seen: Seen,
    digest: Option<Seen>,
    mark: Option<Seen>,
    keep: bool,
}

/// A segment that was looked into.
pub(crate) struct Looked {
    pub entry: Entry,
    pub seen: Seen,
    /// What whoever put it there or pulled it before computed.
    pub digest: Option<Digest>,
    from: (Option<Seen>, Option<Seen>),
}

impl Looked {
    /// Whether nothing has changed since.
    pub fn is_of(&self, look: &Look) -> bool {
        let same_marks = self.from.0 == look.digest && self.from.1 == look.mark;
        self.seen == look.seen
            && same_marks
            && self.entry.keep == look.keep
            && self.entry.state != State::Open
    }
}

impl Look {
    pub fn new(name: Name, seen: &Seen, all: &BTreeMap<String, Seen>) -> Self {
        let beside = |suffix: &str| all.get(&format!("{name}{suffix}")).cloned();
        // A digest that is older than the segment is another one's.
        let digest = beside(DIGEST).filter(|digest| digest.modified_ns() >= seen.modified_ns());
        let (mark, keep) = (beside(PULLED), beside(KEEP).is_some());
        Self { seen: seen.clone(), digest, mark, keep, name }
    }

    /// `None`: it is gone, or another one already.
    pub async fn read(self, store: &dyn ObjectStore) -> Result<Option<Looked>, Error> {
        match self.try_read(store).await {
            Err(Error::NotFound { .. } | Error::Precondition { .. }) => Ok(None),
            looked => looked.map(Some),
        }
    }

    async fn try_read(self, store: &dyn ObjectStore) -> Result<Looked, Error> {
        let mut entry = Entry::new(self.name, self.seen.bytes(), self.seen.modified_ns());
        entry.keep = self.keep;
        for tail in [TAIL, LONG_TAIL] {
            let start = entry.bytes.saturating_sub(tail);
            if entry.bytes == 0 {
                break;
            }
            let bytes = self.seen.get(store, start..entry.bytes).await?;
            let looked = entry.look_into(&Tail { start, bytes });
            if looked.is_ok() || entry.state == State::Cut {
                break;
            }
        }
        if let Some(mark) = &self.mark {
            let text = mark.line(store).await?.unwrap_or_default();
            entry.pulled = Pulled::parse(&text, entry.bytes, entry.modified_ns);
        }
        let digest = match &self.digest {
            Some(digest) => digest
                .line(store)
                .await?
                .and_then(|line| line.split_whitespace().next()?.parse().ok()),
            // Whoever set the mark has compared this very version.
            None => entry.pulled_digest(),
        };
        Ok(Looked { entry, seen: self.seen, digest, from: (self.digest, self.mark) })
    }
}

/// The end of an object.
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
