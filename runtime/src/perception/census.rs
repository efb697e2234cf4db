//! Census transform (Zabih and Woodfill 1994): a descriptor records which neighbours are darker than the centre but not by how
//! much, so gain and exposure do not matter.

use hal::{ImageView, PixelFormat};
use multiversion::multiversion;
use rayon::prelude::*;

use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Bits of one descriptor: a 5x5 window without its centre.
pub const BITS: u32 = 24;

/// Minimum difference for a neighbour to count as darker: one and a half grey levels, in the units of [`CensusImage::smooth`].
/// Smaller differences are sensor noise and JPEG artefacts. With them, a flat wall would match at a random position instead of
/// everywhere equally well.
const NOISE: u16 = 384;

/// Row-major index of a position outside the image.
pub const NOWHERE: u32 = u32::MAX;

/// The census of one frame: descriptors of the half-size image, computed at every full-size position.
#[derive(Debug, Clone, Default)]
pub struct CensusImage {
    pub width: usize,
    pub height: usize,
    /// Row-major, one per full-size position.
    pub descriptors: Vec<u32>,
    /// Means of 2x2 pixels, row-major, 256 to a grey level.
    pub smooth: Vec<u16>,
    grey: Vec<u16>,
}

impl CensusImage {
    /// Computes the census of `frame`; false when the format is not RGB8 or GRAY8.
    pub fn compute(&mut self, frame: ImageView<'_>) -> bool {
        self.width = frame.width();
        self.height = frame.height();
        let bytes = match frame.format() {
            PixelFormat::Gray8 => 1,
            PixelFormat::Rgb8 => 3,
            _ => return false,
        };
        self.smooth_2x2(frame.data(), bytes);
        self.describe();
        true
    }

    /// Whether at least one pixel in fifty has texture.
    pub fn has_texture(&self) -> bool {
        self.descriptors.iter().filter(|descriptor| **descriptor != 0).count() * 50
            >= self.width * self.height
    }

    /// Averages 2x2 pixels of `data`, which has `bytes` bytes per pixel. Every band computes its own grey values,
    /// including those of the next band's first row, so that they stay in the cache.
    fn smooth_2x2(&mut self, data: &[u8], bytes: usize) {
        let width = self.width;
        let height = self.height;
        self.smooth.resize(width * height, 0);
        self.grey.resize(height.div_ceil(BAND) * (BAND + 1) * width, 0);
        let bands = self
            .smooth
            .par_chunks_mut(BAND * width)
            .zip(self.grey.par_chunks_exact_mut((BAND + 1) * width));
        bands.enumerate().for_each(|(band, (smooth, grey))| {
            let rows = data.chunks_exact(bytes * width).skip(band * BAND);
            for (grey, row) in grey.chunks_exact_mut(width).zip(rows) {
                match bytes {
                    3 => luma(row, grey),
                    _ => grey
                        .iter_mut()
                        .zip(row)
                        .for_each(|(grey, value)| *grey = u16::from(*value) << 6),
                }
            }
            for (row, smooth) in smooth.chunks_exact_mut(width).enumerate() {
                let below = if band * BAND + row + 1 < height { row + 1 } else { row };
                smooth_row(&grey[row * width..][..width], &grey[below * width..][..width], smooth);
            }
        });
    }

    /// Takes over the other's scratch memory.
    pub fn take_scratch(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.grey, &mut other.grey);
    }

    fn describe(&mut self) {
        let width = self.width;
        let height = self.height;
        self.descriptors.resize(width * height, 0);
        let smooth = &self.smooth;
        let lines = self.descriptors.par_chunks_exact_mut(width).enumerate();
        lines.for_each(|(row, out)| describe_row(smooth, row, out));
    }
}

/// Larger images are refused in snapshots: no camera of this robot has them, so the bytes are damaged.
const MOST_PIXELS: usize = 64_000_000;

/// Only `smooth` is stored; descriptors are computed from it.
impl State for CensusImage {
    fn write(&self, to: &mut Vec<u8>) {
        State::write(&(self.width, self.height), to);
        write_bulk(&self.smooth, to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let mut size = (0, 0);
        State::read(&mut size, from)?;
        (self.width, self.height) = size;
        read_bulk(&mut self.smooth, MOST_PIXELS, from)?;
        if self.width == 0 || self.width.checked_mul(self.height) != Some(self.smooth.len()) {
            let pixels = self.smooth.len();
            return Err(SnapshotError::Damaged(format!(
                "{}x{} are not {pixels} pixels",
                self.width, self.height
            )));
        }
        self.describe();
        Ok(())
    }
}

/// Rec. 601 luma in 14 bits, so that rounding does not remove faint texture.
#[multiversion(targets("x86_64+avx2"))]
fn luma(rgb: &[u8], grey: &mut [u16]) {
    for (grey, p) in grey.iter_mut().zip(rgb.chunks_exact(3)) {
        *grey = ((u32::from(p[0]) * 77 + u32::from(p[1]) * 150 + u32::from(p[2]) * 29) >> 2) as u16;
    }
}

/// Rows that one task works on.
const BAND: usize = 16;

/// Sums of 2x2 pixels; beyond the right edge, the last column is repeated.
#[multiversion(targets("x86_64+avx2"))]
fn smooth_row(upper: &[u16], lower: &[u16], out: &mut [u16]) {
    let last = out.len() - 1;
    let next = upper[1..].iter().zip(&lower[1..]);
    for ((out, (upper, lower)), (next_upper, next_lower)) in
        out.iter_mut().zip(upper.iter().zip(lower)).zip(next)
    {
        *out = upper + next_upper + lower + next_lower;
    }
    out[last] = 2 * (upper[last] + lower[last]);
}

/// Computes the descriptors of one row; `out` has the image's width.
#[multiversion(targets("x86_64+avx2"))]
fn describe_row(smooth: &[u16], row: usize, out: &mut [u32]) {
    let width = out.len();
    let last = (smooth.len() / width) as isize - 1;
    let lines: [&[u16]; 5] = std::array::from_fn(|index| {
        let line = (row as isize + 2 * (index as isize - 2)).clamp(0, last) as usize;
        &smooth[line * width..][..width]
    });
    // Away from the left and right edge, LANES pixels at a time; the last group overlaps the one before.
    let Some(right) = width.checked_sub(REACH + LANES).filter(|right| *right >= REACH) else {
        return describe_edge(&lines, 0..width, out);
    };
    describe_edge(&lines, 0..REACH, out);
    for column in (REACH..right).step_by(LANES).chain([right]) {
        describe_lanes(&lines, column, out);
    }
    describe_edge(&lines, width - REACH..width, out);
}

/// Pixels from the middle of a descriptor to its edge.
const REACH: usize = 4;
/// Descriptors that are computed in parallel lanes.
const LANES: usize = 16;
/// Bits of half a descriptor: comparisons have 16-bit lanes, so a descriptor is computed in two halves.
const HALF: usize = BITS as usize / 2;

/// The neighbours in the order of their bits: line of the window, and columns from its left edge.
const NEIGHBOURS: [(usize, usize); BITS as usize] = {
    let mut all = [(0, 0); BITS as usize];
    let mut bit = 0;
    while bit < all.len() {
        // Position 12 is the centre.
        let place = if bit < 12 { bit } else { bit + 1 };
        all[bit] = (place / 5, 2 * (place % 5));
        bit += 1;
    }
    all
};

/// A neighbour below this value counts as darker than `centre`.
#[inline(always)]
fn threshold(centre: u16) -> u16 {
    centre.saturating_sub(NOISE)
}

#[inline(always)]
fn describe_lanes(lines: &[&[u16]; 5], column: usize, out: &mut [u32]) {
    let mut thresholds = [0; LANES];
    for (threshold_of, centre) in thresholds.iter_mut().zip(&lines[2][column..]) {
        *threshold_of = threshold(*centre);
    }
    let mut windows = [&[0; LANES + 2 * REACH]; 5];
    for (window, line) in windows.iter_mut().zip(lines) {
        let Some(values) = line[column - REACH..].first_chunk() else { return };
        *window = values;
    }
    let mut halves = [[0_u16; LANES]; 2];
    for (half, neighbours) in halves.iter_mut().zip(NEIGHBOURS.chunks_exact(HALF)) {
        let mut value = 1;
        for (line, shift) in neighbours {
            let near = &windows[*line][*shift..][..LANES];
            for lane in 0..LANES {
                half[lane] |= if near[lane] < thresholds[lane] { value } else { 0 };
            }
            value <<= 1;
        }
    }
    let [low, high] = halves;
    for ((out, low), high) in out[column..].iter_mut().zip(low).zip(high) {
        *out = u32::from(low) | u32::from(high) << HALF;
    }
}

/// Computes descriptors near the left or right edge, beyond which the last column is repeated.
#[inline(always)]
fn describe_edge(lines: &[&[u16]; 5], columns: std::ops::Range<usize>, out: &mut [u32]) {
    let width = out.len();
    for column in columns {
        let threshold = threshold(lines[2][column]);
        out[column] = 0;
        for (bit, (line, shift)) in NEIGHBOURS.iter().enumerate() {
            let at = (column + shift).saturating_sub(REACH).min(width - 1);
            out[column] |= u32::from(lines[*line][at] < threshold) << bit;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn census(width: usize, height: usize, data: &[u8]) -> CensusImage {
        let mut image = CensusImage::default();
        assert!(image.compute(ImageView::new(width, height, PixelFormat::Gray8, data).unwrap()));
        image
    }

    fn texture(width: usize, height: usize) -> Vec<u8> {
        (0..width * height).map(|i| ((i * 2_654_435_761_usize) >> 13) as u8 / 2).collect()
    }

    #[test]
    fn an_offset_leaves_every_descriptor_as_it_is() {
        let plain = texture(40, 30);
        let bright: Vec<u8> = plain.iter().map(|v| v + 100).collect();
        assert_eq!(census(40, 30, &plain).descriptors, census(40, 30, &bright).descriptors);
    }

    #[test]
    fn a_gain_changes_few_bits() {
        let plain = texture(40, 30);
        let bright: Vec<u8> = plain.iter().map(|v| (f32::from(*v) * 1.3) as u8).collect();
        let a = census(40, 30, &plain);
        let b = census(40, 30, &bright);
        let changed: u32 =
            a.descriptors.iter().zip(&b.descriptors).map(|(a, b)| (a ^ b).count_ones()).sum();
        assert!(changed < 40 * 30 * BITS / 50, "{changed}");
    }

    #[test]
    fn noise_of_one_grey_level_is_no_texture() {
        let noisy: Vec<u8> =
            (0..400_usize).map(|i| 77 + ((i * 2_654_435_761) >> 13) as u8 % 2).collect();
        assert!(!census(20, 20, &noisy).has_texture());
    }

    #[test]
    fn a_flat_image_has_empty_descriptors() {
        assert!(census(20, 20, &[77; 400]).descriptors.iter().all(|d| *d == 0));
    }

    #[test]
    fn a_shifted_image_has_shifted_descriptors() {
        let wide = texture(60, 30);
        let shifted: Vec<u8> =
            (0..30).flat_map(|y| wide[y * 60 + 7..y * 60 + 57].to_vec()).collect();
        let a = census(60, 30, &wide);
        let b = census(50, 30, &shifted);
        for (x, y) in [(10, 10), (20, 15), (30, 20)] {
            assert_eq!(a.descriptors[y * 60 + x + 7], b.descriptors[y * 50 + x]);
        }
    }

    #[test]
    fn tiny_images_do_not_panic() {
        for (width, height) in [(1, 1), (2, 3), (3, 2)] {
            census(width, height, &vec![5; width * height]);
        }
    }
}
