//! Delivery of a segment's bytes to a pull, decrypted where they are encrypted.

use std::io::{self, Read, Seek, SeekFrom};

use futures_util::StreamExt;
use object_store::Error;

use super::layout::Layout;
use super::object::InspectedSegment;
use super::object_file::ObjectFile;
use super::{Bucket, decrypt, fetch, unread};
use crate::wire::RefusalKind;
use crate::{FileSink, Name, StoreError};

impl Bucket {
    /// Delivers the bytes of a segment that is not encrypted, from offset `from` on.
    pub(super) fn fetch_plain(
        &self,
        segment: &InspectedSegment,
        from: u64,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<(), StoreError> {
        let mut at = from;
        let version = &segment.objects.version;
        let mut pieces = Box::pin(fetch::pieces(self.store.as_ref(), version, from));
        while let Some(piece) = self.runtime.block_on(pieces.next()) {
            let piece = piece.map_err(|error| self.unreadable(segment, &error))?;
            for bytes in piece.chunks(fetch::SINK_PIECE) {
                to.data(at, bytes)?;
                at += bytes.len() as u64;
            }
        }
        Ok(())
    }

    /// Delivers the decrypted bytes of an encrypted segment, from offset `from` on.
    pub(super) fn fetch_encrypted(
        &self,
        segment: &InspectedSegment,
        layout: Layout,
        from: u64,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<(), StoreError> {
        let version = &segment.objects.version;
        let object =
            ObjectFile::open(&self.runtime, self.store.as_ref(), version, layout.chunks_start)
                .map_err(|error| self.unreadable(segment, &error))?;
        let mut file = decrypt::open(object, &self.keys)
            .map_err(|error| self.undecrypted(segment, io::Error::other(error)))?;
        file.seek(SeekFrom::Start(from)).map_err(|error| self.undecrypted(segment, error))?;
        let mut at = from;
        let mut buffer = vec![0; fetch::SINK_PIECE];
        // Up to the end of the file, where it turns out whether the last chunk was the last one.
        loop {
            let read = file.read(&mut buffer).map_err(|error| self.undecrypted(segment, error))?;
            if read == 0 {
                return Ok(());
            }
            to.data(at, buffer.get(..read).unwrap_or_default())?;
            at += read as u64;
        }
    }

    /// The error for an encrypted segment that arrived damaged. The first time, the link may be the cause, and it is read once
    /// more. The second time, it is not read again until its object changes.
    pub(super) fn damaged(&mut self, name: &Name, why: String) -> StoreError {
        match self.inspected.get_mut(name) {
            Some(segment) if segment.arrived_damaged => segment.unread = Some(why.clone()),
            Some(segment) => {
                segment.arrived_damaged = true;
                return StoreError::Digest { name: name.to_string() };
            }
            None => {}
        }
        StoreError::Unread(why)
    }

    /// The error for an object that cannot be read.
    fn unreadable(&self, segment: &InspectedSegment, error: &Error) -> StoreError {
        match error {
            Error::Precondition { .. } | Error::NotFound { .. } => self.refused(
                RefusalKind::Changed,
                format!(
                    "{} was replaced or removed while it was read; pull again",
                    segment.objects.name
                ),
            ),
            error => self.explain(error, "read"),
        }
    }

    /// The error for an encrypted object that cannot be read, or is not what was encrypted.
    fn undecrypted(&self, segment: &InspectedSegment, error: io::Error) -> StoreError {
        match error.downcast::<Error>() {
            Ok(error) => self.unreadable(segment, &error),
            Err(error) => StoreError::Unread(unread::damaged(&segment.objects.name, error)),
        }
    }
}
