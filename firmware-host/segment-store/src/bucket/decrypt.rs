//! Decryption of encrypted segments. Every byte is authenticated, and so is the end of the file.

use std::io::{self, Read, Seek, SeekFrom};

use age::stream::StreamReader;
use age::{DecryptError, Decryptor};

use super::keys::Keys;
use super::object_file::offset;

/// Opens an encrypted file with any of the identities.
pub(super) fn open<R: Read>(file: R, keys: &Keys) -> Result<StreamReader<R>, DecryptError> {
    let identities = keys.identities.iter().map(|identity| identity as &dyn age::Identity);
    Decryptor::new(file)?.decrypt(identities)
}

/// The end of the decrypted contents, from offset `start` on.
pub(super) fn end(file: Ends<'_>, start: u64, keys: &Keys) -> Result<Vec<u8>, DecryptError> {
    let mut file = open(file, keys)?;
    let mut end = Vec::new();
    file.seek(SeekFrom::Start(start))?;
    file.read_to_end(&mut end)?;
    Ok(end)
}

/// Beginning and end of an encrypted file in memory. What is between them cannot be read.
pub(super) struct Ends<'a> {
    pub head: &'a [u8],
    pub tail: &'a [u8],
    /// The offset of `tail`.
    pub tail_start: u64,
    pub at: u64,
}

impl Read for Ends<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let part = match self.at.checked_sub(self.tail_start) {
            Some(at) => usize::try_from(at).ok().and_then(|at| self.tail.get(at..)),
            None => usize::try_from(self.at).ok().and_then(|at| self.head.get(at..)),
        };
        let read = part.unwrap_or_default().read(into)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for Ends<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = offset(to, self.at, self.tail_start + self.tail.len() as u64)?;
        Ok(self.at)
    }
}
