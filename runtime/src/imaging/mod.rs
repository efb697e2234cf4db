//! From a camera's bytes to the network's picture: colour, cut, lens and size in one go.
//!
//! [`FrontEnd`] is made once for a camera mode. It turns every frame either into RGB bytes or into the network's planes; the
//! planes are the bytes / 255 to the last bit, so a recorded picture feeds the network exactly as the live one did. Nothing is
//! allocated in a call but by the JPEG decoder, and the result is the same on any number of threads.

mod color;
mod error;
mod jpeg;
mod packed;
mod remap;
#[cfg(test)]
mod tests;

pub use color::YuvRange;
pub use error::ImagingError;
pub use remap::Remap;

use hal::{CameraModel, Distortion, ImageView, PixelFormat};
use rayon::prelude::*;

use color::{YuvMatrix, convert};
use multiversion::multiversion;
use packed::{Normalisation, WEIGHT_BITS};

/// Rows that one thread takes at a time.
const BAND: usize = 8;
/// Pixels that are worked on at a time, in the nearest cache. Even, so that pixels that share colour stay together.
const BLOCK: usize = 64;
/// Means of more pixels along an axis are no picture any more.
const WIDEST_MEAN: usize = 64;

/// Brings the frames of one camera mode to the size, lens and form that the network takes.
#[derive(Debug, Clone)]
pub struct FrontEnd {
    source: CameraModel,
    target: CameraModel,
    format: PixelFormat,
    matrix: YuvMatrix,
    normalisation: Normalisation,
    /// Source pixels along x and y that become one before the remapping: powers of two.
    mean_of: (usize, usize),
    remap: Remap,
    /// Where the target lies in the source, if it is simply a part of it: then nothing is remapped.
    part: Option<(usize, usize)>,
    /// The rows that the remapping looks at, packed.
    picture: Vec<u64>,
    /// A decoded JPEG, RGB.
    decoded: Vec<u8>,
}

impl FrontEnd {
    /// For frames of `source` in `format`, as they come out of its lens, to pinhole pictures of `target`. `range` is that of
    /// YUYV and NV12 ([`YuvRange::Limited`] for nearly all cameras); the other formats do not look at it.
    ///
    /// Pixels are filtered bilinearly. Where the picture shrinks by more than 2 along an axis (in its middle: by the ratio of
    /// the focal lengths), 2, 4, 8... pixels become their mean first, so that at most a factor of 2 is left.
    ///
    /// # Errors
    /// When a camera model cannot be, the target has a lens, or the target sees nothing of the source.
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
        // Columns and rows at the right and lower edge that fill no mean are left out.
        let (columns, rows) = (source.width / mean_of.0, source.height / mean_of.1);
        let small =
            source.cropped(0.0, 0.0, columns * mean_of.0, rows * mean_of.1).resized(columns, rows);
        let remap = Remap::new(&small, &target).ok_or(ImagingError::NothingInView)?;
        let shares_colour = matches!(format, PixelFormat::Yuyv | PixelFormat::Nv12);
        let part = remap.part().filter(|(left, _)| {
            let pairs_stay_together = left.is_multiple_of(2) && target.width.is_multiple_of(2);
            mean_of == (1, 1) && (pairs_stay_together || !shares_colour)
        });
        let picture = vec![0; if part.is_some() { 0 } else { remap.source_pixels() }];
        let decoded =
            vec![
                0;
                if format == PixelFormat::Mjpeg { 3 * source.width * source.height } else { 0 }
            ];
        let (matrix, normalisation) = (YuvMatrix::bt601(range), Normalisation::NONE);
        Ok(Self {
            source,
            target,
            format,
            matrix,
            normalisation,
            mean_of,
            remap,
            part,
            picture,
            decoded,
        })
    }

    /// With planes of (value - mean) / std instead of values in 0..1, for red, green and blue.
    ///
    /// # Errors
    /// When a number is not finite or a deviation not positive.
    pub fn normalised(mut self, mean: [f32; 3], std: [f32; 3]) -> Result<Self, ImagingError> {
        let sound = mean.iter().all(|mean| mean.is_finite())
            && std.iter().all(|std| std.is_normal() && *std > 0.0);
        if !sound {
            return Err(ImagingError::Normalisation { mean, std });
        }
        self.normalisation = Normalisation { mean, inverse_std: std.map(|std| 1.0 / std) };
        Ok(self)
    }

    /// The camera of the pictures that come out.
    #[must_use]
    pub fn target(&self) -> &CameraModel {
        &self.target
    }

    /// Which pixels of the target show something of the source, row by row. The others are black.
    #[must_use]
    pub fn valid(&self) -> &[bool] {
        self.remap.valid()
    }

    /// The target's picture, 3 x width x height bytes: red, green, blue, pixel by pixel.
    ///
    /// # Errors
    /// When the frame is not of the source's size and format or is a broken JPEG, or `out` has another length. `out` is then as
    /// it was.
    pub fn to_rgb(&mut self, frame: ImageView<'_>, out: &mut [u8]) -> Result<(), ImagingError> {
        self.check_output(out.len())?;
        self.prepare(frame)?;
        let (frame, width) = (self.plain(frame), self.target.width);
        let bands = out.par_chunks_mut(3 * width * BAND).enumerate();
        bands.for_each(|(band, out)| band_to_rgb(self, frame, band * BAND, out));
        Ok(())
    }

    /// The network's planes, `[3, height, width]`: red, green, blue in 0..1, or as [`normalised`](Self::normalised) says.
    ///
    /// # Errors
    /// As [`to_rgb`](Self::to_rgb).
    pub fn to_tensor(&mut self, frame: ImageView<'_>, out: &mut [f32]) -> Result<(), ImagingError> {
        self.check_output(out.len())?;
        self.prepare(frame)?;
        let frame = self.plain(frame);
        let (width, pixels) = (self.target.width, self.target.width * self.target.height);
        let (red, rest) = out.split_at_mut(pixels);
        let (green, blue) = rest.split_at_mut(pixels);
        let [red, green, blue] = [red, green, blue].map(|plane| plane.par_chunks_mut(width * BAND));
        let bands = red.zip(green).zip(blue).enumerate();
        bands.for_each(|(band, ((red, green), blue))| {
            band_to_planes(self, frame, band * BAND, [red, green, blue]);
        });
        Ok(())
    }

    /// The picture that planes were made from, for people to look at: the inverse of [`to_tensor`](Self::to_tensor), exact for
    /// planes that it made without normalisation. Values outside their range are clamped, NaN is black.
    ///
    /// # Errors
    /// When `planes` or `out` has another length than 3 x width x height.
    pub fn tensor_to_rgb(&self, planes: &[f32], out: &mut [u8]) -> Result<(), ImagingError> {
        self.check_output(out.len())?;
        let CameraModel { width, height, .. } = self.target;
        if planes.len() != out.len() {
            return Err(ImagingError::Planes { width, height, found: planes.len() });
        }
        for (colour, plane) in planes.chunks_exact(width * height).enumerate() {
            for (out, value) in out[colour..].iter_mut().step_by(3).zip(plane) {
                *out = self.normalisation.byte(*value, colour);
            }
        }
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

    /// What must be done before the first row: decoding, and packing the rows that the remapping will look at.
    fn prepare(&mut self, frame: ImageView<'_>) -> Result<(), ImagingError> {
        let CameraModel { width, height, .. } = self.source;
        let (found_width, found_height, found) = (frame.width(), frame.height(), frame.format());
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
        if self.part.is_none() {
            let mut picture = std::mem::take(&mut self.picture);
            self.pack_rows(self.plain(frame), &mut picture);
            self.picture = picture;
        }
        Ok(())
    }

    /// The frame, or the picture that was in its JPEG.
    fn plain<'a>(&'a self, frame: ImageView<'a>) -> ImageView<'a> {
        let decoded = ImageView::rgb8(self.source.width, self.source.height, &self.decoded);
        // Only the front end of a JPEG camera has memory for decoded pictures.
        decoded.unwrap_or(frame)
    }

    /// Converts the rows that the remapping looks at, with means of pixels where it asks for them.
    fn pack_rows(&self, frame: ImageView<'_>, picture: &mut [u64]) {
        let rows = self.remap.rows();
        let width = frame.width() / self.mean_of.0;
        let out = picture[..rows.len() * width].par_chunks_mut(width).with_min_len(BAND);
        out.zip(rows).for_each(|(out, row)| pack_row(self, frame, row, out));
    }

    /// Makes one row of the target, and hands it on in pieces with the column where each begins.
    #[inline(always)]
    fn row(&self, frame: ImageView<'_>, row: usize, mut emit: impl FnMut(usize, &[u32])) {
        let width = self.target.width;
        let (mut block, mut sums) = ([0; BLOCK], [0; BLOCK]);
        for first in (0..width).step_by(BLOCK) {
            let block = &mut block[..BLOCK.min(width - first)];
            if let Some((left, top)) = self.part {
                convert(&self.matrix, frame, left + first, top + row, block);
            } else {
                let sums = &mut sums[..block.len()];
                self.remap.sample(&self.picture, row * width + first, sums);
                block
                    .iter_mut()
                    .zip(sums)
                    .for_each(|(pixel, sum)| *pixel = packed::mean(*sum, 2 * WEIGHT_BITS));
            }
            emit(first, block);
        }
    }
}

/// Rows of the target's picture from `first_row` on, as bytes.
#[multiversion(targets("x86_64+avx2"))]
fn band_to_rgb<'a>(front: &FrontEnd, frame: ImageView<'a>, first_row: usize, out: &mut [u8]) {
    for (row, out) in out.chunks_exact_mut(3 * front.target.width).enumerate() {
        front.row(frame, first_row + row, |first, pixels| {
            packed::write_rgb(pixels, &mut out[3 * first..][..3 * pixels.len()]);
        });
    }
}

/// Rows of the target's planes from `first_row` on.
#[multiversion(targets("x86_64+avx2"))]
fn band_to_planes<'a>(
    front: &FrontEnd,
    frame: ImageView<'a>,
    first_row: usize,
    planes: [&mut [f32]; 3],
) {
    let width = front.target.width;
    let [red, green, blue] = planes;
    for row in 0..red.len() / width {
        front.row(frame, first_row + row, |first, pixels| {
            let place = row * width + first..row * width + first + pixels.len();
            front.normalisation.write(
                pixels,
                [&mut red[place.clone()], &mut green[place.clone()], &mut blue[place]],
            );
        });
    }
}

/// One row of what the remapping looks at: the wide pixels of source row `row`, or of the means that lie there.
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

/// How many pixels along an axis become one, when `shrink` become one in all: what is left is at most 2.
fn mean_of(shrink: f64) -> usize {
    let mut pixels = 1;
    while shrink / pixels as f64 > 2.0 && pixels < WIDEST_MEAN {
        pixels *= 2;
    }
    pixels
}

/// The largest power of two up to `count`, which is at least 1.
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
