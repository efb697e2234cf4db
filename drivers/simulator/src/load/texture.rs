//! Decodes the image files of textures.

use std::path::Path;

use image::ImageFormat;

use crate::error::SceneError;
use crate::scene::Texture;

/// Larger images are refused: 16384 x 16384 texels are 1 GiB.
const MAX_SIDE: u32 = 16_384;

/// Decodes a PNG or JPEG image. `name` is for the error message.
pub fn decode(scene: &Path, name: &str, bytes: &[u8]) -> Result<Texture, SceneError> {
    let bad =
        |problem: String| SceneError::Texture { path: scene.into(), texture: name.into(), problem };
    let format = match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
        _ => return Err(bad(format!("it is {}, not PNG or JPEG; {}", kind(bytes), WAY_OUT))),
    };
    let mut reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), format);
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(2 << 30);
    reader.limits(limits);
    let image = reader.decode().map_err(|error| bad(error.to_string()))?.into_rgba8();
    Ok(Texture { width: image.width(), height: image.height(), rgba: image.into_raw() })
}

/// Advice for textures in an unsupported format.
pub const WAY_OUT: &str =
    "convert the scene's textures, for example with `gltf-transform png in.glb out.glb`";

/// Identifies the format of an unsupported image by its first bytes.
fn kind(bytes: &[u8]) -> &'static str {
    match bytes {
        [0xab, b'K', b'T', b'X', b' ', b'2', b'0', ..] => "KTX2 (Basis Universal)",
        [0x73, 0x42, ..] => "Basis Universal",
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => "WebP",
        [b'D', b'D', b'S', b' ', ..] => "DDS",
        [b'B', b'M', ..] => "BMP",
        [] => "empty",
        _ => "in an unknown format",
    }
}
