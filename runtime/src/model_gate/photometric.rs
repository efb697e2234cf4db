//! Do earlier pictures, moved by a depth and the known motion, look like this one?
//!
//! The error is the trainer's: 0.85 (1 - SSIM) / 2 + 0.15 L1 over 3x3 pixels (Godard et al. 2019), of several sources the least,
//! pixel by pixel. A pixel that a depth sends out of a source's picture, or that has no depth, costs there what the unmoved
//! source costs: saying nothing is never better than not moving. Pictures are compared at half size: an error of depth that moves
//! a pixel is seen there too, and it costs a quarter.

use hal::{CameraModel, Pose3};
use nalgebra::Point3;

/// Weight of SSIM beside L1, and its constants for pictures in 0..1.
const ALPHA: f32 = 0.85;
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

/// An earlier picture of the same camera.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    /// RGB8, row-major.
    pub rgb: &'a [u8],
    /// Maps points of the target's `camera_optical` into the source's.
    pub t_source_target: Pose3,
}

/// Compares pictures of one camera. Owns its memory.
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
    /// For pictures of `camera`.
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

    /// Mean error over the picture with the depth (metres, row-major, 0: none), and with sources that are not moved at all.
    /// `None` without a source.
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

    /// What the target would look like if the depth were right; NaN where the source does not show it.
    fn warp(&mut self, depth_m: &[f32], t_source_target: &Pose3) {
        let (width, height) = (self.camera.width, self.camera.height);
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

/// Of the 2x2 pixels from (u, v) on, those that have a depth; by inverse depth, which is even where surfaces are.
fn mean_depth(depth_m: &[f32], width: usize, u: usize, v: usize) -> f32 {
    let block = [v * width + u, v * width + u + 1, (v + 1) * width + u, (v + 1) * width + u + 1];
    let inverse = block
        .map(|at| depth_m.get(at).copied().filter(|depth| *depth > 0.0).map_or(0.0, f32::recip));
    let known = inverse.iter().filter(|inverse| **inverse > 0.0).count();
    if known == 0 { 0.0 } else { known as f32 / inverse.iter().sum::<f32>() }
}

/// RGB8 to half its size, in 0..1.
fn shrink(rgb: &[u8], width: usize, out: &mut [[f32; 3]]) {
    let half = width / 2;
    for (index, pixel) in out.iter_mut().enumerate() {
        let (u, v) = (2 * (index % half), 2 * (index / half));
        *pixel = [0, 1, 2].map(|colour| {
            let value = |u: usize, v: usize| {
                f32::from(rgb.get(3 * (v * width + u) + colour).copied().unwrap_or(0))
            };
            (value(u, v) + value(u + 1, v) + value(u, v + 1) + value(u + 1, v + 1)) / (4.0 * 255.0)
        });
    }
}

/// The colour at (x, y), which is inside.
fn bilinear(pixels: &[[f32; 3]], width: usize, height: usize, x: f32, y: f32) -> [f32; 3] {
    let (left, top) =
        ((x as usize).min(width.saturating_sub(2)), (y as usize).min(height.saturating_sub(2)));
    let (fx, fy) = (x - left as f32, y - top as f32);
    let at = |u: usize, v: usize| pixels.get(v * width + u).copied().unwrap_or([f32::NAN; 3]);
    let (a, b, c, d) = (at(left, top), at(left + 1, top), at(left, top + 1), at(left + 1, top + 1));
    [0, 1, 2].map(|i| {
        let (upper, lower) = (a[i] + fx * (b[i] - a[i]), c[i] + fx * (d[i] - c[i]));
        upper + fy * (lower - upper)
    })
}

/// Error of the 3x3 pixels around (u, v), the border repeated; NaN where one of them is not known.
fn patch_error(
    x: &[[f32; 3]],
    y: &[[f32; 3]],
    (width, height): (usize, usize),
    u: usize,
    v: usize,
) -> f32 {
    let (mut sx, mut sy, mut sxx, mut syy, mut sxy) =
        ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]);
    for row in [v.saturating_sub(1), v, (v + 1).min(height - 1)] {
        for column in [u.saturating_sub(1), u, (u + 1).min(width - 1)] {
            let (a, b) = (x[row * width + column], y[row * width + column]);
            for i in 0..3 {
                sx[i] += a[i];
                sy[i] += b[i];
                sxx[i] += a[i] * a[i];
                syy[i] += b[i] * b[i];
                sxy[i] += a[i] * b[i];
            }
        }
    }
    let (a, b) = (x[v * width + u], y[v * width + u]);
    let mut error = 0.0;
    for i in 0..3 {
        let (mx, my) = (sx[i] / 9.0, sy[i] / 9.0);
        let (vx, vy, cov) =
            (sxx[i] / 9.0 - mx * mx, syy[i] / 9.0 - my * my, sxy[i] / 9.0 - mx * my);
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

    /// A wall across the optical axis, `depth_m` before a camera that stands at `x_m`.
    pub fn wall(depth_m: f64, x_m: f64) -> Vec<u8> {
        let camera = camera();
        let colour = |index: usize| {
            let ray = camera.ray((index % SIZE.0) as f64, (index / SIZE.0) as f64) * depth_m;
            let (x, y) = (ray.x + x_m, ray.y);
            [5.0, 7.0, 9.0]
                .map(|f| (120.0 + 50.0 * (f * x).sin() + 40.0 * (f * 1.3 * y).cos()).round() as u8)
        };
        (0..SIZE.0 * SIZE.1).flat_map(colour).collect()
    }

    fn error_at(depth_m: f32) -> (f64, f64) {
        let (target, source) = (wall(2.0, 0.0), wall(2.0, -0.2));
        let sources = [Source { rgb: &source, t_source_target: Pose3::translation(0.2, 0.0, 0.0) }];
        Photometric::new(&camera())
            .error(&target, &vec![depth_m; SIZE.0 * SIZE.1], &sources)
            .unwrap()
    }

    #[test]
    fn the_true_depth_explains_a_picture_best_and_the_error_grows_both_ways() {
        let errors: Vec<f64> =
            [0.8, 1.2, 1.6, 2.0, 2.6, 3.5, 6.0].map(|depth| error_at(depth).0).to_vec();
        let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
        assert!((errors[3] - best).abs() < 1e-12 && errors[3] < 0.5 * errors[5], "{errors:?}");
        assert!(errors[3..].is_sorted(), "{errors:?}");
        assert!(errors[3] < 0.3 * error_at(2.0).1, "{errors:?}");
    }

    #[test]
    fn saying_nothing_or_sending_everything_out_of_the_picture_costs_what_not_moving_costs() {
        for depth_m in [0.0, 0.01] {
            let (error, unmoved) = error_at(depth_m);
            assert!((error - unmoved).abs() < 1e-9, "{depth_m}: {error} {unmoved}");
        }
    }

    #[test]
    fn a_second_source_never_makes_it_worse() {
        let (target, one, two) = (wall(2.0, 0.0), wall(2.0, -0.2), wall(2.0, 0.1));
        let depth = vec![2.0; SIZE.0 * SIZE.1];
        let source = |rgb, x| Source { rgb, t_source_target: Pose3::translation(x, 0.0, 0.0) };
        let mut photometric = Photometric::new(&camera());
        let alone = photometric.error(&target, &depth, &[source(&one, 0.2)]).unwrap().0;
        let both =
            photometric.error(&target, &depth, &[source(&one, 0.2), source(&two, -0.1)]).unwrap().0;
        assert!(both <= alone, "{both} {alone}");
        assert_eq!(photometric.error(&target, &depth, &[]), None);
    }
}
