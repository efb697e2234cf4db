//! An object that is being uploaded, and encrypted if there are recipients.

use std::io;

use object_store::{Error, ObjectStoreExt, WriteMultipart};

use super::Bucket;
use super::encrypt::{Encrypted, Encryption};
use super::object_name::ObjectName;
use crate::pull::{Progress, RateLimiter};
use crate::{Digest, FileSink, Hasher, StoreError};

/// The size of a part. S3 accepts at most 10,000 parts of at least 5 MiB; with this size an object can have 80 GB.
const PART: usize = 8 << 20;

/// The number of parts in flight, besides the one that is being filled.
const AHEAD: usize = 3;

/// Receives a segment and sends it to the store.
pub(super) struct ObjectSink<'a, 'b, 'c> {
    bucket: &'a Bucket,
    name: &'a ObjectName,
    hasher: Hasher,
    /// `None` when the store already has the bytes.
    parts: Option<WriteMultipart>,
    encryption: Option<Encryption>,
    progress: &'a mut dyn Progress,
    limiter: &'b mut RateLimiter<'c>,
}

/// What was sent of an object. It is neither complete nor abandoned yet.
pub(super) struct Sent {
    pub parts: WriteMultipart,
    /// Length and digest of the segment.
    pub plain_bytes: u64,
    pub plain_digest: Digest,
    /// What the store has to have.
    pub stored: Result<Stored, StoreError>,
}

/// Length and digest of an object.
pub(super) struct Stored {
    pub bytes: u64,
    pub digest: Digest,
}

impl<'a, 'b, 'c> ObjectSink<'a, 'b, 'c> {
    pub fn new(
        bucket: &'a Bucket,
        name: &'a ObjectName,
        progress: &'a mut dyn Progress,
        limiter: &'b mut RateLimiter<'c>,
    ) -> Self {
        let hasher = Hasher::default();
        Self { bucket, name, hasher, parts: None, encryption: None, progress, limiter }
    }

    /// Sends the end of an encrypted object. `None` when nothing was to be sent.
    pub fn end(mut self) -> Option<Sent> {
        let stored = self.end_encryption();
        let parts = self.parts?;
        let plain_bytes = self.hasher.bytes();
        Some(Sent { parts, plain_bytes, plain_digest: self.hasher.digest(), stored })
    }

    fn end_encryption(&mut self) -> Result<Stored, StoreError> {
        let Some(encryption) = self.encryption.take() else {
            return Ok(Stored { bytes: self.hasher.bytes(), digest: self.hasher.digest() });
        };
        let Encrypted { rest, bytes, digest } =
            encryption.finish().map_err(|error| self.unencrypted(&error))?;
        self.send(&rest)?;
        Ok(Stored { bytes, digest })
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        let Some(parts) = &mut self.parts else { return Ok(()) };
        let sent = self.bucket.runtime.block_on(async {
            parts.wait_for_capacity(AHEAD).await?;
            parts.write(bytes);
            Ok::<_, Error>(())
        });
        sent.map_err(|error| self.bucket.explain(&error, "write"))
    }

    fn unencrypted(&self, error: &io::Error) -> StoreError {
        let detail = format!("{} cannot be encrypted: {error}; check --encrypt-to", self.name);
        StoreError::ObjectStore { url: self.bucket.url.clone(), detail }
    }
}

impl FileSink<StoreError> for ObjectSink<'_, '_, '_> {
    fn start(&mut self, from: u64, length: u64) -> Result<(), StoreError> {
        let segment = &self.name.segment;
        self.progress.file_started(segment, length, from);
        // The file has grown since it was listed; an object cannot be continued.
        if from > 0 && from < length {
            let source = io::Error::other(format!("{segment} was written to since it was listed"));
            return Err(StoreError::Link { to: self.bucket.url.clone(), source });
        }
        if from > 0 {
            return Ok(());
        }
        if self.name.is_encrypted {
            let begun = Encryption::begin(&self.bucket.keys.recipients);
            self.encryption = Some(begun.map_err(|error| self.unencrypted(&error))?);
        }
        let path = self.bucket.path_of(&self.name.to_string());
        let begun = self.bucket.runtime.block_on(self.bucket.store.put_multipart(&path));
        let begun = begun.map_err(|error| self.bucket.explain(&error, "write"))?;
        self.parts = Some(WriteMultipart::new_with_chunk_size(begun, PART));
        Ok(())
    }

    fn data(&mut self, _at: u64, bytes: &[u8]) -> Result<(), StoreError> {
        let encrypted = self.encryption.as_mut().map(|encryption| encryption.encrypt(bytes));
        match encrypted {
            Some(encrypted) => {
                let encrypted = encrypted.map_err(|error| self.unencrypted(&error))?;
                self.send(&encrypted)?;
            }
            None => self.send(bytes)?,
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
