//! Matching costs: every pixel of the half-size picture against every inverse-depth hypothesis, in every reference.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::census::{BITS, CensusImage};

/// Number of inverse-depth hypotheses. Fixed, so that the inner loops have a known length.
pub const PLANES: usize = 64;
/// Most references for one picture.
pub const MAX_REFERENCES: usize = 3;
/// Cost of a hypothesis that no reference sees: half of the bits differ, as between random pictures. Costs are quarters of
/// a bit.
const UNSEEN: u8 = BITS as u8 / 2 * 4;
/// A single reference's mark for "not seen".
const OUTSIDE: u8 = u8::MAX;

/// Inverse depths from far to near, 1/m. The steps grow towards the camera (exponent 1.5): even steps would spend half
/// of the hypotheses on the last few decimetres.
pub fn hypotheses(min_depth_m: f64, max_depth_m: f64) -> [f32; PLANES] {
    let (far, near) = (1.0 / max_depth_m, 1.0 / min_depth_m);
    std::array::from_fn(|i| (far + (near - far) * (i as f64 / (PLANES - 1) as f64).powf(1.5)) as f32)
}

/// A picture to compare with, ready to look up matches: the point behind position `u` at inverse depth `w` is seen at the
/// homogeneous position `rotation * u + w * translation`.
pub struct Reference<'a> {
    census: &'a CensusImage,
    rotation: Matrix3<f32>,
    translation: Vector3<f32>,
}

impl<'a> Reference<'a> {
    /// A reference that sees the points of this camera through `t_reference_camera`. `camera` describes the positions of
    /// descriptors.
    pub fn new(census: &'a CensusImage, t_reference_camera: &Pose3, camera: &CameraModel) -> Self {
        let k = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
        let back = Matrix3::from_columns(&[
            camera.ray(1.0, 0.0) - camera.ray(0.0, 0.0),
            camera.ray(0.0, 1.0) - camera.ray(0.0, 0.0),
            camera.ray(0.0, 0.0),
        ]);
        let rotation = k * t_reference_camera.rotation.to_rotation_matrix().matrix() * back;
        Self { census, rotation: rotation.cast(), translation: (k * t_reference_camera.translation.vector).cast() }
    }

    /// How far the point at (u, v) with inverse depth `w` is from where it would be at infinity, in full-size pixels;
    /// `None` where the reference does not see it.
    pub fn parallax_px(&self, u: f32, v: f32, w: f32) -> Option<f32> {
        let far = self.rotation * Vector3::new(u, v, 1.0);
        let near = far + self.translation * w;
        let (x, y) = (near.x / near.z, near.y / near.z);
        let (right, bottom) = ((self.census.width - 1) as f32, (self.census.height - 1) as f32);
        let inside = near.z > 0.05 && x >= 0.0 && y >= 0.0 && x <= right && y <= bottom;
        inside.then(|| (x - far.x / far.z).hypot(y - far.y / far.z))
    }

    /// Differing bits of all hypotheses for the pixel at full-size position (u, v); [`OUTSIDE`] where it is not seen.
    fn match_pixel(&self, u: f32, v: f32, descriptor: u32, inverse_depth: &[f32; PLANES], bits: &mut [u8; PLANES]) {
        let a = self.rotation * Vector3::new(u, v, 1.0);
        let t = self.translation;
        let (width, height) = (self.census.width as i32, self.census.height as i32);
        let outside = width * height;
        let mut places = [0_i32; PLANES];
        for (place, w) in places.iter_mut().zip(inverse_depth) {
            let z = a.z + w * t.z;
            let scale = 1.0 / z;
            let x = nearest((a.x + w * t.x) * scale);
            let y = nearest((a.y + w * t.y) * scale);
            let inside = (z > 0.05) & (x >= 0) & (x < width) & (y >= 0) & (y < height);
            *place = if inside { y.wrapping_mul(width).wrapping_add(x) } else { outside };
        }
        let mut found = [0_u32; PLANES];
        for (found, place) in found.iter_mut().zip(&places) {
            *found = self.census.descriptors.get(*place as usize).copied().unwrap_or_default();
        }
        for ((bits, found), place) in bits.iter_mut().zip(&found).zip(&places) {
            let differing = (found ^ descriptor).count_ones() as u8;
            *bits = if *place == outside { OUTSIDE } else { differing };
        }
    }
}

/// Rounds to the nearest integer without leaving the vector unit: adding 1.5 * 2^23 leaves the integer in the mantissa.
/// Right up to 2^22; beyond that the result is some place outside of any picture.
pub fn nearest(x: f32) -> i32 {
    const MAGIC: f32 = 12_582_912.0;
    (x + MAGIC).to_bits().wrapping_sub(MAGIC.to_bits()) as i32
}

/// Fills `volume` (half-size rows x columns x planes) with the fused cost of up to [`MAX_REFERENCES`].
pub fn sweep(
    picture: &CensusImage,
    references: &[Reference<'_>],
    inverse_depth: &[f32; PLANES],
    volume: &mut [[u8; PLANES]],
) {
    volume.par_chunks_exact_mut(picture.width / 2).enumerate().for_each(|(row, line)| {
        let mut each = [[OUTSIDE; PLANES]; MAX_REFERENCES];
        for (column, out) in line.iter_mut().enumerate() {
            let descriptor = picture.descriptors[2 * row * picture.width + 2 * column];
            let (u, v) = (2.0 * column as f32, 2.0 * row as f32);
            for (reference, bits) in references.iter().zip(&mut each) {
                reference.match_pixel(u, v, descriptor, inverse_depth, bits);
            }
            fuse(&each, out);
        }
    });
}

/// Mean over the references that see a hypothesis, without the worst of three: there it may be hidden.
fn fuse(each: &[[u8; PLANES]; MAX_REFERENCES], out: &mut [u8; PLANES]) {
    for (plane, out) in out.iter_mut().enumerate() {
        let (mut sum, mut count, mut worst) = (0_u8, 0_u8, 0_u8);
        for bits in each {
            let seen = bits[plane] != OUTSIDE;
            let bits = if seen { bits[plane] } else { 0 };
            sum = sum.wrapping_add(bits);
            worst = worst.max(bits);
            count = count.wrapping_add(u8::from(seen));
        }
        // At most 96: no sum or product here overflows, and saying so keeps checked builds in the vector unit.
        let kept = if count == 3 { sum.wrapping_sub(worst) } else { sum };
        let cost = if count == 1 { kept << 2 } else { kept << 1 };
        *out = if count == 0 { UNSEEN } else { cost };
    }
}

/// Mean cost over 3x3 pixels, plane by plane; beyond the edge the edge is repeated. `rows` is scratch.
pub fn smooth_3x3(volume: &[[u8; PLANES]], width: usize, rows: &mut [[u16; PLANES]], out: &mut [[u8; PLANES]]) {
    rows.par_chunks_exact_mut(width).zip(volume.par_chunks_exact(width)).for_each(|(sums, costs)| {
        for (column, sum) in sums.iter_mut().enumerate() {
            let (left, right) = (&costs[column.saturating_sub(1)], &costs[(column + 1).min(width - 1)]);
            for (plane, sum) in sum.iter_mut().enumerate() {
                let outer = u16::from(left[plane]).wrapping_add(u16::from(right[plane]));
                *sum = outer.wrapping_add(u16::from(costs[column][plane]));
            }
        }
    });
    let (rows, last) = (&*rows, volume.len() / width - 1);
    out.par_chunks_exact_mut(width).enumerate().for_each(|(row, out)| {
        let (above, below) = (row.saturating_sub(1) * width, (row + 1).min(last) * width);
        for (column, out) in out.iter_mut().enumerate() {
            let (a, b, c) = (&rows[above + column], &rows[row * width + column], &rows[below + column]);
            for (plane, out) in out.iter_mut().enumerate() {
                // 57 / 512 is a ninth; the sum is at most 9 * 96.
                let sum = a[plane].wrapping_add(b[plane]).wrapping_add(c[plane]);
                *out = (sum.wrapping_mul(57) >> 9) as u8;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hypotheses_go_from_far_to_near_with_growing_steps() {
        let w = hypotheses(0.3, 20.0);
        assert!((w[0] - 0.05).abs() < 1e-6 && (w[PLANES - 1] - 1.0 / 0.3).abs() < 1e-5);
        assert!(w.windows(3).all(|w| w[1] > w[0] && w[2] - w[1] > w[1] - w[0]));
    }

    #[test]
    fn places_are_rounded_and_the_far_outside_stays_outside() {
        for (x, want) in [(0.4, 0), (0.6, 1), (-0.4, 0), (-0.6, -1), (639.2, 639)] {
            assert_eq!(nearest(x), want);
        }
        for x in [1e7, 1e12, f32::MAX, f32::INFINITY, -1e7, -1e30, f32::NEG_INFINITY] {
            assert!(!(0..16384).contains(&nearest(x)), "{x}");
        }
    }

    #[test]
    fn the_worst_of_three_is_left_out_and_what_nobody_sees_is_neutral() {
        let mut out = [0; PLANES];
        fuse(&[[4; PLANES], [6; PLANES], [24; PLANES]], &mut out);
        assert_eq!(out[0], 20);
        fuse(&[[4; PLANES], [6; PLANES], [OUTSIDE; PLANES]], &mut out);
        assert_eq!(out[0], 20);
        fuse(&[[4; PLANES], [OUTSIDE; PLANES], [OUTSIDE; PLANES]], &mut out);
        assert_eq!(out[0], 16);
        fuse(&[[OUTSIDE; PLANES]; 3], &mut out);
        assert_eq!(out[0], UNSEEN);
    }

    #[test]
    fn smoothing_keeps_a_constant_and_spreads_a_peak() {
        let mut volume = vec![[90_u8; PLANES]; 5 * 4];
        let (mut rows, mut out) = (vec![[0; PLANES]; 20], vec![[0; PLANES]; 20]);
        smooth_3x3(&volume, 5, &mut rows, &mut out);
        assert!(out.iter().all(|costs| costs[7] == 90));
        volume.fill([0; PLANES]);
        volume[5 + 2] = [90; PLANES];
        smooth_3x3(&volume, 5, &mut rows, &mut out);
        assert_eq!((out[2][0], out[5 + 1][0], out[10 + 3][0], out[4][0]), (10, 10, 10, 0));
    }

    #[test]
    fn parallax_is_f_b_over_z() {
        let mut census = CensusImage::default();
        (census.width, census.height) = (640, 192);
        let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
        let reference = Reference::new(&census, &Pose3::translation(0.1, 0.0, 0.0), &camera);
        assert!((reference.parallax_px(300.0, 90.0, 0.5).unwrap() - 320.0 * 0.1 * 0.5).abs() < 1e-3);
        assert_eq!(reference.parallax_px(639.0, 90.0, 0.5), None);
    }
}
