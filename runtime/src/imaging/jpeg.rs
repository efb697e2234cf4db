//! The camera's JPEG pictures.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::ImagingError;

/// JPEG's own limit: the size is compared before anything is decoded.
const LARGEST: usize = u16::MAX as usize;
/// Marker EOI (ITU-T T.81, table B.1). Cameras may pad behind it.
const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];

/// Decodes a JPEG file of `width` x `height` into `rgb`, three bytes a pixel. JPEG's YUV is full range by definition (JFIF).
/// A file that ends early is an error: half a picture would be taken for a grey wall.
pub(super) fn decode(
    data: &[u8],
    (width, height): (usize, usize),
    rgb: &mut [u8],
) -> Result<(), ImagingError> {
    // The decoder fills up what is missing at the very end without a word.
    if !data.windows(2).rev().any(|bytes| bytes == END_OF_IMAGE) {
        return Err(ImagingError::Jpeg {
            reason: "it ends early: no end-of-image marker".to_owned(),
        });
    }
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(LARGEST)
        .set_max_height(LARGEST)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    let broken =
        |error: zune_jpeg::errors::DecodeErrors| ImagingError::Jpeg { reason: error.to_string() };
    decoder.decode_headers().map_err(broken)?;
    match decoder.dimensions() {
        Some(size) if size == (width, height) => decoder.decode_into(rgb).map_err(broken),
        size => {
            let (found_width, found_height) = size.unwrap_or_default();
            Err(ImagingError::JpegSize { width, height, found_width, found_height })
        }
    }
}
