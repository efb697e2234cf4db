//! Lookup table for undistortion: the position of every pixel of a pinhole image in the image of a real lens.

use hal::CameraModel;

use super::packed::{WEIGHT_BITS, bilinear};

/// Positions in the source image for every target pixel, to 1/32 of a pixel, in 6 bytes each.
///
/// A pixel is valid where its position lies within the source's outer edges and within the range of the lens model
/// ([`hal::Distortion::reach`]); all others are black. Within the outermost half pixel, the edge is repeated.
#[derive(Debug, Clone)]
pub struct Remap {
    width: usize,
    /// Columns of the source.
    stride: usize,
    /// The first of the source's rows that are read.
    first_row: usize,
    rows: usize,
    /// Index of the upper left one of the four pixels around the position, counted from the start of `first_row`.
    /// [`BLACK_ROWS`] black rows follow the last row for pixels without a position.
    offsets: Vec<u32>,
    /// Fractions to the right of and below that pixel, 0..=32 each: x in the low byte, y in the high byte.
    fractions: Vec<u16>,
    valid: Vec<bool>,
}

/// The bilinear filter reads two rows.
const BLACK_ROWS: usize = 2;

impl Remap {
    /// Maps images of `source`, at least 2x2 and less than 2^31 pixels, to images of `target`, whose distortion is ignored.
    /// `None` if no pixel of the target is in the source.
    #[must_use]
    pub fn new(source: &CameraModel, target: &CameraModel) -> Option<Self> {
        let pixels = target.width * target.height;
        let reach = source.distortion.valid_radius();
        let places: Vec<_> = (0..pixels).map(|index| place(source, target, reach, index)).collect();
        let first_row = places.iter().flatten().map(|place| place.y.0).min()?;
        let last_row = places.iter().flatten().map(|place| place.y.0 + 1).max()?;
        let stride = source.width;
        let rows = last_row + 1 - first_row;
        Some(Self {
            width: target.width,
            stride,
            first_row,
            rows,
            offsets: places
                .iter()
                .map(|place| match place {
                    Some(Place { x, y }) => ((y.0 - first_row) * stride + x.0) as u32,
                    None => (rows * stride) as u32,
                })
                .collect(),
            fractions: places
                .iter()
                .map(|place| place.map_or(0, |Place { x, y }| x.1 | y.1 << 8))
                .collect(),
            valid: places.iter().map(Option::is_some).collect(),
        })
    }

    /// Which pixels of the target show a part of the source, row-major.
    #[must_use]
    pub fn valid(&self) -> &[bool] {
        &self.valid
    }

    /// The rows of the source that are read.
    pub(super) fn rows(&self) -> std::ops::Range<usize> {
        self.first_row..self.first_row + self.rows
    }

    /// Number of pixels that [`sample`](Self::sample) reads: those of [`rows`](Self::rows) and of the black rows.
    pub(super) fn source_pixels(&self) -> usize {
        (self.rows + BLACK_ROWS) * self.stride
    }

    /// Column and row of target pixel (0, 0) in the source if the target is a plain crop of the source.
    pub(super) fn crop(&self) -> Option<(usize, usize)> {
        let (left, top) = self.source_pixel(0)?;
        let is_crop = (0..self.offsets.len()).all(|index| {
            let expected = (left + index % self.width, top + index / self.width);
            self.source_pixel(index) == Some(expected)
        });
        is_crop.then_some((left, top))
    }

    /// Column and row of the source pixel at a target pixel's exact position. A fraction of 32 means the next pixel; it
    /// occurs at the right and lower edge of the source.
    fn source_pixel(&self, index: usize) -> Option<(usize, usize)> {
        let offset = self.offsets[index] as usize;
        let fraction = self.fractions[index];
        let x = fraction & 0xff;
        let y = fraction >> 8;
        let whole = self.valid[index] && x.is_multiple_of(32) && y.is_multiple_of(32);
        let column = offset % self.stride + usize::from(x / 32);
        let row = offset / self.stride + usize::from(y / 32);
        whole.then_some((column, self.first_row + row))
    }

    /// Fills `sums` with the target's pixels from `first` on, as wide pixels times 2^(2 [`WEIGHT_BITS`]). `source` has
    /// [`source_pixels`](Self::source_pixels).
    #[inline(always)]
    pub(super) fn sample(&self, source: &[u64], first: usize, sums: &mut [u64]) {
        // Two slices of equal length, so that one bounds check covers all four reads.
        let upper = &source[..source.len() - self.stride];
        let lower = &source[self.stride..];
        let lower = &lower[..upper.len()];
        let places = self.offsets[first..].iter().zip(&self.fractions[first..]);
        for (sum, (&offset, &fraction)) in sums.iter_mut().zip(places) {
            let pair = offset as usize..offset as usize + 2;
            let upper = &upper[pair.clone()];
            let lower = &lower[pair];
            let x = u64::from(fraction & 0xff);
            let y = u64::from(fraction >> 8);
            *sum = bilinear([upper[0], upper[1]], [lower[0], lower[1]], x, y);
        }
    }
}

/// A position along both axes: the pixel before it, and its distance from that pixel in 1/32 pixel.
#[derive(Debug, Clone, Copy)]
struct Place {
    x: (usize, u16),
    y: (usize, u16),
}

fn place(source: &CameraModel, target: &CameraModel, reach: f64, index: usize) -> Option<Place> {
    let ray = target.ray((index % target.width) as f64, (index / target.width) as f64);
    if ray.x.hypot(ray.y) >= reach {
        return None;
    }
    let (x, y) = source.distorted_pixel(ray.x, ray.y);
    Some(Place { x: along(x, source.width)?, y: along(y, source.height)? })
}

/// The pixel before `position` and the distance from it in 1/32 pixel; `None` outside of `count` pixels.
fn along(position: f64, count: usize) -> Option<(usize, u16)> {
    let last = count as f64 - 1.0;
    if !(-0.5..=last + 0.5).contains(&position) {
        return None;
    }
    let steps = (position.clamp(0.0, last) * f64::from(1 << WEIGHT_BITS)).round() as usize;
    let before = (steps >> WEIGHT_BITS).min(count - 2);
    Some((before, (steps - (before << WEIGHT_BITS)) as u16))
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Distortion;

    #[test]
    fn positions_are_rounded_to_a_32nd_and_the_outermost_half_pixel_repeats_the_edge() {
        assert_eq!(along(2.25, 10), Some((2, 8)));
        assert_eq!(along(8.99, 10), Some((8, 32)));
        assert_eq!(along(9.4, 10), Some((8, 32)));
        assert_eq!(along(-0.4, 10), Some((0, 0)));
        assert_eq!(along(9.6, 10), None);
        assert_eq!(along(-0.6, 10), None);
        assert_eq!(along(f64::NAN, 10), None);
    }

    #[test]
    fn a_crop_of_the_source_is_recognised() {
        let source = CameraModel::pinhole(64, 48, 1.0);
        for ([left, top], expected) in [
            ([0.0, 0.0], Some((0, 0))),
            ([7.0, 30.0], Some((7, 30))),
            ([44.0, 38.0], Some((44, 38))), // the lower right corner
            ([45.0, 38.0], None),           // sticks out
            ([7.5, 30.0], None),
        ] {
            let map = Remap::new(&source, &source.cropped(left, top, 20, 10));
            assert_eq!(map.and_then(|map| map.crop()), expected, "{left}, {top}");
        }
        assert!(Remap::new(&source, &source.resized(32, 24)).unwrap().crop().is_none());
    }

    #[test]
    fn pixels_outside_the_source_are_not_valid() {
        let source = CameraModel::pinhole(64, 48, 1.0);
        let map = Remap::new(&source, &source.cropped(-10.0, 0.0, 64, 48)).unwrap();
        assert!(map.valid().iter().enumerate().all(|(index, valid)| *valid == (index % 64 >= 10)));
        assert!(Remap::new(&source, &source.cropped(100.0, 0.0, 64, 48)).is_none());
    }

    #[test]
    fn rays_behind_the_fold_of_the_lens_model_are_not_valid() {
        let source = CameraModel {
            distortion: Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]),
            ..CameraModel::pinhole(640, 480, 1.2)
        };
        let target = CameraModel::pinhole(640, 480, 2.4);
        let map = Remap::new(&source, &target).unwrap();
        // Without the limit, rays from 1.05 focal lengths on would be seen a second time.
        for (index, valid) in map.valid().iter().enumerate() {
            let ray = target.ray((index % 640) as f64, (index / 640) as f64);
            assert!(!valid || ray.xy().norm() < 1.06);
        }
    }
}
