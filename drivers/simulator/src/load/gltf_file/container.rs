//! The glTF document and its buffers.

use std::path::{Path, PathBuf};

use gltf::json::{Index, Root, root::Get, validation::USize64};

use super::super::read_bytes;
use super::super::texture::WAY_OUT as CONVERT_TEXTURES;
use crate::error::SceneError;

/// A glTF document with all of its bytes in memory.
pub(super) struct File {
    pub path: PathBuf,
    pub root: Root,
    pub buffers: Vec<Vec<u8>>,
}

/// Required extensions that are supported, or that do not affect the data used here.
const HARMLESS: [&str; 3] =
    ["KHR_texture_transform", "KHR_mesh_quantization", "KHR_lights_punctual"];

impl File {
    pub fn open(path: &Path) -> Result<Self, SceneError> {
        let bytes = read_bytes(path)?;
        let malformed =
            |problem: String| SceneError::Malformed { path: path.into(), format: "glTF", problem };
        let (json, mut blob) = if bytes.starts_with(b"glTF") {
            split_glb(&bytes).map_err(malformed)?
        } else {
            (&bytes[..], None)
        };
        let root: Root = gltf::json::deserialize::from_slice(json)
            .map_err(|error| malformed(error.to_string()))?;
        let mut file = Self { path: path.into(), root, buffers: Vec::new() };
        file.check_extensions()?;
        for (index, buffer) in file.root.buffers.iter().enumerate() {
            let bytes = match &buffer.uri {
                Some(uri) => file.fetch(uri, "buffer")?,
                None => blob
                    .take()
                    .ok_or_else(|| file.malformed(format!("buffer {index} has no bytes")))?
                    .to_vec(),
            };
            let expected = size(buffer.byte_length);
            if bytes.len() < expected {
                let problem = format!(
                    "buffer {index} has {} bytes instead of {expected}; is it cut off?",
                    bytes.len()
                );
                return Err(file.malformed(problem));
            }
            file.buffers.push(bytes);
        }
        Ok(file)
    }

    pub fn malformed(&self, problem: String) -> SceneError {
        SceneError::Malformed { path: self.path.clone(), format: "glTF", problem }
    }

    pub fn unsupported(&self, feature: impl Into<String>, way_out: &'static str) -> SceneError {
        SceneError::Unsupported { path: self.path.clone(), feature: feature.into(), way_out }
    }

    /// An object of the document.
    pub fn get<T>(&self, index: Index<T>, what: &str) -> Result<&T, SceneError>
    where
        Root: Get<T>,
    {
        self.root
            .get(index)
            .ok_or_else(|| self.malformed(format!("there is no {what} {}", index.value())))
    }

    /// The bytes of a buffer view.
    pub fn view(&self, index: Index<gltf::json::buffer::View>) -> Result<&[u8], SceneError> {
        let view = self.get(index, "buffer view")?;
        let start = view.byte_offset.map_or(0, size);
        let bytes = self
            .buffers
            .get(view.buffer.value())
            .and_then(|buffer| buffer.get(start..start.checked_add(size(view.byte_length))?));
        bytes.ok_or_else(|| {
            self.malformed(format!("buffer view {} lies outside of its buffer", index.value()))
        })
    }

    /// The bytes of a URI: embedded data or a file beside the scene. Nothing is fetched from a
    /// network.
    pub fn fetch(&self, uri: &str, what: &'static str) -> Result<Vec<u8>, SceneError> {
        if uri.starts_with("data:") {
            return match gltf::buffer::Data::from_source(gltf::buffer::Source::Uri(uri), None) {
                Ok(data) => Ok(data.0),
                Err(error) => {
                    Err(self.malformed(format!("an embedded {what} cannot be decoded: {error}")))
                }
            };
        }
        let name = percent_decoded(uri);
        let file = self.path.parent().unwrap_or(Path::new("")).join(name.as_deref().unwrap_or(uri));
        if uri.contains("://") || !file.is_file() {
            return Err(SceneError::MissingFile { path: self.path.clone(), what, file });
        }
        read_bytes(&file)
    }

    fn check_extensions(&self) -> Result<(), SceneError> {
        for extension in &self.root.extensions_required {
            let way_out = match extension.as_str() {
                name if HARMLESS.contains(&name) || name.starts_with("KHR_materials_") => continue,
                "KHR_draco_mesh_compression"
                | "EXT_meshopt_compression"
                | "KHR_meshopt_compression" => {
                    "decompress it, for example with `gltf-transform copy in.glb out.glb`"
                }
                "KHR_texture_basisu"
                | "GOOGLE_texture_basis"
                | "EXT_texture_webp"
                | "EXT_texture_avif" => CONVERT_TEXTURES,
                _ => "export the scene without it",
            };
            return Err(self.unsupported(format!("the glTF extension {extension}"), way_out));
        }
        Ok(())
    }
}

/// Converts a size or offset of the document. A value that exceeds `usize` becomes `usize::MAX`,
/// which lies outside of every buffer.
pub(super) fn size(value: USize64) -> usize {
    usize::try_from(value.0).unwrap_or(usize::MAX)
}

/// The JSON chunk and the binary chunk of a GLB file (glTF 2.0, section 4.4).
fn split_glb(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    match word_at(4, bytes) {
        Some(2) => {}
        Some(version) => return Err(format!("it is GLB version {version}, only 2 can be read")),
        None => return Err("it ends within its header".into()),
    }
    let mut chunks = [None, None];
    let mut at = 12;
    for (chunk, kind) in chunks.iter_mut().zip([0x4e4f_534a, 0x004e_4942]) {
        let (Some(length), Some(found)) = (word_at(at, bytes), word_at(at + 4, bytes)) else {
            break;
        };
        if found != kind {
            return Err(format!("the chunk at byte {at} is not of the expected kind"));
        }
        let end = (at + 8).saturating_add(length);
        *chunk = Some(
            bytes
                .get(at + 8..end)
                .ok_or(format!("it is cut off: byte {end} of {}", bytes.len()))?,
        );
        at = end;
    }
    let [json, blob] = chunks;
    Ok((json.ok_or("it has no JSON chunk")?, blob))
}

/// The little-endian 32-bit number at a byte offset.
fn word_at(at: usize, bytes: &[u8]) -> Option<usize> {
    bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(|b| u32::from_le_bytes(b) as usize)
}

/// Decodes percent escapes: `a%20b` becomes `a b`. `None` when the result is not UTF-8.
fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, tail @ ..] = rest {
        let escaped = (*first == b'%').then(|| std::str::from_utf8(tail.get(..2)?).ok()).flatten();
        match escaped.and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(byte) => {
                bytes.push(byte);
                rest = &tail[2..];
            }
            None => {
                bytes.push(*first);
                rest = tail;
            }
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_escapes_and_without_are_decoded() {
        assert_eq!(percent_decoded("wood%20floor%C3%A4.png").as_deref(), Some("wood floorä.png"));
        assert_eq!(percent_decoded("100%.png").as_deref(), Some("100%.png"));
        assert_eq!(percent_decoded("%ff"), None);
    }

    #[test]
    fn a_glb_truncated_at_any_byte_is_refused_without_panic() {
        let json = b"{\"asset\":{\"version\":\"2.0\"}} ";
        let mut whole = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        whole.extend((json.len() as u32).to_le_bytes());
        whole.extend(b"JSON");
        whole.extend(json);
        assert_eq!(split_glb(&whole), Ok((&json[..], None)));
        for end in 0..whole.len() {
            assert!(split_glb(&whole[..end]).is_err(), "{end} bytes");
        }
    }
}
