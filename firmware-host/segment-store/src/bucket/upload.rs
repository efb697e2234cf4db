//! The other way: what a robot recorded goes into the store, with its digest beside it.

use crate::pull::{Options, Pace, Report, Watch};
use crate::source::Source;
use crate::{BufferError, Digest, Entry, Hasher, Have, Name, Receive, State};
use futures_util::TryStreamExt;
use hal::Clock;
use object_store::path::Path;
use object_store::{Error, ObjectStoreExt, WriteMultipart};

use super::look::{DIGEST, Looked};
use super::{Bucket, fetch};

/// S3 takes at most 10,000 parts of at least 5 MiB; with this one, 80 GB.
const PART: usize = 8 << 20;

/// Parts under way, besides the one that is being filled.
const AHEAD: usize = 3;

impl Bucket {
    /// Puts every segment of `source` that is closed or cut, and not there yet, under the prefix; then tells the robot. A segment
    /// is there when the digest beside the object is the one that the robot computes from its disk, or has marked it with.
    ///
    /// # Errors
    /// When the link, the robot or the store fails. Objects appear whole or not at all.
    pub fn upload(
        &mut self,
        source: &mut dyn Source,
        options: &Options,
        clock: &mut dyn Clock,
        watch: &mut dyn Watch,
    ) -> Result<Report, BufferError> {
        let mut report = Report::default();
        let missing = self.missing(source.list()?, options, watch, &mut report)?;
        source.expect(missing.iter().map(|entry| entry.bytes).fold(0, u64::saturating_add));
        let mut pace = Pace::new(clock, options.limit);
        for entry in missing {
            let put = match self.put(source, &entry, watch, &mut pace, &mut report) {
                // Damaged on the way here: once more.
                Err(BufferError::Digest { name }) => {
                    watch.warns(&format!("{name} arrived damaged and is read once more"));
                    self.put(source, &entry, watch, &mut pace, &mut report)
                }
                put => put,
            };
            let digest = match put {
                // Gone or written to since it was listed; the next look sees to it.
                Err(BufferError::Refused { refusal, .. }) => {
                    watch.warns(&refusal.to_string());
                    continue;
                }
                put => put?,
            };
            let mark =
                if options.no_mark { Ok(()) } else { source.mark_pulled(&entry.name, &digest) };
            match mark {
                Err(BufferError::Refused { refusal, .. }) => {
                    report.unmarked += 1;
                    watch.warns(&refusal.to_string());
                }
                mark => mark?,
            }
            self.uploaded.insert(entry.name, (entry.bytes, entry.modified_ns));
        }
        Ok(report)
    }

    /// What is to be sent or compared, in order. The store is only asked when the robot has something new.
    fn missing(
        &mut self,
        entries: Vec<Entry>,
        options: &Options,
        watch: &mut dyn Watch,
        report: &mut Report,
    ) -> Result<Vec<Entry>, BufferError> {
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
                self.looked.get(&entry.name).filter(|there| there.entry.bytes == entry.bytes);
            let is_there = digest
                .and_then(|there| there.digest)
                .is_some_and(|digest| entry.pulled_digest() == Some(digest));
            report.there += u64::from(is_there);
            there_bytes += if is_there { entry.bytes } else { 0 };
            !is_there
        });
        options.order.sort(&mut missing);
        let missing_bytes: u64 = missing.iter().map(|entry| entry.bytes).sum();
        watch.planned(missing.len() as u64, there_bytes + missing_bytes, there_bytes);
        Ok(missing)
    }

    /// Sends one segment, unless the same bytes are there.
    fn put(
        &self,
        source: &mut dyn Source,
        entry: &Entry,
        watch: &mut dyn Watch,
        pace: &mut Pace<'_>,
        report: &mut Report,
    ) -> Result<Digest, BufferError> {
        let there = self.looked.get(&entry.name);
        let have = match there.filter(|there| there.entry.bytes == entry.bytes) {
            Some(there) => Have { bytes: entry.bytes, digest: self.digest_of(there)? },
            None => Have::nothing(),
        };
        let mut object = Object {
            bucket: self,
            name: &entry.name,
            hasher: Hasher::default(),
            parts: None,
            watch,
            pace,
        };
        let promised = source.fetch(&entry.name, have, &mut object);
        let (hasher, parts) = (object.hasher, object.parts);
        let is_new = parts.is_some();
        let digest = if is_new { hasher.digest() } else { have.digest };
        let outcome = match promised {
            Ok(promised) if promised == Some(digest) => Ok(digest),
            Ok(_) => Err(BufferError::Digest { name: entry.name.to_string() }),
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
            watch.complete(&entry.name, &digest);
        }
        outcome
    }

    /// The digest of an object; reads it where nothing says so: an upload may have ended between object and digest, or somebody
    /// else put it there.
    fn digest_of(&self, there: &Looked) -> Result<Digest, BufferError> {
        if let Some(digest) = there.digest {
            return Ok(digest);
        }
        let mut hasher = Hasher::default();
        let read = fetch::pieces(self.store.as_ref(), &there.seen, 0).try_for_each(|piece| {
            hasher.update(&piece);
            futures_util::future::ready(Ok(()))
        });
        self.runtime.block_on(read).map_err(|error| self.explain(&error, "read"))?;
        Ok(hasher.digest())
    }

    /// Gives an object its name, or takes its parts away again. What had the name before is kept beside it.
    fn finish(
        &self,
        name: &Name,
        parts: WriteMultipart,
        bytes: Option<u64>,
    ) -> Result<(), BufferError> {
        let path = self.path_of(name.as_str());
        let Some(bytes) = bytes else {
            // The reason why it ends counts; what is left of it the store throws away by its own rules.
            let _ = self.runtime.block_on(parts.abort());
            return Ok(());
        };
        let finished = self.runtime.block_on(async {
            if let Some(before) = self.looked.get(name) {
                let word = before
                    .digest
                    .map_or_else(|| before.seen.modified_ns().to_string(), |digest| digest.short());
                self.store.copy(&path, &self.path_of(&format!("{name}.{word}"))).await?;
            }
            parts.finish().await?;
            self.store.head(&path).await
        });
        let written = finished.map_err(|error| self.explain(&error, "write"))?.size;
        let detail = || {
            format!(
                "{name} has {written} bytes there, and {bytes} were sent; check the store, and upload again"
            )
        };
        if written == bytes {
            Ok(())
        } else {
            Err(BufferError::Store { url: self.url.clone(), detail: detail() })
        }
    }

    /// The same store, below `name`.
    #[must_use]
    pub fn below(self, name: &str) -> Self {
        Self {
            prefix: self.prefix.clone().join(name),
            url: format!("{}/{name}", self.url.trim_end_matches('/')),
            ..self
        }
    }
}

/// An object that grows.
struct Object<'a, 'b, 'c> {
    bucket: &'a Bucket,
    name: &'a Name,
    hasher: Hasher,
    /// None while nothing had to be sent.
    parts: Option<WriteMultipart>,
    watch: &'a mut dyn Watch,
    pace: &'b mut Pace<'c>,
}

impl Receive<BufferError> for Object<'_, '_, '_> {
    fn start(&mut self, from: u64, length: u64) -> Result<(), BufferError> {
        self.watch.begins(self.name, length, from);
        // Longer than it was: a part of an object cannot be kept.
        if from > 0 && from < length {
            let source =
                std::io::Error::other(format!("{} was written to since it was listed", self.name));
            return Err(BufferError::Link { to: self.bucket.url.clone(), source });
        }
        if from == 0 {
            let path: Path = self.bucket.path_of(self.name.as_str());
            let begun = self.bucket.runtime.block_on(self.bucket.store.put_multipart(&path));
            let begun = begun.map_err(|error| self.bucket.explain(&error, "write"))?;
            self.parts = Some(WriteMultipart::new_with_chunk_size(begun, PART));
        }
        Ok(())
    }

    fn data(&mut self, _at: u64, bytes: &[u8]) -> Result<(), BufferError> {
        if let Some(parts) = &mut self.parts {
            let written = self.bucket.runtime.block_on(async {
                parts.wait_for_capacity(AHEAD).await?;
                parts.write(bytes);
                Ok::<_, Error>(())
            });
            written.map_err(|error| self.bucket.explain(&error, "write"))?;
        }
        self.hasher.update(bytes);
        self.watch.arrived(bytes.len() as u64);
        self.pace.came(bytes.len());
        Ok(())
    }

    fn working(&mut self) -> Result<(), BufferError> {
        Ok(())
    }
}
