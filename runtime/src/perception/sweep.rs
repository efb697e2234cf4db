//! Matching costs: every pixel of the half-size picture against every inverse-depth hypothesis, in every reference.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::census::{BITS, CensusImage};

/// Most hypotheses; sizes the buffers of one pixel.
pub const MAX_PLANES: usize = 128;
/// Cost of a hypothesis that no reference sees: what random pictures cost.
pub const UNSEEN: u8 = (BITS * 2) as u8;
/// A mean of census bits is stored times this.
pub const COST_SCALE: u32 = 4;

/// One reference, ready to look up matches: position = (a + w t) in homogeneous full-size pixels of the reference, for the
/// inverse depth w.
pub struct Reference<'a> {
    census: &'a CensusImage,
    /// Homography of pure rotation from full-size pixels here to there.
    rotation: Matrix3<f32>,
    /// Epipole direction.
    translation: Vector3<f32>,
}

impl<'a> Reference<'a> {
    /// A reference whose camera sees points of this camera through `t_reference_camera`. `camera` describes the positions
    /// of descriptors: the full-size camera, moved by half a pixel because a descriptor is centred between 2x2 pixels.
    pub fn new(census: &'a CensusImage, t_reference_camera: &Pose3, camera: &CameraModel) -> Self {
        let k = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
        let back = Matrix3::new(
            1.0 / camera.fx,
            0.0,
            -camera.cx / camera.fx,
            0.0,
            1.0 / camera.fy,
            -camera.cy / camera.fy,
            0.0,
            0.0,
            1.0,
        );
        let rotation = k * t_reference_camera.rotation.to_rotation_matrix().matrix() * back;
        let translation = k * t_reference_camera.translation.vector;
        Self { census, rotation: rotation.cast(), translation: translation.cast() }
    }

    /// Distance in full-size pixels between the matches of two inverse depths, for parallax and its confidence.
    pub fn parallax_px(&self, u: f32, v: f32, near: f32, far: f32) -> f32 {
        let a = self.rotation * Vector3::new(u, v, 1.0);
        let (p, q) = (a + self.translation * near, a + self.translation * far);
        (p.x / p.z - q.x / q.z).hypot(p.y / p.z - q.y / q.z)
    }

    /// Costs of all hypotheses for the pixel at full-size position (u, v); 255 where the reference does not see it.
    fn match_pixel(&self, u: f32, v: f32, descriptor: u32, inverse_depth: &[f32], costs: &mut [u8; MAX_PLANES]) {
        let a = self.rotation * Vector3::new(u, v, 1.0);
        let t = self.translation;
        let (width, height) = (self.census.width as i32, self.census.height as i32);
        let outside = width * height;
        let mut at = [0_i32; MAX_PLANES];
        for (at, w) in at.iter_mut().zip(inverse_depth) {
            let z = a.z + w * t.z;
            let scale = 1.0 / z;
            let x = nearest((a.x + w * t.x) * scale);
            let y = nearest((a.y + w * t.y) * scale);
            let inside = (z > 0.05) & (x >= 0) & (x < width) & (y >= 0) & (y < height);
            *at = if inside { y * width + x } else { outside };
        }
        let mut found = [0_u32; MAX_PLANES];
        for (found, at) in found.iter_mut().zip(&at[..inverse_depth.len()]) {
            *found = self.census.descriptors.get(*at as usize).copied().unwrap_or_default();
        }
        for ((cost, found), at) in costs.iter_mut().zip(&found).zip(&at[..inverse_depth.len()]) {
            let bits = (found ^ descriptor).count_ones() as u8;
            *cost = if *at == outside { u8::MAX } else { bits };
        }
    }
}

/// Rounds to the nearest integer without leaving the vector unit: adding 1.5 * 2^23 leaves the integer in the mantissa.
/// Exact up to 2^22; beyond that the result is wrong but always outside of a picture.
fn nearest(x: f32) -> i32 {
    const MAGIC: f32 = 12_582_912.0;
    (x + MAGIC).to_bits().wrapping_sub(MAGIC.to_bits()) as i32
}

/// Fills `volume` (rows x columns x planes) with the fused cost of `references`.
pub fn sweep(picture: &CensusImage, references: &[Reference<'_>], inverse_depth: &[f32], volume: &mut [u8]) {
    let planes = inverse_depth.len();
    let (columns, row_length) = (picture.width / 2, picture.width / 2 * planes);
    volume.par_chunks_exact_mut(row_length).enumerate().for_each(|(row, costs)| {
        let mut each = [[0_u8; MAX_PLANES]; 8];
        for (column, out) in costs.chunks_exact_mut(planes).enumerate() {
            let descriptor = picture.descriptors[2 * row * picture.width + 2 * column];
            let (u, v) = (2.0 * column as f32, 2.0 * row as f32);
            for (reference, costs) in references.iter().zip(&mut each) {
                reference.match_pixel(u, v, descriptor, inverse_depth, costs);
            }
            fuse(&each[..references.len()], out);
        }
        debug_assert_eq!(costs.len(), columns * planes);
    });
}

/// Mean over the references that see a hypothesis, without the worst of three or more: that one may be occluded.
fn fuse(each: &[[u8; MAX_PLANES]], out: &mut [u8]) {
    for (plane, out) in out.iter_mut().enumerate() {
        let (mut sum, mut count, mut worst) = (0_u32, 0_u32, 0_u32);
        for costs in each {
            let cost = u32::from(costs[plane]);
            if cost != 255 {
                sum += cost;
                count += 1;
                worst = worst.max(cost);
            }
        }
        *out = match count {
            0 => UNSEEN,
            1 | 2 => (sum * COST_SCALE / count) as u8,
            _ => ((sum - worst) * COST_SCALE / (count - 1)) as u8,
        };
    }
}
