//! The image front end: converts camera frames to undistorted RGB images of the network's size in one pass.
//!
//! [`FrontEnd`] is made once for a camera mode. Only the JPEG decoder allocates in a call, and the result is the same to the
//! last bit on any number of threads.

mod color;
mod error;
mod jpeg;
mod packed;
mod remap;
#[cfg(test)]
mod tests;

pub use color::YuvRange;
pub use error::ImagingError;
use remap::Remap;

use hal::{CameraModel, Distortion, ImageView, PixelFormat};
use rayon::prelude::*;

use color::{YuvMatrix, convert};
use multiversion::multiversion;
use packed::WEIGHT_BITS;

/// Rows that one task converts.
const BAND: usize = 8;
/// Pixels that are converted at a time, few enough for the level 1 cache. Even, so that pixels that share colour stay together.
const BLOCK: usize = 64;
/// Maximum number of pixels along an axis that are averaged to one.
const WIDEST_MEAN: usize = 64;

/// Converts the frames of one camera mode to undistorted RGB images of the target camera.
#[derive(Debug, Clone)]
pub struct FrontEnd {
    source: CameraModel,
    target: CameraModel,
    format: PixelFormat,
    matrix: YuvMatrix,
    /// Source pixels along x and y that are averaged to one before the remapping: powers of two.
    mean_of: (usize, usize),
    remap: Remap,
    /// Column and row of the target in the source if it is a plain crop of it: then nothing is remapped.
    crop: Option<(usize, usize)>,
    /// The source rows that the remapping reads, as wide pixels.
    packed: Vec<u64>,
    /// A decoded JPEG frame, RGB8.
    decoded: Vec<u8>,
}

impl FrontEnd {
    /// Converts frames of `source` (with its distortion) in `format` to pinhole images of `target`. `range` applies to YUYV
    /// and NV12 ([`YuvRange::Limited`] for nearly all cameras); other formats ignore it.
    ///
    /// Pixels are interpolated bilinearly. Where the image shrinks by more than 2 along an axis (in its middle: by the ratio of
    /// the focal lengths), 2, 4, 8... pixels are averaged first, so that a factor of at most 2 is left.
    ///
    /// # Errors
    /// An invalid camera model, a target with distortion, or a target that shows nothing of the source.
    pub fn new(
        source: CameraModel,
        target: CameraModel,
        format: PixelFormat,
        range: YuvRange,
    ) -> Result<Self, ImagingError> {
        check(&source, &target, format)?;
        let mean_of = (
            mean_of(source.fx / target.fx).min(largest_power(source.width / 2)),
            mean_of(source.fy / target.fy).min(largest_power(source.height / 2)),
        );
        // Columns and rows at the right and lower edge that do not fill a mean are left out.
        let columns = source.width / mean_of.0;
        let rows = source.height / mean_of.1;
        let small =
            source.cropped(0.0, 0.0, columns * mean_of.0, rows * mean_of.1).resized(columns, rows);
        let remap = Remap::new(&small, &target).ok_or(ImagingError::NothingInView)?;
        let shares_colour = matches!(format, PixelFormat::Yuyv | PixelFormat::Nv12);
        let crop = remap.crop().filter(|(left, _)| {
            let pairs_stay_together = left.is_multiple_of(2) && target.width.is_multiple_of(2);
            mean_of == (1, 1) && (pairs_stay_together || !shares_colour)
        });
        let packed = vec![0; if crop.is_some() { 0 } else { remap.source_pixels() }];
        let decoded =
            vec![
                0;
                if format == PixelFormat::Mjpeg { 3 * source.width * source.height } else { 0 }
            ];
        let matrix = YuvMatrix::bt601(range);
        Ok(Self { source, target, format, matrix, mean_of, remap, crop, packed, decoded })
    }

    /// The camera of the resulting images.
    #[must_use]
    pub fn target(&self) -> &CameraModel {
        &self.target
    }

    /// Which pixels of the target show a part of the source, row-major. The others are black.
    #[must_use]
    pub fn valid(&self) -> &[bool] {
        self.remap.valid()
    }

    /// Writes the target's RGB8 image, 3 x width x height bytes.
    ///
    /// # Errors
    /// A frame of another size or format than the source's, a damaged JPEG, or another length of `out`. `out` is then
    /// unchanged.
    pub fn to_rgb(&mut self, frame: ImageView<'_>, out: &mut [u8]) -> Result<(), ImagingError> {
        self.check_output(out.len())?;
        self.prepare(frame)?;
        let frame = self.decoded_or(frame);
        let width = self.target.width;
        let bands = out.par_chunks_mut(3 * width * BAND).enumerate();
        bands.for_each(|(band, out)| band_to_rgb(self, frame, band * BAND, out));
        Ok(())
    }

    fn check_output(&self, found: usize) -> Result<(), ImagingError> {
        let CameraModel { width, height, .. } = self.target;
        if found == 3 * width * height {
            Ok(())
        } else {
            Err(ImagingError::Output { width, height, found })
        }
    }

    /// Decodes a JPEG frame, and packs the rows that the remapping reads.
    fn prepare(&mut self, frame: ImageView<'_>) -> Result<(), ImagingError> {
        let CameraModel { width, height, .. } = self.source;
        let found_width = frame.width();
        let found_height = frame.height();
        let found = frame.format();
        if (found_width, found_height, found) != (width, height, self.format) {
            let format = self.format;
            return Err(ImagingError::Frame {
                width,
                height,
                format,
                found_width,
                found_height,
                found,
            });
        }
        if self.format == PixelFormat::Mjpeg {
            jpeg::decode(frame.data(), (width, height), &mut self.decoded)?;
        }
        if self.crop.is_none() {
            let mut packed = std::mem::take(&mut self.packed);
            self.pack_rows(self.decoded_or(frame), &mut packed);
            self.packed = packed;
        }
        Ok(())
    }

    /// The decoded image for a JPEG camera, else the frame itself.
    fn decoded_or<'a>(&'a self, frame: ImageView<'a>) -> ImageView<'a> {
        let decoded = ImageView::rgb8(self.source.width, self.source.height, &self.decoded);
        // Only the front end of a JPEG camera has memory for the decoded image.
        decoded.unwrap_or(frame)
    }

    /// Converts the rows that the remapping reads to wide pixels, averaged where the image shrinks.
    fn pack_rows(&self, frame: ImageView<'_>, packed: &mut [u64]) {
        let rows = self.remap.rows();
        let width = frame.width() / self.mean_of.0;
        let out = packed[..rows.len() * width].par_chunks_mut(width).with_min_len(BAND);
        out.zip(rows).for_each(|(out, row)| pack_row(self, frame, row, out));
    }

    /// Computes one row of the target and passes it to `emit` in blocks, each with its first column.
    #[inline(always)]
    fn row(&self, frame: ImageView<'_>, row: usize, mut emit: impl FnMut(usize, &[u32])) {
        let width = self.target.width;
        let mut block = [0; BLOCK];
        let mut sums = [0; BLOCK];
        for first in (0..width).step_by(BLOCK) {
            let block = &mut block[..BLOCK.min(width - first)];
            if let Some((left, top)) = self.crop {
                convert(&self.matrix, frame, left + first, top + row, block);
            } else {
                let sums = &mut sums[..block.len()];
                self.remap.sample(&self.packed, row * width + first, sums);
                block
                    .iter_mut()
                    .zip(sums)
                    .for_each(|(pixel, sum)| *pixel = packed::mean(*sum, 2 * WEIGHT_BITS));
            }
            emit(first, block);
        }
    }
}

/// Writes rows of the target's image from `first_row` on.
#[multiversion(targets("x86_64+avx2"))]
fn band_to_rgb<'a>(front: &FrontEnd, frame: ImageView<'a>, first_row: usize, out: &mut [u8]) {
    for (row, out) in out.chunks_exact_mut(3 * front.target.width).enumerate() {
        front.row(frame, first_row + row, |first, pixels| {
            packed::write_rgb(pixels, &mut out[3 * first..][..3 * pixels.len()]);
        });
    }
}

/// Writes one row of wide pixels: of source row `row`, or of the means in that row.
#[multiversion(targets("x86_64+avx2"))]
fn pack_row<'a>(front: &FrontEnd, frame: ImageView<'a>, row: usize, out: &mut [u64]) {
    let (mean_x, mean_y) = front.mean_of;
    let mut block = [0; BLOCK];
    if front.mean_of == (1, 1) {
        for (index, out) in out.chunks_mut(BLOCK).enumerate() {
            let block = &mut block[..out.len()];
            convert(&front.matrix, frame, index * BLOCK, row, block);
            out.iter_mut().zip(block).for_each(|(out, pixel)| *out = packed::widen(*pixel));
        }
        return;
    }
    out.fill(0);
    for row in row * mean_y..(row + 1) * mean_y {
        for (index, sums) in out.chunks_mut(BLOCK / mean_x).enumerate() {
            let block = &mut block[..sums.len() * mean_x];
            convert(&front.matrix, frame, index * BLOCK, row, block);
            for (sum, pixels) in sums.iter_mut().zip(block.chunks_exact(mean_x)) {
                *sum += pixels.iter().map(|pixel| packed::widen(*pixel)).sum::<u64>();
            }
        }
    }
    let bits = (mean_x * mean_y).trailing_zeros();
    out.iter_mut().for_each(|pixel| *pixel = packed::widen(packed::mean(*pixel, bits)));
}

/// Number of pixels along an axis to average when the image shrinks by `shrink`, so that a factor of at most 2 is left.
fn mean_of(shrink: f64) -> usize {
    let mut pixels = 1;
    while shrink / pixels as f64 > 2.0 && pixels < WIDEST_MEAN {
        pixels *= 2;
    }
    pixels
}

/// The largest power of two up to `count`, for a `count` of at least 1.
fn largest_power(count: usize) -> usize {
    1 << count.ilog2()
}

fn check(
    source: &CameraModel,
    target: &CameraModel,
    format: PixelFormat,
) -> Result<(), ImagingError> {
    for (role, camera) in [("source", source), ("target", target)] {
        let sides = if role == "source" { 2..=65_535 } else { 1..=65_535 };
        if !camera.is_sound() || !sides.contains(&camera.width) || !sides.contains(&camera.height) {
            return Err(ImagingError::Camera { role, found: format!("{camera:?}") });
        }
    }
    if target.distortion != Distortion::None {
        return Err(ImagingError::TargetDistortion { found: format!("{:?}", target.distortion) });
    }
    let odd = (source.width % 2 == 1, source.height % 2 == 1);
    match format {
        PixelFormat::Yuyv if odd.0 => {}
        PixelFormat::Nv12 if odd.0 || odd.1 => {}
        PixelFormat::Yuyv
        | PixelFormat::Nv12
        | PixelFormat::Rgb8
        | PixelFormat::Gray8
        | PixelFormat::Mjpeg => {
            return Ok(());
        }
        _ => return Err(ImagingError::Format { format }),
    }
    Err(ImagingError::OddSize { width: source.width, height: source.height, format })
}
