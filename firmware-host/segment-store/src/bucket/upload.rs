//! Uploads a robot's segments into the object store, each with its digest beside it.

use futures_util::TryStreamExt;
use hal::Clock;
use object_store::path::Path;
use object_store::{Error, ObjectStoreExt, WriteMultipart};

use super::object::{DIGEST, InspectedSegment};
use super::{Bucket, fetch};
use crate::pull::{Options, Progress, RateLimiter, Report};
use crate::source::Source;
use crate::{Digest, Entry, FileSink, Hasher, LocalCopy, Name, State, StoreError};

/// The size of a part. S3 accepts at most 10,000 parts of at least 5 MiB; with this size an object can have 80 GB.
const PART: usize = 8 << 20;

/// The number of parts in flight, besides the one that is being filled.
const AHEAD: usize = 3;

impl Bucket {
    /// Uploads every segment of `source` that is closed or cut and not in the store yet, then tells the robot. A segment is in the
    /// store when the digest beside the object equals the digest in the robot's marker, or the one that the robot computes from
    /// its disk.
    ///
    /// # Errors
    /// When the link, the robot or the store fails. An object is never left incomplete.
    pub fn upload(
        &mut self,
        source: &mut dyn Source,
        options: &Options,
        clock: &mut dyn Clock,
        progress: &mut dyn Progress,
    ) -> Result<Report, StoreError> {
        let mut report = Report::default();
        let listing = source.list()?;
        report.unread = listing.unread;
        let missing = self.missing(listing.entries, options, progress, &mut report)?;
        source.expect(missing.iter().map(|entry| entry.bytes).fold(0, u64::saturating_add));
        let mut limiter = RateLimiter::new(clock, options.limit);
        for entry in missing {
            let put = match self.put(source, &entry, progress, &mut limiter, &mut report) {
                // Damaged in transit from the robot: read once more.
                Err(StoreError::Digest { name }) => {
                    progress.warning(&format!("{name} arrived damaged and is read once more"));
                    self.put(source, &entry, progress, &mut limiter, &mut report)
                }
                put => put,
            };
            let digest = match put {
                // Deleted or written to since it was listed; the next upload handles it.
                Err(StoreError::Refused { refusal, .. }) => {
                    progress.warning(&refusal.to_string());
                    continue;
                }
                put => put?,
            };
            let mark =
                if options.no_mark { Ok(()) } else { source.mark_pulled(&entry.name, &digest) };
            match mark {
                Err(StoreError::Refused { refusal, .. }) => {
                    report.unmarked += 1;
                    progress.warning(&refusal.to_string());
                }
                mark => mark?,
            }
            self.uploaded.insert(entry.name, (entry.bytes, entry.modified_ns));
        }
        Ok(report)
    }

    /// The segments to upload or compare, in order. The store is listed only when the robot has something new.
    fn missing(
        &mut self,
        entries: Vec<Entry>,
        options: &Options,
        progress: &mut dyn Progress,
        report: &mut Report,
    ) -> Result<Vec<Entry>, StoreError> {
        report.open = entries.iter().filter(|entry| entry.state == State::Open).count() as u64;
        let (there, mut missing): (Vec<_>, Vec<_>) = entries
            .into_iter()
            .filter(|entry| entry.state != State::Open && entry.bytes > 0)
            .partition(|entry| {
                self.uploaded.get(&entry.name) == Some(&(entry.bytes, entry.modified_ns))
            });
        let mut there_bytes: u64 = there.iter().map(|entry| entry.bytes).sum();
        report.there = there.len() as u64;
        if !missing.is_empty() {
            self.list()?;
        }
        missing.retain(|entry| {
            let digest =
                self.inspected.get(&entry.name).filter(|there| there.entry.bytes == entry.bytes);
            let is_there = digest
                .and_then(|there| there.digest)
                .is_some_and(|digest| entry.pulled_digest() == Some(digest));
            report.there += u64::from(is_there);
            there_bytes += if is_there { entry.bytes } else { 0 };
            !is_there
        });
        options.order.sort(&mut missing);
        let missing_bytes: u64 = missing.iter().map(|entry| entry.bytes).sum();
        progress.planned(missing.len() as u64, there_bytes + missing_bytes, there_bytes);
        Ok(missing)
    }

    /// Uploads one segment, unless the store has the same bytes.
    fn put(
        &self,
        source: &mut dyn Source,
        entry: &Entry,
        progress: &mut dyn Progress,
        limiter: &mut RateLimiter<'_>,
        report: &mut Report,
    ) -> Result<Digest, StoreError> {
        let there = self.inspected.get(&entry.name);
        let local = match there.filter(|there| there.entry.bytes == entry.bytes) {
            Some(there) => LocalCopy { bytes: entry.bytes, digest: self.digest_of(there)? },
            None => LocalCopy::none(),
        };
        let mut object = Object {
            bucket: self,
            name: &entry.name,
            hasher: Hasher::default(),
            parts: None,
            progress,
            limiter,
        };
        let sent_digest = source.fetch(&entry.name, local, &mut object);
        let Object { hasher, parts, .. } = object;
        let is_new = parts.is_some();
        let digest = if is_new { hasher.digest() } else { local.digest };
        let outcome = match sent_digest {
            Ok(sent_digest) if sent_digest == Some(digest) => Ok(digest),
            Ok(_) => Err(StoreError::Digest { name: entry.name.to_string() }),
            Err(error) => Err(error),
        };
        if let Some(parts) = parts {
            report.bytes += hasher.bytes();
            self.finish(&entry.name, parts, outcome.is_ok().then(|| hasher.bytes()))?;
        }
        if outcome.is_ok() && (is_new || there.is_none_or(|there| there.digest.is_none())) {
            let line = format!("{digest}  {}\n", entry.name.file());
            let path = self.path_of(&format!("{}{DIGEST}", entry.name));
            let put = self.runtime.block_on(self.store.put(&path, line.into_bytes().into()));
            put.map_err(|error| self.explain(&error, "write"))?;
            report.files += 1;
            report.cut += u64::from(entry.state == State::Cut);
            progress.file_completed(&entry.name, &digest);
        }
        outcome
    }

    /// The digest of an object. The object is read when there is none beside it: an upload may have ended between object and
    /// digest, or another program may have uploaded the object.
    fn digest_of(&self, there: &InspectedSegment) -> Result<Digest, StoreError> {
        if let Some(digest) = there.digest {
            return Ok(digest);
        }
        let mut hasher = Hasher::default();
        let read = fetch::pieces(self.store.as_ref(), &there.version, 0).try_for_each(|piece| {
            hasher.update(&piece);
            futures_util::future::ready(Ok(()))
        });
        self.runtime.block_on(read).map_err(|error| self.explain(&error, "read"))?;
        Ok(hasher.digest())
    }

    /// Completes an object of `bytes` bytes, or deletes its parts when `bytes` is `None`. An object that had the same name before is
    /// kept under another name.
    fn finish(
        &self,
        name: &Name,
        parts: WriteMultipart,
        bytes: Option<u64>,
    ) -> Result<(), StoreError> {
        let path = self.path_of(name.as_str());
        let Some(bytes) = bytes else {
            // The caller returns the error that ended the upload. If this request fails as well, the store's own rules delete the
            // parts.
            let _ = self.runtime.block_on(parts.abort());
            return Ok(());
        };
        let finished = self.runtime.block_on(async {
            if let Some(before) = self.inspected.get(name) {
                let suffix = before.digest.map_or_else(
                    || before.version.modified_ns().to_string(),
                    |digest| digest.short(),
                );
                self.store.copy(&path, &self.path_of(&format!("{name}.{suffix}"))).await?;
            }
            parts.finish().await?;
            self.store.head(&path).await
        });
        let written = finished.map_err(|error| self.explain(&error, "write"))?.size;
        if written == bytes {
            return Ok(());
        }
        let detail = format!(
            "{name} has {written} bytes there, but {bytes} were sent; check the store, and upload again"
        );
        Err(StoreError::ObjectStore { url: self.url.clone(), detail })
    }

    /// The same store with `name` appended to the prefix.
    #[must_use]
    pub fn with_subfolder(self, name: &str) -> Self {
        Self {
            prefix: self.prefix.clone().join(name),
            url: format!("{}/{name}", self.url.trim_end_matches('/')),
            ..self
        }
    }
}

/// An object that is being uploaded.
struct Object<'a, 'b, 'c> {
    bucket: &'a Bucket,
    name: &'a Name,
    hasher: Hasher,
    /// `None` when the store already has the bytes.
    parts: Option<WriteMultipart>,
    progress: &'a mut dyn Progress,
    limiter: &'b mut RateLimiter<'c>,
}

impl FileSink<StoreError> for Object<'_, '_, '_> {
    fn start(&mut self, from: u64, length: u64) -> Result<(), StoreError> {
        self.progress.file_started(self.name, length, from);
        // The file has grown since it was listed; an object cannot be continued.
        if from > 0 && from < length {
            let source =
                std::io::Error::other(format!("{} was written to since it was listed", self.name));
            return Err(StoreError::Link { to: self.bucket.url.clone(), source });
        }
        if from == 0 {
            let path: Path = self.bucket.path_of(self.name.as_str());
            let begun = self.bucket.runtime.block_on(self.bucket.store.put_multipart(&path));
            let begun = begun.map_err(|error| self.bucket.explain(&error, "write"))?;
            self.parts = Some(WriteMultipart::new_with_chunk_size(begun, PART));
        }
        Ok(())
    }

    fn data(&mut self, _at: u64, bytes: &[u8]) -> Result<(), StoreError> {
        if let Some(parts) = &mut self.parts {
            let written = self.bucket.runtime.block_on(async {
                parts.wait_for_capacity(AHEAD).await?;
                parts.write(bytes);
                Ok::<_, Error>(())
            });
            written.map_err(|error| self.bucket.explain(&error, "write"))?;
        }
        self.hasher.update(bytes);
        self.progress.received(bytes.len() as u64);
        self.limiter.wait_after(bytes.len());
        Ok(())
    }

    fn comparing(&mut self) -> Result<(), StoreError> {
        Ok(())
    }
}
