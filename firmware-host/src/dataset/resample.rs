//! Resamples the dataset's images to the size that perception works on, and computes the matching
//! intrinsics.

use hal::{CameraModel, DepthMap, Distortion};

/// Undistorts an image, crops the largest central part with the target aspect ratio, and resamples
/// it.
#[derive(Debug, Clone)]
pub struct Resampler {
    source: CameraModel,
    target: CameraModel,
    /// Source coordinates of every pixel of the undistorted image; `None` without distortion.
    undistortion: Option<Vec<[f32; 2]>>,
    /// Outer edges of the cropped part, in source pixels.
    left: f64,
    top: f64,
    /// Source pixels per target pixel.
    step: f64,
}

impl Resampler {
    /// A resampler from images of `source` to pinhole images of `width` x `height`.
    #[must_use]
    pub fn new(source: &CameraModel, width: usize, height: usize) -> Self {
        let step = (source.width as f64 / width as f64).min(source.height as f64 / height as f64);
        let left = (source.width as f64 - step * width as f64) / 2.0;
        let top = (source.height as f64 - step * height as f64) / 2.0;
        let target = CameraModel {
            width,
            height,
            fx: source.fx / step,
            fy: source.fy / step,
            cx: (source.cx + 0.5 - left) / step - 0.5,
            cy: (source.cy + 0.5 - top) / step - 0.5,
            distortion: Distortion::None,
        };
        Self { source: *source, target, undistortion: undistortion(source), left, top, step }
    }

    /// The camera of the resampled images.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        &self.target
    }

    /// Resamples an RGB8 image. A triangle filter of the width of a target pixel avoids aliasing.
    /// Without scaling the pixels are copied unchanged.
    #[must_use]
    pub fn rgb(&self, source: &[u8]) -> Vec<u8> {
        let undistorted = self.undistortion.as_ref().map(|map| self.undistort_rgb(source, map));
        let source = undistorted.as_deref().unwrap_or(source);
        let columns = taps(self.left, self.step, self.target.width, self.source.width);
        let rows = taps(self.top, self.step, self.target.height, self.source.height);
        let width = self.target.width * 3;
        let mut out = Vec::with_capacity(width * self.target.height);
        let mut sums = vec![0.0_f32; width];
        for row in &rows {
            sums.fill(0.0);
            for (dy, weight_y) in row.weights.iter().enumerate() {
                let line = &source[(row.first + dy) * self.source.width * 3..];
                for (sum, column) in sums.chunks_exact_mut(3).zip(&columns) {
                    for (pixel, weight_x) in
                        line[column.first * 3..].chunks_exact(3).zip(&column.weights)
                    {
                        for (sum, value) in sum.iter_mut().zip(pixel) {
                            *sum += weight_y * weight_x * f32::from(*value);
                        }
                    }
                }
            }
            out.extend(sums.iter().map(|sum| sum.round() as u8));
        }
        out
    }

    /// Resamples depth by nearest neighbour, because a mean of two depths would be the depth of no
    /// surface.
    #[must_use]
    pub fn depth(&self, source_m: &[f32]) -> DepthMap {
        let mut depth = DepthMap::none(self.target.width, self.target.height);
        for (index, out) in depth.values_mut().iter_mut().enumerate() {
            let u = index % self.target.width;
            let v = index / self.target.width;
            let x = nearest((u as f64 + 0.5) * self.step + self.left - 0.5, self.source.width);
            let y = nearest((v as f64 + 0.5) * self.step + self.top - 0.5, self.source.height);
            *out = match &self.undistortion {
                None => source_m[y * self.source.width + x],
                Some(map) => self.distorted_depth(source_m, map[y * self.source.width + x]),
            };
        }
        depth
    }

    fn undistort_rgb(&self, source: &[u8], map: &[[f32; 2]]) -> Vec<u8> {
        let width = self.source.width;
        let height = self.source.height;
        let mut out = Vec::with_capacity(source.len());
        for &[x, y] in map {
            // Outside of the image its edge is repeated. There is no depth at these pixels.
            let x = x.clamp(0.0, width as f32 - 1.0);
            let y = y.clamp(0.0, height as f32 - 1.0);
            let x0 = x as usize;
            let y0 = y as usize;
            let x1 = (x0 + 1).min(width - 1);
            let y1 = (y0 + 1).min(height - 1);
            let fx = x - x0 as f32;
            let fy = y - y0 as f32;
            for channel in 0..3 {
                let [top_left, top_right, bottom_left, bottom_right] =
                    [(x0, y0), (x1, y0), (x0, y1), (x1, y1)]
                        .map(|(x, y)| f32::from(source[(y * width + x) * 3 + channel]));
                let upper = top_left + fx * (top_right - top_left);
                let lower = bottom_left + fx * (bottom_right - bottom_left);
                out.push((upper + fy * (lower - upper)).round() as u8);
            }
        }
        out
    }

    fn distorted_depth(&self, source_m: &[f32], [x, y]: [f32; 2]) -> f32 {
        let x = x.round();
        let y = y.round();
        if x >= 0.0
            && y >= 0.0
            && (x as usize) < self.source.width
            && (y as usize) < self.source.height
        {
            source_m[y as usize * self.source.width + x as usize]
        } else {
            0.0
        }
    }
}

/// Source coordinates of every pixel of the undistorted image; `None` without distortion.
fn undistortion(source: &CameraModel) -> Option<Vec<[f32; 2]>> {
    if source.distortion == Distortion::None {
        return None;
    }
    let coordinates = (0..source.width * source.height).map(|index| {
        let ray = source.ray((index % source.width) as f64, (index / source.width) as f64);
        let (x, y) = source.distorted_pixel(ray.x, ray.y);
        [x as f32, y as f32]
    });
    Some(coordinates.collect())
}

/// Source pixels and weights of one target pixel along one axis.
struct Taps {
    first: usize,
    weights: Vec<f32>,
}

/// The taps of all `targets` target pixels along an axis with `sources` source pixels.
fn taps(start: f64, step: f64, targets: usize, sources: usize) -> Vec<Taps> {
    let reach = step.max(1.0);
    (0..targets)
        .map(|target| {
            let centre = (target as f64 + 0.5) * step + start - 0.5;
            let first = nearest((centre - reach).floor() + 1.0, sources);
            let last = nearest((centre + reach).ceil() - 1.0, sources);
            let mut weights: Vec<f32> = (first..=last)
                .map(|at| (1.0 - (at as f64 - centre).abs() / reach).max(0.0) as f32)
                .collect();
            let sum: f32 = weights.iter().sum();
            weights.iter_mut().for_each(|weight| *weight /= sum);
            Taps { first, weights }
        })
        .collect()
}

fn nearest(at: f64, count: usize) -> usize {
    (at.round().max(0.0) as usize).min(count - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kinect() -> CameraModel {
        CameraModel {
            width: 640,
            height: 480,
            fx: 521.7,
            fy: 521.7,
            cx: 320.5,
            cy: 233.2,
            distortion: Distortion::None,
        }
    }

    /// An image in which red is the column and green is the row.
    fn ramp(width: usize, height: usize) -> Vec<u8> {
        (0..width * height).flat_map(|i| [(i % width) as u8, (i / width) as u8, 0]).collect()
    }

    #[test]
    fn at_the_same_width_the_image_is_cropped_and_no_pixel_changes() {
        let resampler = Resampler::new(&kinect(), 640, 192);
        assert_eq!((resampler.camera().fx, resampler.camera().cx), (521.7, 320.5));
        assert!((resampler.camera().cy - (233.2 - 144.0)).abs() < 1e-9);
        let source: Vec<u8> = (0..640 * 480 * 3).map(|i| (i * 31 % 251) as u8).collect();
        assert_eq!(resampler.rgb(&source), source[144 * 640 * 3..336 * 640 * 3]);
    }

    #[test]
    fn halving_a_ramp_gives_the_means_of_its_pixels() {
        let camera = CameraModel { width: 128, height: 64, ..kinect() };
        let small = Resampler::new(&camera, 64, 32).rgb(&ramp(128, 64));
        // Target pixel (10, 5) is centred on source (20.5, 10.5).
        let at = (5 * 64 + 10) * 3;
        assert!(
            (f32::from(small[at]) - 20.5).abs() <= 0.5
                && (f32::from(small[at + 1]) - 10.5).abs() <= 0.5
        );
    }

    #[test]
    fn a_checkerboard_becomes_grey_instead_of_aliasing() {
        let camera = CameraModel { width: 90, height: 90, ..kinect() };
        let board: Vec<u8> = (0..90 * 90)
            .flat_map(|i| [if (i % 90 + i / 90) % 2 == 0 { 255 } else { 0 }; 3])
            .collect();
        let small = Resampler::new(&camera, 30, 30).rgb(&board);
        assert!(small.iter().all(|value| (100..156).contains(value)));
    }

    #[test]
    fn depth_is_resampled_by_nearest_neighbour_and_keeps_holes() {
        let camera = CameraModel { width: 4, height: 4, ..kinect() };
        let mut source: Vec<f32> = (0..16).map(|i| i as f32).collect();
        source[5] = 0.0;
        let same = Resampler::new(&camera, 4, 4).depth(&source);
        assert_eq!(same.values(), source);
        let large = Resampler::new(&camera, 8, 8).depth(&source);
        assert!(large.values().iter().all(|value| source.contains(value)));
    }

    fn brightness(x: f64) -> f64 {
        128.0 + 150.0 * x
    }

    #[test]
    fn an_undistorted_grid_is_straight_again() {
        let k = [0.1, -0.05, 0.001, -0.002, 0.0];
        let camera = CameraModel { distortion: Distortion::PlumbBob(k), ..kinect() };
        let resampler = Resampler::new(&camera, 640, 480);
        // A distorted image of a scene whose brightness grows along x. After undistortion every
        // pixel must have the brightness of the pinhole's ray.
        let map = undistortion(&camera).unwrap();
        let mut distorted = vec![0_u8; 640 * 480 * 3];
        for v in 0..480 {
            for u in 0..640 {
                let (mut x, mut y) =
                    ((u as f64 - camera.cx) / camera.fx, (v as f64 - camera.cy) / camera.fy);
                let undistorted = (x, y);
                for _ in 0..20 {
                    let (dx, dy) = camera.distortion.distort(x, y);
                    x += undistorted.0 - dx;
                    y += undistorted.1 - dy;
                }
                distorted[(v * 640 + u) * 3..][..3].fill(brightness(x).round() as u8);
            }
        }
        let straight = resampler.rgb(&distorted);
        for (u, v) in [(100, 100), (320, 240), (500, 400), (420, 60)] {
            let expected = brightness(camera.ray(u as f64, v as f64).x);
            assert!((f64::from(straight[(v * 640 + u) * 3]) - expected).abs() < 1.6);
            assert!(map[v * 640 + u][0] > 0.0);
        }
    }

    proptest! {
        #[test]
        fn every_pixel_keeps_its_ray_at_any_size(width in 16_usize..700, height in 16_usize..500, u in 0.0..1.0f64, v in 0.0..1.0f64) {
            let resampler = Resampler::new(&kinect(), width, height);
            let u = u * (width - 1) as f64;
            let v = v * (height - 1) as f64;
            let source = kinect().ray(
                (u + 0.5) * resampler.step + resampler.left - 0.5, (v + 0.5) * resampler.step + resampler.top - 0.5);
            prop_assert!((resampler.camera().ray(u, v) - source).norm() < 1e-9);
            prop_assert!(resampler.left >= -1e-9 && resampler.top >= -1e-9);
        }

        #[test]
        fn weights_sum_to_one_inside_the_image(start in 0.0..10.0f64, step in 0.2..6.0f64, sources in 1_usize..200) {
            let targets = ((sources as f64 - start) / step).max(0.0) as usize;
            for tap in taps(start, step, targets, sources) {
                prop_assert!(tap.first + tap.weights.len() <= sources);
                prop_assert!((tap.weights.iter().sum::<f32>() - 1.0).abs() < 1e-4);
            }
        }
    }
}
