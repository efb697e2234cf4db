//! Decoder of the camera's JPEG frames.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

use super::ImagingError;

/// JPEG's own limit; the size is compared before decoding.
const LARGEST: usize = u16::MAX as usize;
/// Marker EOI (ITU-T T.81, table B.1). Some cameras add padding after it.
const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];

/// Decodes a JPEG file of `width` x `height` into `rgb`, three bytes per pixel. JPEG's YUV is full range by definition (JFIF).
/// A truncated file is an error: the grey remainder of the image would look like a wall.
pub(super) fn decode(
    data: &[u8],
    (width, height): (usize, usize),
    rgb: &mut [u8],
) -> Result<(), ImagingError> {
    // The decoder fills missing data at the very end without an error.
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
    decoder.decode_headers().map_err(|error| decode_error(&error))?;
    match decoder.dimensions() {
        Some(size) if size == (width, height) => {
            decoder.decode_into(rgb).map_err(|error| decode_error(&error))
        }
        size => {
            let (found_width, found_height) = size.unwrap_or_default();
            Err(ImagingError::JpegSize { width, height, found_width, found_height })
        }
    }
}

fn decode_error(error: &DecodeErrors) -> ImagingError {
    ImagingError::Jpeg { reason: error.to_string() }
}
