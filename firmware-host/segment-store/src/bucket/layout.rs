//! Where the parts of an encrypted file are.
//!
//! It is a header, a nonce of 16 bytes, and chunks of 64 KiB, each with a tag of 16 bytes. The last chunk may be shorter
//! (<https://age-encryption.org/v1>).

use age::Decryptor;

const CHUNK: u64 = 64 << 10;
const TAG: u64 = 16;
const ENCRYPTED_CHUNK: u64 = CHUNK + TAG;

/// Where the contents of an encrypted file begin, and how long they are without encryption.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    /// The offset of the first chunk.
    pub chunks_start: u64,
    /// The length of the decrypted contents.
    pub plain_bytes: u64,
}

impl Layout {
    /// The layout of an encrypted file of `bytes` bytes that begins with `head`. `None` when it has no valid header or no
    /// valid length.
    pub fn of(head: &[u8], bytes: u64) -> Option<Self> {
        let mut unread = head;
        Decryptor::new(&mut unread).ok()?;
        let chunks_start = (head.len() - unread.len()) as u64;
        let plain_bytes = decrypted_length(bytes.checked_sub(chunks_start)?)?;
        Some(Self { chunks_start, plain_bytes })
    }

    /// The offset of the chunk that contains offset `at` of the decrypted contents.
    pub fn chunk_of(&self, at: u64) -> u64 {
        self.chunks_start + at / CHUNK * ENCRYPTED_CHUNK
    }
}

/// The length of the contents of chunks that have `encrypted` bytes together. Only the one chunk of an empty file is empty.
fn decrypted_length(encrypted: u64) -> Option<u64> {
    let chunks = encrypted.div_ceil(ENCRYPTED_CHUNK);
    let last = encrypted.checked_sub(chunks.checked_sub(1)? * ENCRYPTED_CHUNK)?;
    let is_valid = last > TAG || last == TAG && chunks == 1;
    is_valid.then(|| encrypted - chunks * TAG)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_is_valid_exactly_when_chunks_can_have_it() {
        let whole = ENCRYPTED_CHUNK;
        for (encrypted, decrypted) in [
            (0, None),
            (15, None),
            (16, Some(0)),
            (17, Some(1)),
            (whole, Some(CHUNK)),
            (whole + 1, None),
            (whole + 16, None),
            (whole + 17, Some(CHUNK + 1)),
            (3 * whole, Some(3 * CHUNK)),
        ] {
            assert_eq!(decrypted_length(encrypted), decrypted, "{encrypted}");
        }
    }
}
