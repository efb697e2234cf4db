//! Pictures as order relations: a census transform (Zabih and Woodfill 1994) keeps which neighbours are darker than the
//! centre and forgets by how much, so gain and exposure do not matter.

use hal::{ImageView, PixelFormat};
use multiversion::multiversion;
use rayon::prelude::*;

use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Bits of one descriptor: a 5x5 window without its centre.
pub const BITS: u32 = 24;

/// A neighbour counts as darker from this difference on: one and a half grey levels, in the units of
/// [`CensusImage::smooth`]. Below that it is the sensor's noise and JPEG's, and a flat wall shall match itself everywhere
/// equally well rather than somewhere by chance.
const NOISE: u16 = 384;

/// The census of one picture: half-size descriptors, computed at every full-size position so that a match can be looked up
/// to a quarter of a half-size pixel.
#[derive(Debug, Clone, Default)]
pub struct CensusImage {
    /// Columns of full-size positions.
    pub width: usize,
    /// Rows of full-size positions.
    pub height: usize,
    /// Row-major, and one last entry for "outside".
    pub descriptors: Vec<u32>,
    /// Means of 2x2 pixels, row-major, 256 to a grey level.
    pub smooth: Vec<u16>,
    grey: Vec<u16>,
}

impl CensusImage {
    /// Computes the census of `frame`; false when the format is not RGB8 or GRAY8.
    pub fn compute(&mut self, frame: ImageView<'_>) -> bool {
        (self.width, self.height) = (frame.width(), frame.height());
        self.grey.clear();
        match frame.format() {
            PixelFormat::Gray8 => self.grey.extend(frame.data().iter().map(|value| u16::from(*value) << 6)),
            PixelFormat::Rgb8 => {
                self.grey.resize(self.width * self.height, 0);
                let rows =
                    self.grey.par_chunks_exact_mut(self.width).zip(frame.data().par_chunks_exact(3 * self.width));
                rows.for_each(|(grey, rgb)| luma(rgb, grey));
            }
            _ => return false,
        }
        self.smooth_2x2();
        self.describe();
        true
    }

    /// Whether at least one pixel in fifty has something to be recognised by.
    pub fn has_texture(&self) -> bool {
        self.descriptors.iter().filter(|descriptor| **descriptor != 0).count() * 50 >= self.width * self.height
    }

    fn smooth_2x2(&mut self) {
        let (width, height) = (self.width, self.height);
        self.smooth.resize(width * height, 0);
        let grey = &self.grey;
        self.smooth.par_chunks_exact_mut(width).enumerate().for_each(|(y, out)| {
            let upper = &grey[y * width..][..width];
            let lower = &grey[(y + 1).min(height - 1) * width..][..width];
            for x in 0..width - 1 {
                out[x] = upper[x] + upper[x + 1] + lower[x] + lower[x + 1];
            }
            out[width - 1] = 2 * (upper[width - 1] + lower[width - 1]);
        });
    }

    fn describe(&mut self) {
        let (width, height) = (self.width, self.height);
        self.descriptors.clear();
        self.descriptors.resize(width * height + 1, 0);
        let smooth = &self.smooth;
        let lines = self.descriptors.par_chunks_exact_mut(width).take(height).enumerate();
        lines.for_each(|(row, out)| describe_row(smooth, row, out));
    }
}

/// Larger pictures are refused in snapshots: no camera of this robot makes them, damaged bytes do.
const MOST_PIXELS: usize = 64_000_000;

/// Descriptors follow from the smooth picture.
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
            return Err(SnapshotError::Damaged(format!("{}x{} are not {pixels} pixels", self.width, self.height)));
        }
        self.describe();
        Ok(())
    }
}

/// Rec. 601 luma in 14 bits, so that faint texture is not lost to rounding.
#[multiversion(targets("x86_64+avx2"))]
fn luma(rgb: &[u8], grey: &mut [u16]) {
    for (grey, p) in grey.iter_mut().zip(rgb.chunks_exact(3)) {
        *grey = ((u32::from(p[0]) * 77 + u32::from(p[1]) * 150 + u32::from(p[2]) * 29) >> 2) as u16;
    }
}

/// Descriptors of one row of a picture of as many columns.
#[multiversion(targets("x86_64+avx2"))]
fn describe_row(smooth: &[u16], row: usize, out: &mut [u32]) {
    let width = out.len();
    let last = (smooth.len() / width) as isize - 1;
    let centre = &smooth[row * width..][..width];
    // Sixteen bits are compared side by side, so the descriptor is gathered in two halves.
    let (mut low, mut high) = ([0_u16; BLOCK], [0_u16; BLOCK]);
    for (block, out) in out.chunks_mut(BLOCK).enumerate() {
        low.fill(0);
        high.fill(0);
        let mut bit = 0;
        for dy in -2_isize..=2 {
            let line = (row as isize + 2 * dy).clamp(0, last) as usize;
            let line = &smooth[line * width..][..width];
            for dx in -2_isize..=2 {
                if (dx, dy) != (0, 0) {
                    let half = if bit < HALF { &mut low } else { &mut high };
                    compare(&mut half[..out.len()], centre, line, block * BLOCK, 2 * dx, bit % HALF);
                    bit += 1;
                }
            }
        }
        for ((out, low), high) in out.iter_mut().zip(&low).zip(&high) {
            *out = u32::from(*low) | u32::from(*high) << HALF;
        }
    }
}

/// Descriptors that are computed at once, and bits of half a descriptor.
const BLOCK: usize = 128;
const HALF: u32 = BITS / 2;

/// Sets `bit` where the neighbour `shift` columns to the right is darker, from column `first` on; beyond the edge the edge is
/// repeated.
#[inline(always)]
fn compare(out: &mut [u16], centre: &[u16], line: &[u16], first: usize, shift: isize, bit: u32) {
    let width = line.len();
    let begin = first.wrapping_add_signed(shift);
    if let (Some(shifted), Some(centre)) = (line.get(begin..begin.wrapping_add(out.len())), centre.get(first..)) {
        for ((out, centre), neighbour) in out.iter_mut().zip(centre).zip(shifted) {
            *out |= u16::from(neighbour.saturating_add(NOISE) < *centre) << bit;
        }
        return;
    }
    for (index, out) in out.iter_mut().enumerate() {
        let neighbour = line[(first + index).saturating_add_signed(shift).min(width - 1)];
        *out |= u16::from(neighbour.saturating_add(NOISE) < centre[first + index]) << bit;
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
        let (a, b) = (census(40, 30, &plain), census(40, 30, &bright));
        let changed: u32 = a.descriptors.iter().zip(&b.descriptors).map(|(a, b)| (a ^ b).count_ones()).sum();
        assert!(changed < 40 * 30 * BITS / 50, "{changed}");
    }

    #[test]
    fn noise_of_one_grey_level_is_no_texture() {
        let noisy: Vec<u8> = (0..400_usize).map(|i| 77 + ((i * 2_654_435_761) >> 13) as u8 % 2).collect();
        assert!(!census(20, 20, &noisy).has_texture());
    }

    #[test]
    fn a_flat_picture_has_empty_descriptors() {
        assert!(census(20, 20, &[77; 400]).descriptors.iter().all(|d| *d == 0));
    }

    #[test]
    fn a_shifted_picture_has_shifted_descriptors() {
        let wide = texture(60, 30);
        let shifted: Vec<u8> = (0..30).flat_map(|y| wide[y * 60 + 7..y * 60 + 57].to_vec()).collect();
        let (a, b) = (census(60, 30, &wide), census(50, 30, &shifted));
        for (x, y) in [(10, 10), (20, 15), (30, 20)] {
            assert_eq!(a.descriptors[y * 60 + x + 7], b.descriptors[y * 50 + x]);
        }
    }

    #[test]
    fn tiny_pictures_do_not_panic() {
        for (width, height) in [(1, 1), (2, 3), (3, 2)] {
            census(width, height, &vec![5; width * height]);
        }
    }
}
