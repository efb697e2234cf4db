//! The photometric error of a depth map: how well earlier frames, warped by the depth and the known
//! motion, match a frame.
//!
//! The error is the one that the trainer uses: 0.85 (1 - SSIM) / 2 + 0.15 L1 over 3x3 pixels
//! (Godard et al. 2019), the minimum over all sources for each pixel. A pixel without depth, or one
//! that the warp moves outside of the source, has the error of the source without a warp, so that a
//! missing depth is never better than assuming no motion. Frames are compared at half size, which
//! needs a quarter of the time; a depth error that moves a pixel is still visible there.

use hal::{CameraModel, Pose3};
use nalgebra::Point3;

/// Weight of SSIM; L1 has the weight 1 - ALPHA. C1 and C2 are SSIM's constants for values in 0..1.
const ALPHA: f32 = 0.85;
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

/// An earlier frame of the same camera.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    /// Pixels in RGB8, row-major.
    pub rgb: &'a [u8],
    /// Maps points of the target frame's `camera_optical` into that of the source frame.
    pub t_source_target: Pose3,
}

/// Computes photometric errors for the frames of one camera and reuses its buffers.
#[derive(Debug)]
pub struct Photometric {
    camera: CameraModel,
    full_width: usize,
    target: Vec<[f32; 3]>,
    source: Vec<[f32; 3]>,
    warped: Vec<[f32; 3]>,
    error: Vec<f32>,
    unmoved: Vec<f32>,
}

impl Photometric {
    /// Allocates the buffers for frames of `camera`.
    #[must_use]
    pub fn new(camera: &CameraModel) -> Self {
        let half = camera.resized(camera.width / 2, camera.height / 2);
        let pixels = half.width * half.height;
        Self {
            camera: half,
            full_width: camera.width,
            target: vec![[0.0; 3]; pixels],
            source: vec![[0.0; 3]; pixels],
            warped: vec![[0.0; 3]; pixels],
            error: vec![0.0; pixels],
            unmoved: vec![0.0; pixels],
        }
    }

    /// The mean errors over the frame: with sources warped by the depth (metres, row-major, 0:
    /// none), and with sources that are not warped. `None` without a source.
    pub fn error(
        &mut self,
        rgb: &[u8],
        depth_m: &[f32],
        sources: &[Source<'_>],
    ) -> Option<(f64, f64)> {
        if sources.is_empty() {
            return None;
        }
        shrink(rgb, self.full_width, &mut self.target);
        self.error.fill(f32::INFINITY);
        self.unmoved.fill(f32::INFINITY);
        for source in sources {
            shrink(source.rgb, self.full_width, &mut self.source);
            self.warp(depth_m, &source.t_source_target);
            let size = (self.camera.width, self.camera.height);
            for v in 0..size.1 {
                for u in 0..size.0 {
                    let at = v * size.0 + u;
                    let still = patch_error(&self.target, &self.source, size, u, v);
                    let moved = patch_error(&self.target, &self.warped, size, u, v);
                    self.unmoved[at] = self.unmoved[at].min(still);
                    self.error[at] = self.error[at].min(if moved.is_nan() { still } else { moved });
                }
            }
        }
        Some((mean(&self.error), mean(&self.unmoved)))
    }

    /// Fills `warped` with the source, warped to the target by the depth; NaN where the source does
    /// not show the point.
    fn warp(&mut self, depth_m: &[f32], t_source_target: &Pose3) {
        let width = self.camera.width;
        let height = self.camera.height;
        for v in 0..height {
            for u in 0..width {
                let depth = mean_depth(depth_m, self.full_width, 2 * u, 2 * v);
                let point: Point3<f64> =
                    t_source_target * self.camera.unproject(u as f64, v as f64, f64::from(depth));
                let pixel = self.camera.project(&point).filter(|_| depth > 0.0);
                self.warped[v * width + u] = match pixel {
                    Some((x, y))
                        if x >= 0.0
                            && y >= 0.0
                            && x <= (width - 1) as f64
                            && y <= (height - 1) as f64 =>
                    {
                        bilinear(&self.source, width, height, x as f32, y as f32)
                    }
                    _ => [f32::NAN; 3],
                };
            }
        }
    }
}

/// Mean depth of the 2x2 pixels from (u, v) on that have a depth; 0 if none has. The mean is taken
/// over inverse depth, because inverse depth is linear in the image on flat surfaces.
fn mean_depth(depth_m: &[f32], width: usize, u: usize, v: usize) -> f32 {
    let block = [v * width + u, v * width + u + 1, (v + 1) * width + u, (v + 1) * width + u + 1];
    let inverse = block
        .map(|at| depth_m.get(at).copied().filter(|depth| *depth > 0.0).map_or(0.0, f32::recip));
    let known = inverse.iter().filter(|inverse| **inverse > 0.0).count();
    if known == 0 { 0.0 } else { known as f32 / inverse.iter().sum::<f32>() }
}

/// Scales an RGB8 image to half its size, with values in 0..1.
fn shrink(rgb: &[u8], width: usize, out: &mut [[f32; 3]]) {
    let half = width / 2;
    for (index, pixel) in out.iter_mut().enumerate() {
        let u = 2 * (index % half);
        let v = 2 * (index / half);
        *pixel = [0, 1, 2].map(|colour| {
            let [a, b, c, d] = [(u, v), (u + 1, v), (u, v + 1), (u + 1, v + 1)].map(|(u, v)| {
                f32::from(rgb.get(3 * (v * width + u) + colour).copied().unwrap_or(0))
            });
            (a + b + c + d) / (4.0 * 255.0)
        });
    }
}

/// The bilinearly interpolated colour at (x, y), which must lie inside the image.
fn bilinear(pixels: &[[f32; 3]], width: usize, height: usize, x: f32, y: f32) -> [f32; 3] {
    let left = (x as usize).min(width.saturating_sub(2));
    let top = (y as usize).min(height.saturating_sub(2));
    let fx = x - left as f32;
    let fy = y - top as f32;
    let [a, b, c, d] = [(left, top), (left + 1, top), (left, top + 1), (left + 1, top + 1)]
        .map(|(u, v)| pixels.get(v * width + u).copied().unwrap_or([f32::NAN; 3]));
    [0, 1, 2].map(|i| {
        let upper = a[i] + fx * (b[i] - a[i]);
        let lower = c[i] + fx * (d[i] - c[i]);
        upper + fy * (lower - upper)
    })
}

/// Error of the 3x3 pixels around (u, v), with the border pixels repeated; NaN if one of them is
/// NaN.
fn patch_error(
    x: &[[f32; 3]],
    y: &[[f32; 3]],
    (width, height): (usize, usize),
    u: usize,
    v: usize,
) -> f32 {
    let mut sx = [0.0; 3];
    let mut sy = [0.0; 3];
    let mut sxx = [0.0; 3];
    let mut syy = [0.0; 3];
    let mut sxy = [0.0; 3];
    for row in [v.saturating_sub(1), v, (v + 1).min(height - 1)] {
        for column in [u.saturating_sub(1), u, (u + 1).min(width - 1)] {
            let a = x[row * width + column];
            let b = y[row * width + column];
            for i in 0..3 {
                sx[i] += a[i];
                sy[i] += b[i];
                sxx[i] += a[i] * a[i];
                syy[i] += b[i] * b[i];
                sxy[i] += a[i] * b[i];
            }
        }
    }
    let a = x[v * width + u];
    let b = y[v * width + u];
    let mut error = 0.0;
    for i in 0..3 {
        let mx = sx[i] / 9.0;
        let my = sy[i] / 9.0;
        let vx = sxx[i] / 9.0 - mx * mx;
        let vy = syy[i] / 9.0 - my * my;
        let cov = sxy[i] / 9.0 - mx * my;
        let ssim = (2.0 * mx * my + C1) * (2.0 * cov + C2)
            / ((mx * mx + my * my + C1) * (vx.max(0.0) + vy.max(0.0) + C2));
        error += ALPHA * 0.5 * (1.0 - ssim) + (1.0 - ALPHA) * (a[i] - b[i]).abs();
    }
    error / 3.0
}

fn mean(errors: &[f32]) -> f64 {
    errors.iter().map(|error| f64::from(*error)).sum::<f64>() / errors.len().max(1) as f64
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    pub const SIZE: (usize, usize) = (96, 48);

    pub fn camera() -> CameraModel {
        CameraModel::pinhole(SIZE.0, SIZE.1, FRAC_PI_2)
    }

    /// An image of a textured wall at a right angle to the optical axis, `depth_m` ahead of a
    /// camera at `x_m`.
    pub fn wall(depth_m: f64, x_m: f64) -> Vec<u8> {
        let camera = camera();
        (0..SIZE.0 * SIZE.1)
            .map(|index| camera.ray((index % SIZE.0) as f64, (index / SIZE.0) as f64) * depth_m)
            .flat_map(|point| wall_colour(point.x + x_m, point.y))
            .collect()
    }

    fn wall_colour(x: f64, y: f64) -> [u8; 3] {
        [5.0, 7.0, 9.0]
            .map(|f| (120.0 + 50.0 * (f * x).sin() + 40.0 * (f * 1.3 * y).cos()).round() as u8)
    }

    fn error_at(depth_m: f32) -> (f64, f64) {
        let target = wall(2.0, 0.0);
        let source = wall(2.0, -0.2);
        let sources = [Source { rgb: &source, t_source_target: Pose3::translation(0.2, 0.0, 0.0) }];
        Photometric::new(&camera())
            .error(&target, &vec![depth_m; SIZE.0 * SIZE.1], &sources)
            .unwrap()
    }

    #[test]
    fn the_true_depth_has_the_least_error_and_the_error_grows_in_both_directions() {
        let errors: Vec<f64> =
            [0.8, 1.2, 1.6, 2.0, 2.6, 3.5, 6.0].map(|depth| error_at(depth).0).to_vec();
        let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
        assert!((errors[3] - best).abs() < 1e-12 && errors[3] < 0.5 * errors[5], "{errors:?}");
        assert!(errors[3..].is_sorted(), "{errors:?}");
        assert!(errors[3] < 0.3 * error_at(2.0).1, "{errors:?}");
    }

    #[test]
    fn no_depth_or_a_warp_out_of_the_image_has_the_error_of_no_motion() {
        for depth_m in [0.0, 0.01] {
            let (error, unmoved) = error_at(depth_m);
            assert!((error - unmoved).abs() < 1e-9, "{depth_m}: {error} {unmoved}");
        }
    }

    #[test]
    fn a_second_source_never_increases_the_error() {
        let target = wall(2.0, 0.0);
        let one = wall(2.0, -0.2);
        let two = wall(2.0, 0.1);
        let depth = vec![2.0; SIZE.0 * SIZE.1];
        let mut photometric = Photometric::new(&camera());
        let alone = photometric.error(&target, &depth, &[source(&one, 0.2)]).unwrap().0;
        let both =
            photometric.error(&target, &depth, &[source(&one, 0.2), source(&two, -0.1)]).unwrap().0;
        assert!(both <= alone, "{both} {alone}");
        assert_eq!(photometric.error(&target, &depth, &[]), None);
    }

    fn source(rgb: &[u8], x: f64) -> Source<'_> {
        Source { rgb, t_source_target: Pose3::translation(x, 0.0, 0.0) }
    }
}
