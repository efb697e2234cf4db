//! An encrypted object as a file that can be read from any offset.

use std::io::{self, Read, Seek, SeekFrom};

use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::BoxStream;
use object_store::{Error, ObjectStore};
use tokio::runtime::Runtime;

use super::fetch;
use super::object::ObjectVersion;

/// An encrypted object as a file. Its errors contain those of the object store.
pub(super) struct ObjectFile<'a> {
    runtime: &'a Runtime,
    store: &'a dyn ObjectStore,
    version: &'a ObjectVersion,
    /// The beginning of the object, up to its first chunk. It is read before another offset is chosen, and requests for what
    /// follows it would be in vain.
    head: Bytes,
    at: u64,
    /// The requests for the bytes from `at` on, and what was received of them.
    pieces: Option<BoxStream<'a, Result<Bytes, Error>>>,
    piece: Bytes,
}

impl<'a> ObjectFile<'a> {
    pub fn open(
        runtime: &'a Runtime,
        store: &'a dyn ObjectStore,
        version: &'a ObjectVersion,
        chunks_start: u64,
    ) -> Result<Self, Error> {
        let head = runtime.block_on(version.get(store, 0..chunks_start))?;
        Ok(Self { runtime, store, version, head, at: 0, pieces: None, piece: Bytes::new() })
    }

    /// Receives the next piece, unless there is one already.
    fn receive(&mut self) -> io::Result<()> {
        if !self.piece.is_empty() {
            return Ok(());
        }
        let begin = || fetch::pieces(self.store, self.version, self.at).boxed();
        let pieces = self.pieces.get_or_insert_with(begin);
        let piece = self.runtime.block_on(pieces.next());
        self.piece = piece.transpose().map_err(io::Error::other)?.unwrap_or_default();
        Ok(())
    }
}

impl Read for ObjectFile<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let head = usize::try_from(self.at).ok().and_then(|at| self.head.get(at..));
        let read = match head.filter(|head| !head.is_empty()) {
            Some(mut head) => head.read(into)?,
            None => {
                self.receive()?;
                let length = into.len().min(self.piece.len());
                self.piece.split_to(length).as_ref().read(into)?
            }
        };
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for ObjectFile<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = offset(to, self.at, self.version.bytes())?;
        if at != self.at {
            self.at = at;
            self.pieces = None;
            self.piece = Bytes::new();
        }
        Ok(at)
    }
}

/// The offset that is sought, in a file of `length` bytes that is at offset `at`.
pub(super) fn offset(to: SeekFrom, at: u64, length: u64) -> io::Result<u64> {
    let offset = match to {
        SeekFrom::Start(offset) => Some(offset),
        SeekFrom::Current(by) => at.checked_add_signed(by),
        SeekFrom::End(by) => length.checked_add_signed(by),
    };
    offset.ok_or_else(|| io::ErrorKind::InvalidInput.into())
}
