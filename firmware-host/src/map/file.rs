//! The file of a map.
//!
//! | bytes | content |
//! |---|---|
//! | 8 | [`MAGIC`] |
//! | 4 | [`MAP_FILE_VERSION`], little-endian |
//! | 32 | BLAKE3 digest of everything behind it |
//! | 4 | length of the next part, little-endian |
//! | | [`About`] as JSON |
//! | | the map state of [`Robot::map_state`](runtime::robot::Robot::map_state), compressed (RFC 1951) |

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::report::atomic::{ReportError, write_atomically};

/// First bytes of every map file.
pub const MAGIC: [u8; 8] = *b"EDMAP\r\n\x1a";

/// Increased whenever an older program would misread the file. The map state has a version of its own.
pub const MAP_FILE_VERSION: u32 = 1;

const DIGEST_BYTES: usize = 32;

/// Largest map state: a grid of 4096 x 4096 cells that is being recomposed has 185 MiB, 4,096 submaps have 40 MiB.
const MOST_STATE_BYTES: u64 = 512 << 20;

/// Why a map file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapFileError {
    /// The file cannot be read.
    #[error("cannot read the map {}: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// The file does not begin as map files do.
    #[error("{} is not a map; maps are written by `--map` and `firmware-host map save`", path.display())]
    NotAMap { path: PathBuf },
    /// Another version of this program wrote it.
    #[error(
        "the map {} has format {found}, this program knows {MAP_FILE_VERSION}: use the version that saved it, or another file",
        path.display()
    )]
    Version {
        path: PathBuf,
        /// Format of the file.
        found: u32,
    },
    /// The content is not what was written.
    #[error("the map {} is damaged: {what}; use a copy, or another file", path.display())]
    Damaged {
        path: PathBuf,
        /// What is wrong.
        what: &'static str,
    },
    /// The file cannot be written.
    #[error("the map is not saved: {0}")]
    Unwritable(#[from] ReportError),
}

/// What a file says of its map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// When it was saved, seconds since 1970.
    pub saved_unix_s: i64,
    /// Name and version of the program.
    pub written_by: String,
    /// Height of the scan plane above the floor, metres: at another height the home has other obstacles.
    pub scanner_height_m: f64,
}

impl About {
    /// A map that is saved now by this program.
    #[must_use]
    pub fn now(scanner_height_m: f64) -> Self {
        Self {
            saved_unix_s: Timestamp::now().as_second(),
            written_by: concat!("firmware-host ", env!("CARGO_PKG_VERSION")).to_owned(),
            scanner_height_m,
        }
    }
}

/// The content of a map file.
#[derive(Debug, Clone, PartialEq)]
pub struct MapFile {
    /// When and with what it was made.
    pub about: About,
    /// What [`Robot::load_map_state`](runtime::robot::Robot::load_map_state) takes.
    pub state: Vec<u8>,
}

impl MapFile {
    /// Reads a file and checks its digest.
    ///
    /// # Errors
    /// When it cannot be read, is not a map, or is damaged.
    pub fn read(path: &Path) -> Result<Self, MapFileError> {
        let bytes = std::fs::read(path)
            .map_err(|source| MapFileError::Unreadable { path: path.to_owned(), source })?;
        Self::decode(&bytes, path)
    }

    /// Writes the file whole: a file of this name stays as it was until the new one is complete on the disk.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), MapFileError> {
        Ok(write_atomically(path, &self.encode())?)
    }

    /// The bytes of the file.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        // Neither a struct of numbers and text nor a buffer in memory can fail.
        let about = serde_json::to_vec(&self.about).unwrap_or_default();
        let mut content = (about.len() as u32).to_le_bytes().to_vec();
        content.extend_from_slice(&about);
        let mut encoder = DeflateEncoder::new(content, Compression::default());
        let content = encoder.write_all(&self.state).and_then(|()| encoder.finish());
        let content = content.unwrap_or_default();
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(&MAP_FILE_VERSION.to_le_bytes());
        bytes.extend_from_slice(blake3::hash(&content).as_bytes());
        bytes.extend_from_slice(&content);
        bytes
    }

    /// Reads the bytes of a file. `path` only names it in errors.
    ///
    /// # Errors
    /// When they are not those of a map, or damaged.
    pub fn decode(bytes: &[u8], path: &Path) -> Result<Self, MapFileError> {
        let Some(rest) = bytes.strip_prefix(&MAGIC) else {
            return Err(MapFileError::NotAMap { path: path.to_owned() });
        };
        let (version, rest) = rest.split_first_chunk().ok_or_else(|| truncated(path))?;
        let found = u32::from_le_bytes(*version);
        if found != MAP_FILE_VERSION {
            return Err(MapFileError::Version { path: path.to_owned(), found });
        }
        let (digest, content) =
            rest.split_first_chunk::<DIGEST_BYTES>().ok_or_else(|| truncated(path))?;
        if blake3::hash(content) != *digest {
            return Err(damaged(path, "its digest is not that of its content"));
        }
        let (length, rest) = content.split_first_chunk().ok_or_else(|| truncated(path))?;
        let length = u32::from_le_bytes(*length) as usize;
        let (about, packed) = rest.split_at_checked(length).ok_or_else(|| truncated(path))?;
        let about = serde_json::from_slice(about)
            .map_err(|_| damaged(path, "its description is not that of a map"))?;
        let mut state = Vec::new();
        let unpacked = DeflateDecoder::new(packed).take(MOST_STATE_BYTES).read_to_end(&mut state);
        unpacked.map_err(|_| damaged(path, "its content cannot be unpacked"))?;
        Ok(Self { about, state })
    }
}

fn damaged(path: &Path, what: &'static str) -> MapFileError {
    MapFileError::Damaged { path: path.to_owned(), what }
}

fn truncated(path: &Path) -> MapFileError {
    damaged(path, "it is truncated")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn file(state: Vec<u8>) -> MapFile {
        MapFile { about: About::now(0.2), state }
    }

    fn decoded(bytes: &[u8]) -> Result<MapFile, MapFileError> {
        MapFile::decode(bytes, Path::new("home.map"))
    }

    proptest! {
        #[test]
        fn a_map_is_read_back_as_it_was_written(state in prop::collection::vec(any::<u8>(), 0..2000)) {
            let file = file(state);
            prop_assert_eq!(decoded(&file.encode()).unwrap(), file);
        }

        #[test]
        fn one_changed_byte_anywhere_is_noticed(at in any::<prop::sample::Index>(), change in 1..=255u8) {
            let mut bytes = file((0..900u32).map(|value| (value / 7) as u8).collect()).encode();
            let at = at.index(bytes.len());
            bytes[at] ^= change;
            prop_assert!(decoded(&bytes).is_err());
        }
    }

    #[test]
    fn a_truncated_file_is_refused_wherever_it_was_cut() {
        let bytes = file(vec![7; 300]).encode();
        for len in 0..bytes.len() {
            assert!(decoded(&bytes[..len]).is_err(), "{len}");
        }
    }

    #[test]
    fn each_defect_is_named_with_the_file_and_the_way_out() {
        let good = file(vec![1, 2, 3]).encode();
        let mut newer = good.clone();
        newer[MAGIC.len()] = 9;
        let mut damaged = good;
        *damaged.last_mut().unwrap() ^= 1;
        for (bytes, words) in [
            (&newer, ["home.map has format 9", "use the version that saved it"]),
            (&damaged, ["home.map is damaged: its digest", "use a copy"]),
            (&b"PNG".to_vec(), ["home.map is not a map", "firmware-host map save"]),
        ] {
            let error = decoded(bytes).unwrap_err().to_string();
            assert!(words.iter().all(|word| error.contains(word)), "{error}");
        }
    }

    #[test]
    fn a_map_is_replaced_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("home.map");
        file(vec![1]).write(&path).unwrap();
        let newer = file(vec![2; 5000]);
        newer.write(&path).unwrap();
        assert_eq!(MapFile::read(&path).unwrap(), newer);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
