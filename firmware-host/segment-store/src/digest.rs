//! BLAKE3 digests of files and of streams, as bytes and as text.

use std::fmt;
use std::io::{self, Read};
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The size of the buffer for reading files.
pub(crate) const PIECE: usize = 256 << 10;

/// The BLAKE3 digest of a file or of the beginning of a file.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Digest([u8; 32]);

impl Digest {
    #[must_use]
    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    #[must_use]
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// The digest of bytes in memory.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self(blake3::hash(bytes).into())
    }

    /// The first eight hexadecimal digits, for file names.
    #[must_use]
    pub fn short(&self) -> String {
        self.to_string().chars().take(8).collect()
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Digest({self})")
    }
}

impl FromStr for Digest {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let hash = blake3::Hash::from_hex(text).map_err(|_| "a digest is 64 hexadecimal digits")?;
        Ok(Self(hash.into()))
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// Computes a [`Digest`] incrementally and counts the bytes.
#[derive(Clone, Default)]
pub struct Hasher {
    state: blake3::Hasher,
    bytes: u64,
}

impl Hasher {
    pub fn update(&mut self, bytes: &[u8]) {
        self.state.update(bytes);
        self.bytes += bytes.len() as u64;
    }

    /// Adds all bytes of `source`, at most `limit`.
    ///
    /// # Errors
    /// When `source` cannot be read.
    pub fn update_from(&mut self, source: &mut impl Read, limit: u64) -> io::Result<()> {
        let mut buffer = vec![0; PIECE];
        let mut source = source.take(limit);
        loop {
            match source.read(&mut buffer) {
                Ok(0) => return Ok(()),
                Ok(read) => self.update(buffer.get(..read).unwrap_or_default()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// The number of bytes added so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The digest of the bytes added so far. More bytes can be added afterwards.
    #[must_use]
    pub fn digest(&self) -> Digest {
        Digest(self.state.finalize().into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_digest_parses_from_its_own_text_and_from_nothing_else() {
        // The empty input's digest, from the BLAKE3 test vectors.
        let text = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";
        assert_eq!(Digest::of(b"").to_string(), text);
        assert_eq!(text.parse(), Ok(Digest::of(b"")));
        assert_eq!(Digest::of(b"").short(), "af1349b9");
        for bad in ["", "af13", &text[1..], &text.replace('a', "g")] {
            assert!(bad.parse::<Digest>().is_err(), "{bad}");
        }
    }

    #[test]
    fn hashing_in_pieces_gives_the_digest_of_the_whole() {
        let bytes: Vec<u8> = (0..3 * PIECE as u32 + 17).map(|i| ((i * 31) >> 3) as u8).collect();
        let mut hasher = Hasher::default();
        hasher.update_from(&mut &bytes[..], u64::MAX).unwrap();
        assert_eq!((hasher.digest(), hasher.bytes()), (Digest::of(&bytes), bytes.len() as u64));
        let mut first = Hasher::default();
        first.update_from(&mut &bytes[..], 1000).unwrap();
        assert_eq!(first.digest(), Digest::of(&bytes[..1000]));
    }
}
