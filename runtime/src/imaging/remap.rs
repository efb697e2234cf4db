//! Where every pixel of a pinhole picture lies in the picture of a real lens.

use hal::CameraModel;

use super::packed::{WEIGHT_BITS, bilinear};

/// Positions in the source picture for every target pixel, to 1/32 of a pixel, in 6 bytes each.
///
/// A pixel is valid where its position lies within the source's outer edges and the lens model can be believed there
/// ([`hal::Distortion::reach`]); all others are black. Within the outermost half pixel the edge is repeated.
#[derive(Debug, Clone)]
pub struct Remap {
    width: usize,
    /// Columns of the source.
    stride: usize,
    /// The part of the source's rows that is looked at.
    first_row: usize,
    rows: usize,
    /// Index of the upper left one of the four pixels around the position, counted from the start of `first_row`.
    /// [`BLACK_ROWS`] black rows follow the last row for pixels without a position.
    offsets: Vec<u32>,
    /// How far right of and below that pixel, 0..=32 each: x in the low byte, y in the high byte.
    fractions: Vec<u16>,
    valid: Vec<bool>,
}

/// A filter looks at two rows.
const BLACK_ROWS: usize = 2;

impl Remap {
    /// From pictures of `source`, at least 2x2 and less than 2^31 pixels, to pictures of `target`, whose distortion is ignored.
    /// `None` where not a single pixel of the target is in the source.
    #[must_use]
    pub fn new(source: &CameraModel, target: &CameraModel) -> Option<Self> {
        let pixels = target.width * target.height;
        let reach = source.distortion.reach();
        let places: Vec<_> = (0..pixels).map(|index| place(source, target, reach, index)).collect();
        let first_row = places.iter().flatten().map(|place| place.y.0).min()?;
        let last_row = places.iter().flatten().map(|place| place.y.0 + 1).max()?;
        let (stride, rows) = (source.width, last_row + 1 - first_row);
        let offset = |place: &Option<Place>| match place {
            Some(Place { x, y }) => (y.0 - first_row) * stride + x.0,
            None => rows * stride,
        };
        let fraction = |place: &Option<Place>| place.map_or(0, |Place { x, y }| x.1 | y.1 << 8);
        Some(Self {
            width: target.width,
            stride,
            first_row,
            rows,
            offsets: places.iter().map(|place| offset(place) as u32).collect(),
            fractions: places.iter().map(fraction).collect(),
            valid: places.iter().map(Option::is_some).collect(),
        })
    }

    /// Which pixels of the target show something of the source, row by row.
    #[must_use]
    pub fn valid(&self) -> &[bool] {
        &self.valid
    }

    /// The rows of the source that are looked at.
    pub(super) fn rows(&self) -> std::ops::Range<usize> {
        self.first_row..self.first_row + self.rows
    }

    /// Pixels of the picture that [`sample`](Self::sample) reads: the rows of [`rows`](Self::rows) and black ones.
    pub(super) fn source_pixels(&self) -> usize {
        (self.rows + BLACK_ROWS) * self.stride
    }

    /// Column and row of the source that target pixel (0, 0) is, where the target is a part of the source, pixel by pixel.
    pub(super) fn part(&self) -> Option<(usize, usize)> {
        // A fraction of 32 is the next pixel, at the right or lower edge of the source.
        let (left, top) = self.whole(0)?;
        let same = |index: usize| {
            self.whole(index) == Some((left + index % self.width, top + index / self.width))
        };
        (0..self.offsets.len()).all(same).then_some((left, top))
    }

    /// Column and row of the source that is this target pixel.
    fn whole(&self, index: usize) -> Option<(usize, usize)> {
        let (offset, fraction) = (self.offsets[index] as usize, self.fractions[index]);
        let (x, y) = (fraction & 0xff, fraction >> 8);
        let whole = self.valid[index] && x.is_multiple_of(32) && y.is_multiple_of(32);
        let (column, row) = (
            offset % self.stride + usize::from(x / 32),
            offset / self.stride + usize::from(y / 32),
        );
        whole.then_some((column, self.first_row + row))
    }

    /// Fills `sums` with the target's pixels from `first` on, wide and times 2^(2 [`WEIGHT_BITS`]). `source` has
    /// [`source_pixels`](Self::source_pixels).
    #[inline(always)]
    pub(super) fn sample(&self, source: &[u64], first: usize, sums: &mut [u64]) {
        // Two slices of one length: a single comparison proves all four reads.
        let (upper, lower) = (&source[..source.len() - self.stride], &source[self.stride..]);
        let lower = &lower[..upper.len()];
        let places = self.offsets[first..].iter().zip(&self.fractions[first..]);
        for (sum, (&offset, &fraction)) in sums.iter_mut().zip(places) {
            let pair = offset as usize..offset as usize + 2;
            let (upper, lower) = (&upper[pair.clone()], &lower[pair]);
            let (x, y) = (u64::from(fraction & 0xff), u64::from(fraction >> 8));
            *sum = bilinear([upper[0], upper[1]], [lower[0], lower[1]], x, y);
        }
    }
}

/// A position along both axes: the pixel before it and how many 32ths it lies after that.
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

/// Positions from the outer edge of the first to that of the last of `count` pixels.
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
    fn positions_are_kept_to_a_32th_and_the_outermost_half_pixel_repeats_the_edge() {
        assert_eq!(along(2.25, 10), Some((2, 8)));
        assert_eq!(along(8.99, 10), Some((8, 32)));
        assert_eq!(along(9.4, 10), Some((8, 32)));
        assert_eq!(along(-0.4, 10), Some((0, 0)));
        assert_eq!(along(9.6, 10), None);
        assert_eq!(along(-0.6, 10), None);
        assert_eq!(along(f64::NAN, 10), None);
    }

    #[test]
    fn a_part_of_the_source_is_recognised() {
        let source = CameraModel::pinhole(64, 48, 1.0);
        let part = |left: f64, top: f64| {
            Remap::new(&source, &source.cropped(left, top, 20, 10)).and_then(|map| map.part())
        };
        assert_eq!(part(0.0, 0.0), Some((0, 0)));
        assert_eq!(part(7.0, 30.0), Some((7, 30)));
        assert_eq!(part(44.0, 38.0), Some((44, 38)), "the lower right corner");
        assert_eq!(part(45.0, 38.0), None, "sticks out");
        assert_eq!(part(7.5, 30.0), None);
        assert!(Remap::new(&source, &source.resized(32, 24)).unwrap().part().is_none());
    }

    #[test]
    fn what_the_source_does_not_show_is_not_valid() {
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
