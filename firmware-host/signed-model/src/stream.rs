//! A model and its signature in memory, read from two files or from one stream.
//!
//! The stream consists of the line `embodied-depth bundle 1`, the line `NAME MODEL_BYTES SIGNATURE_BYTES`, the bytes of the
//! model and the bytes of the signature. Sizes are checked before anything is read or allocated.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use crate::BundleError;
use crate::name::is_model_name;

/// Largest model that is accepted. The trainer's largest network has 100 MiB.
pub const MAX_MODEL_BYTES: u64 = 512 << 20;
/// Largest signature that is accepted. Those that minisign writes have about 300 bytes.
pub const MAX_SIGNATURE_BYTES: u64 = 4096;

const MAGIC: &str = "embodied-depth bundle 1";
const MAX_LINE_LEN: u64 = 128;

/// A model and its signature, neither of which has been verified yet.
#[derive(Clone, PartialEq, Eq)]
pub struct Bundle {
    /// File name without `.onnx`.
    pub name: String,
    pub model: Vec<u8>,
    pub signature: String,
}

impl std::fmt::Debug for Bundle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "bundle {} ({} bytes)", self.name, self.model.len())
    }
}

impl Bundle {
    /// The path of a model's signature: the model's path with `.minisig` appended.
    #[must_use]
    pub fn signature_path(model: &Path) -> PathBuf {
        let mut path = OsString::from(model);
        path.push(".minisig");
        path.into()
    }

    /// The model's name: the name of its file without `.onnx`.
    ///
    /// # Errors
    /// [`BundleError::Name`] when that is not a valid name.
    pub fn name_of(model: &Path) -> Result<String, BundleError> {
        let name = model.file_name().unwrap_or_default().to_string_lossy();
        let name = name.strip_suffix(".onnx").unwrap_or(&name);
        if is_model_name(name) {
            Ok(name.to_owned())
        } else {
            Err(BundleError::Name { name: name.to_owned() })
        }
    }

    /// Reads `NAME.onnx` and the signature beside it.
    ///
    /// # Errors
    /// When a file is missing, cannot be read or is too large.
    pub fn read_files(model: &Path) -> Result<Self, BundleError> {
        let signature_path = Self::signature_path(model);
        let name = Self::name_of(model)?;
        let bytes = read_file(model, "model", MAX_MODEL_BYTES)?;
        let signature = match read_file(&signature_path, "signature", MAX_SIGNATURE_BYTES) {
            Err(BundleError::File { reason, .. }) if reason.kind() == io::ErrorKind::NotFound => {
                return Err(BundleError::Unsigned { path: signature_path });
            }
            read => read?,
        };
        Ok(Self { name, model: bytes, signature: as_text(signature)? })
    }

    /// Reads a bundle that [`write_stream`](Self::write_stream) wrote.
    ///
    /// # Errors
    /// When the stream ends early, is not a bundle or announces too large a size.
    pub fn read_stream(stream: impl Read) -> Result<Self, BundleError> {
        let mut stream = BufReader::new(stream);
        let magic = read_line(&mut stream)?;
        if magic != MAGIC {
            return Err(BundleError::NoBundle { found: magic.chars().take(40).collect() });
        }
        let line = read_line(&mut stream)?;
        let (name, model_bytes, signature_bytes) =
            parse_header(&line).ok_or_else(|| BundleError::NoBundle { found: line.clone() })?;
        let model = read_exactly(&mut stream, "model", model_bytes, MAX_MODEL_BYTES)?;
        let signature =
            read_exactly(&mut stream, "signature", signature_bytes, MAX_SIGNATURE_BYTES)?;
        Ok(Self { name, model, signature: as_text(signature)? })
    }

    /// # Errors
    /// When the stream cannot be written.
    pub fn write_stream(&self, mut stream: impl Write) -> io::Result<()> {
        let Self { name, model, signature } = self;
        write!(stream, "{MAGIC}\n{name} {} {}\n", model.len(), signature.len())?;
        stream.write_all(model)?;
        stream.write_all(signature.as_bytes())?;
        stream.flush()
    }
}

fn as_text(signature: Vec<u8>) -> Result<String, BundleError> {
    String::from_utf8(signature)
        .map_err(|error| BundleError::SignatureForm { reason: error.to_string() })
}

fn parse_header(line: &str) -> Option<(String, u64, u64)> {
    let mut words = line.split(' ');
    let name = words.next()?;
    let model = words.next()?.parse().ok()?;
    let signature = words.next()?.parse().ok()?;
    (is_model_name(name) && words.next().is_none()).then(|| (name.to_owned(), model, signature))
}

fn read_line(stream: &mut impl BufRead) -> Result<String, BundleError> {
    let mut line = Vec::new();
    stream
        .take(MAX_LINE_LEN)
        .read_until(b'\n', &mut line)
        .map_err(|reason| BundleError::Stream { reason })?;
    if line.pop_if(|last| *last == b'\n').is_none() {
        return Err(BundleError::NoBundle {
            found: String::from_utf8_lossy(&line).chars().take(40).collect(),
        });
    }
    Ok(String::from_utf8_lossy(&line).into_owned())
}

fn read_file(path: &Path, what: &'static str, most: u64) -> Result<Vec<u8>, BundleError> {
    let file = File::open(path).map_err(|reason| BundleError::unreadable(path, reason))?;
    let about = file.metadata().map_err(|reason| BundleError::unreadable(path, reason))?;
    let bytes = about.len();
    if bytes > most {
        return Err(BundleError::TooLarge { what, bytes, most });
    }
    let mut read = Vec::new();
    // The metadata is not enough: a file can grow while it is read, and a device reports no length.
    file.take(most + 1)
        .read_to_end(&mut read)
        .map_err(|reason| BundleError::unreadable(path, reason))?;
    let bytes = read.len() as u64;
    if bytes > most { Err(BundleError::TooLarge { what, bytes, most }) } else { Ok(read) }
}

fn read_exactly(
    stream: &mut impl Read,
    what: &'static str,
    bytes: u64,
    most: u64,
) -> Result<Vec<u8>, BundleError> {
    if bytes > most {
        return Err(BundleError::TooLarge { what, bytes, most });
    }
    // The buffer grows with the bytes that arrive, so a false size allocates nothing.
    let mut read = Vec::new();
    stream.take(bytes).read_to_end(&mut read).map_err(|reason| BundleError::Stream { reason })?;
    if (read.len() as u64) < bytes {
        let reason = io::Error::new(
            io::ErrorKind::UnexpectedEof,
            format!("{} of {bytes} bytes of the {what}", read.len()),
        );
        return Err(BundleError::Stream { reason });
    }
    Ok(read)
}
