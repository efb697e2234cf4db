//! Encryption of a segment while it is uploaded, in the age format (<https://age-encryption.org/v1>).

use std::cell::RefCell;
use std::io::{self, Write};
use std::rc::Rc;

use age::Encryptor;
use age::stream::StreamWriter;
use age::x25519::Recipient;

use crate::{Digest, Hasher};

/// Encrypts a stream of bytes. One chunk of 64 KiB is in memory, besides the bytes that are passed.
pub(super) struct Encryption {
    writer: StreamWriter<Output>,
    output: Output,
    hasher: Hasher,
}

/// What was encrypted completely.
pub(super) struct Encrypted {
    /// The bytes that have not been taken yet.
    pub rest: Vec<u8>,
    /// The number of all encrypted bytes.
    pub bytes: u64,
    /// The digest of all encrypted bytes.
    pub digest: Digest,
}

impl Encryption {
    /// Begins a file with a key of its own.
    ///
    /// # Errors
    /// When `recipients` is empty.
    pub fn begin(recipients: &[Recipient]) -> io::Result<Self> {
        let recipients = recipients.iter().map(|recipient| recipient as &dyn age::Recipient);
        let encryptor = Encryptor::with_recipients(recipients).map_err(io::Error::other)?;
        let output = Output::default();
        let writer = encryptor.wrap_output(output.clone())?;
        Ok(Self { writer, output, hasher: Hasher::default() })
    }

    /// Encrypts the next bytes, and returns what of the encrypted file is complete.
    pub fn encrypt(&mut self, bytes: &[u8]) -> io::Result<Vec<u8>> {
        self.writer.write_all(bytes)?;
        let encrypted = self.output.take();
        self.hasher.update(&encrypted);
        Ok(encrypted)
    }

    /// Encrypts the last chunk. A file without it is refused by every reader as cut.
    pub fn finish(mut self) -> io::Result<Encrypted> {
        let rest = self.writer.finish()?.take();
        self.hasher.update(&rest);
        Ok(Encrypted { rest, bytes: self.hasher.bytes(), digest: self.hasher.digest() })
    }
}

/// Collects what the age library writes, because its writer does not give access to the one inside.
#[derive(Clone, Default)]
struct Output(Rc<RefCell<Vec<u8>>>);

impl Output {
    fn take(&self) -> Vec<u8> {
        self.0.take()
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
