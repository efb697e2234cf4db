//! Uploads a robot's segments into the object store, each with its digest beside it, and encrypts them if there are recipients.

use futures_util::TryStreamExt;
use hal::Clock;
use object_store::{Error, ObjectStoreExt};

use super::object::{DIGEST, InspectedSegment};
use super::object_name::ObjectName;
use super::object_sink::{ObjectSink, Sent};
use super::{Bucket, fetch};
use crate::pull::{Options, Progress, RateLimiter, Report};
use crate::source::Source;
use crate::{Digest, Entry, Hasher, LocalCopy, State, StoreError};

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
            self.inspect_all()?;
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
        let there = there.filter(|there| there.entry.bytes == entry.bytes);
        let local = match there {
            Some(there) => self.copy_of(there)?,
            None => LocalCopy::none(),
        };
        let is_encrypted = !self.keys.recipients.is_empty();
        let name = ObjectName { segment: entry.name.clone(), is_encrypted };
        let mut object = ObjectSink::new(self, &name, progress, limiter);
        let sent_digest = source.fetch(&entry.name, local, &mut object);
        let sent = object.end();
        let digest = match &sent {
            Some(sent) => sent.plain_digest,
            None => local.digest,
        };
        let outcome = sent_digest.and_then(|sent_digest| match sent_digest {
            Some(sent_digest) if sent_digest == digest => Ok(()),
            _ => Err(StoreError::Digest { name: entry.name.to_string() }),
        });
        match (sent, there) {
            (Some(sent), _) => {
                report.bytes += sent.plain_bytes;
                self.finish(&name, sent, outcome)?;
            }
            (None, Some(there)) if there.digest.is_none() => {
                outcome?;
                self.put_digest(&there.objects.name, &digest, &digest)?;
            }
            (None, _) => return outcome.map(|()| digest),
        }
        report.files += 1;
        report.cut += u64::from(entry.state == State::Cut);
        progress.file_completed(&entry.name, &digest);
        Ok(digest)
    }

    /// What the store has of a segment. The object is read when there is no digest beside it: an upload may have ended between object
    /// and digest, or another program may have uploaded the object. An encrypted one cannot be read here, and is sent again.
    fn copy_of(&self, there: &InspectedSegment) -> Result<LocalCopy, StoreError> {
        let bytes = there.entry.bytes;
        if let Some(digest) = there.digest {
            return Ok(LocalCopy { bytes, digest });
        }
        if there.objects.name.is_encrypted {
            return Ok(LocalCopy::none());
        }
        let mut hasher = Hasher::default();
        let version = &there.objects.version;
        let read = fetch::pieces(self.store.as_ref(), version, 0).try_for_each(|piece| {
            hasher.update(&piece);
            futures_util::future::ready(Ok(()))
        });
        self.runtime.block_on(read).map_err(|error| self.explain(&error, "read"))?;
        Ok(LocalCopy { bytes, digest: hasher.digest() })
    }

    /// Completes an object and writes its digest, or deletes its parts when the `outcome` is an error.
    fn finish(
        &self,
        name: &ObjectName,
        sent: Sent,
        outcome: Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let stored = match outcome.and(sent.stored) {
            Ok(stored) => stored,
            Err(error) => {
                // If this request fails as well, the store's own rules delete the parts.
                let _ = self.runtime.block_on(sent.parts.abort());
                return Err(error);
            }
        };
        let finished = self.runtime.block_on(async {
            self.keep_before(name).await?;
            sent.parts.finish().await?;
            self.store.head(&self.path_of(&name.to_string())).await
        });
        let written = finished.map_err(|error| self.explain(&error, "write"))?.size;
        if written != stored.bytes {
            let detail = format!(
                "{name} has {written} bytes there, but {} were sent; check the store, and upload again",
                stored.bytes
            );
            return Err(StoreError::ObjectStore { url: self.url.clone(), detail });
        }
        self.put_digest(name, &stored.digest, &sent.plain_digest)
    }

    /// Keeps an object that has the name of a new one under another name.
    async fn keep_before(&self, name: &ObjectName) -> Result<(), Error> {
        let before = self.inspected.get(&name.segment);
        let Some(before) = before.filter(|before| before.objects.name == *name) else {
            return Ok(());
        };
        let suffix = before.digest.map_or_else(
            || before.objects.version.modified_ns().to_string(),
            |digest| digest.short(),
        );
        let from = self.path_of(&name.to_string());
        self.store.copy(&from, &self.path_of(&format!("{name}.{suffix}"))).await
    }

    /// Writes the digest beside an object as b3sum writes it. Beside an encrypted one are two lines: what is in the store, and the
    /// segment itself.
    fn put_digest(
        &self,
        name: &ObjectName,
        stored: &Digest,
        plain: &Digest,
    ) -> Result<(), StoreError> {
        let mut text = format!("{stored}  {}\n", name.file());
        if name.is_encrypted {
            text = format!("{text}{plain}  {}\n", name.segment.file());
        }
        let path = self.path_of(&format!("{name}{DIGEST}"));
        let put = self.runtime.block_on(self.store.put(&path, text.into_bytes().into()));
        put.map(drop).map_err(|error| self.explain(&error, "write"))
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
