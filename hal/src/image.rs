//! Borrowed images and their pixel formats.

use core::fmt;

/// How the bytes of an image are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum PixelFormat {
    /// Three bytes per pixel: red, green, blue.
    Rgb8,
    /// One byte of brightness per pixel.
    Gray8,
    /// YUV 4:2:2 packed as Y0 U Y1 V: two bytes per pixel, even width.
    Yuyv,
    /// YUV 4:2:0: a plane of Y, then a plane of interleaved U and V at half the resolution; even
    /// width and height.
    Nv12,
    /// A complete JPEG file as compressed by the camera.
    Mjpeg,
}

impl PixelFormat {
    /// The number of bytes of an image of this size. `None` when it depends on the content or
    /// overflows.
    #[must_use]
    pub fn bytes(self, width: usize, height: usize) -> Option<usize> {
        let pixels = width.checked_mul(height)?;
        match self {
            Self::Rgb8 => pixels.checked_mul(3),
            Self::Gray8 => Some(pixels),
            Self::Yuyv => pixels.checked_mul(2),
            Self::Nv12 => pixels.checked_add(pixels / 2),
            Self::Mjpeg => None,
        }
    }

    /// Whether an image of this format can have this size.
    fn allows(self, width: usize, height: usize) -> bool {
        let even = match self {
            Self::Yuyv => width.is_multiple_of(2),
            Self::Nv12 => width.is_multiple_of(2) && height.is_multiple_of(2),
            Self::Rgb8 | Self::Gray8 | Self::Mjpeg => true,
        };
        width > 0 && height > 0 && even
    }
}

/// The bytes do not match the declared size and format of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ImageError {
    /// Width or height is zero, or odd where the format needs pairs.
    Size { width: usize, height: usize, format: PixelFormat },
    /// There are too many or too few bytes.
    Length {
        /// Number of bytes that the size and format require.
        expected: usize,
        /// Number of bytes that were given.
        actual: usize,
    },
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Size { width, height, format } => {
                write!(f, "a {format:?} image cannot be {width}x{height}")
            }
            Self::Length { expected, actual } => {
                write!(f, "the image has {actual} bytes, its size requires {expected}")
            }
        }
    }
}

impl core::error::Error for ImageError {}

/// A borrowed image: row-major, without padding between rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageView<'a> {
    width: usize,
    height: usize,
    format: PixelFormat,
    data: &'a [u8],
}

impl<'a> ImageView<'a> {
    /// Checks that `data` matches the size and format, so that later reads cannot be out of bounds.
    ///
    /// # Errors
    /// When the size is impossible for the format, or `data` has another length.
    pub fn new(
        width: usize,
        height: usize,
        format: PixelFormat,
        data: &'a [u8],
    ) -> Result<Self, ImageError> {
        if !format.allows(width, height) {
            return Err(ImageError::Size { width, height, format });
        }
        match format.bytes(width, height) {
            Some(expected) if expected != data.len() => {
                Err(ImageError::Length { expected, actual: data.len() })
            }
            None if format != PixelFormat::Mjpeg => Err(ImageError::Size { width, height, format }),
            _ => Ok(Self { width, height, format, data }),
        }
    }

    /// A view of an [`Rgb8`](PixelFormat::Rgb8) image.
    ///
    /// # Errors
    /// As [`ImageView::new`].
    pub fn rgb8(width: usize, height: usize, data: &'a [u8]) -> Result<Self, ImageError> {
        Self::new(width, height, PixelFormat::Rgb8, data)
    }

    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    #[must_use]
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    #[must_use]
    pub fn data(&self) -> &'a [u8] {
        self.data
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_of_the_wrong_length_is_refused_with_both_lengths() {
        let error = ImageView::rgb8(4, 2, &[0; 23]).unwrap_err();
        assert_eq!(error, ImageError::Length { expected: 24, actual: 23 });
    }

    #[test]
    fn an_empty_image_and_a_yuyv_image_of_odd_width_are_refused() {
        assert!(ImageView::new(0, 2, PixelFormat::Gray8, &[]).is_err());
        assert!(ImageView::new(3, 2, PixelFormat::Yuyv, &[0; 12]).is_err());
        assert!(ImageView::new(4, 2, PixelFormat::Yuyv, &[0; 16]).is_ok());
    }

    #[test]
    fn nv12_has_half_a_byte_of_colour_per_pixel_and_even_sizes() {
        assert!(ImageView::new(4, 2, PixelFormat::Nv12, &[0; 12]).is_ok());
        assert!(ImageView::new(4, 3, PixelFormat::Nv12, &[0; 18]).is_err());
        assert!(ImageView::new(3, 2, PixelFormat::Nv12, &[0; 9]).is_err());
    }

    #[test]
    fn a_size_that_overflows_is_refused() {
        assert!(ImageView::new(usize::MAX, 2, PixelFormat::Rgb8, &[]).is_err());
    }

    #[test]
    fn jpeg_bytes_may_have_any_length() {
        assert!(ImageView::new(640, 480, PixelFormat::Mjpeg, &[0xff, 0xd8]).is_ok());
    }
}
