//! Plane sweep: the matching cost of every cell at every inverse-depth hypothesis, in every reference.

use hal::{CameraModel, Pose3};
use multiversion::multiversion;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::census::{BITS, CensusImage, NOWHERE};

/// Number of inverse-depth hypotheses. A constant, so that the inner loops have a known length.
pub const PLANES: usize = 64;
/// Number of hypotheses that count as far: beyond about 2 m for a range of 0.3 to 20 m.
pub const FAR: usize = PLANES / 4;
/// Maximum number of references for one frame.
pub const MAX_REFERENCES: usize = 3;
/// Side of a cell, the unit of depth, in full-size pixels.
pub const CELL: usize = 4;
/// Positions of the descriptors in a cell that are compared, full-size pixels. Four were no better than these two.
const TAPS: [(usize, usize); 2] = [(0, 0), (2, 2)];
const TAP_SPAN: usize = 2;
/// The cost of a hypothesis in which every bit differs.
pub const WORST_COST: u8 = 2 * TAPS.len() as u8 * BITS as u8;
/// Cost of a hypothesis that a reference does not see.
const OUTSIDE: u8 = u8::MAX;

/// Inverse depths from far to near, 1/m. The steps grow towards the camera (exponent 1.5): equal steps would spend half
/// of the hypotheses on the last few decimetres.
pub fn hypotheses(min_depth_m: f64, max_depth_m: f64) -> [f32; PLANES] {
    let far = 1.0 / max_depth_m;
    let near = 1.0 / min_depth_m;
    std::array::from_fn(|i| {
        (far + (near - far) * (i as f64 / (PLANES - 1) as f64).powf(1.5)) as f32
    })
}

/// A keyframe to match against: the point behind position `u` at inverse depth `w` projects to the homogeneous position
/// `rotation * u + w * translation` in it.
pub struct Reference<'a> {
    pub census: &'a CensusImage,
    rotation: Matrix3<f32>,
    translation: Vector3<f32>,
}

impl<'a> Reference<'a> {
    /// `t_reference_camera` maps points of the current camera to the reference's. `camera` has its pixels at the positions of
    /// the descriptors.
    pub fn new(census: &'a CensusImage, t_reference_camera: &Pose3, camera: &CameraModel) -> Self {
        let (rotation, translation) = homography(t_reference_camera, camera);
        Self { census, rotation, translation }
    }

    /// Distance of the point at (u, v) with inverse depth `w` from its projection at infinity, full-size pixels; `None` where
    /// the reference does not see it.
    pub fn parallax_px(&self, u: f32, v: f32, w: f32) -> Option<f32> {
        let far = self.rotation * Vector3::new(u, v, 1.0);
        let near = far + self.translation * w;
        let x = near.x / near.z;
        let y = near.y / near.z;
        let right = (self.census.width - 1) as f32;
        let bottom = (self.census.height - 1) as f32;
        let inside = near.z > 0.05 && x >= 0.0 && y >= 0.0 && x <= right && y <= bottom;
        inside.then(|| length(x - far.x / far.z, y - far.y / far.z))
    }

    /// Where the reference sees the point at (u, v) with inverse depth `w`; `None` where its position does not depend on its
    /// depth.
    #[inline(always)]
    pub fn observe(&self, u: f32, v: f32, w: f32) -> Option<Observation> {
        let t = &self.translation;
        let near = self.rotation * Vector3::new(u, v, 1.0) + t * w;
        let per_z = 1.0 / near.z;
        let x = near.x * per_z;
        let y = near.y * per_z;
        let motion = [(t.x - x * t.z) * per_z, (t.y - y * t.z) * per_z];
        let squared_speed = motion[0] * motion[0] + motion[1] * motion[1];
        let moves = squared_speed > f32::EPSILON * f32::EPSILON;
        (near.z > 0.05 && moves).then_some(Observation {
            position: [x, y],
            per_z,
            motion,
            squared_speed,
        })
    }

    /// How the reference sees the patch around an observed point, assuming that it is flat and faces the camera.
    #[inline(always)]
    pub fn observe_patch(&self, point: Observation) -> PatchObservation {
        let Observation { position: [x, y], per_z, motion, squared_speed } = point;
        let [along_u, along_v] = [0, 1].map(|column| {
            let by = self.rotation.column(column);
            [(by[0] - x * by[2]) * per_z, (by[1] - y * by[2]) * per_z]
        });
        PatchObservation { position: [x, y], along_u, along_v, motion, speed: squared_speed.sqrt() }
    }

    /// Differing bits of all hypotheses for the cell whose descriptors begin at full-size position (u, v); [`OUTSIDE`] where
    /// it is not seen. The descriptors of a cell are shifted together: rotation and scaling of a cell between two frames are
    /// less than a pixel.
    #[inline(always)]
    fn match_cell(
        &self,
        u: f32,
        v: f32,
        descriptors: &[u32; TAPS.len()],
        inverse_depth: &[f32; PLANES],
        bits: &mut [u8; PLANES],
    ) {
        let a = self.rotation * Vector3::new(u, v, 1.0);
        let t = self.translation;
        let width = self.census.width as i32;
        let height = self.census.height as i32;
        let right = width - TAP_SPAN as i32;
        let bottom = height - TAP_SPAN as i32;
        let mut places = [0_u32; PLANES];
        for (place, w) in places.iter_mut().zip(inverse_depth) {
            let z = a.z + w * t.z;
            let scale = 1.0 / z;
            let x = nearest((a.x + w * t.x) * scale);
            let y = nearest((a.y + w * t.y) * scale);
            let inside = (z > 0.05) & (x >= 0) & (x < right) & (y >= 0) & (y < bottom);
            *place = if inside { y.wrapping_mul(width).wrapping_add(x) as u32 } else { NOWHERE };
        }
        let [first, second] = TAPS.map(|(dx, dy)| {
            self.census.descriptors.get(dy * self.census.width + dx..).unwrap_or_default()
        });
        let own = u64::from(descriptors[0]) | u64::from(descriptors[1]) << 32;
        for (bits, place) in bits.iter_mut().zip(&places) {
            let at = *place as usize;
            *bits = match (first.get(at), second.get(at)) {
                (Some(first), Some(second)) => {
                    ((u64::from(*first) | u64::from(*second) << 32) ^ own).count_ones() as u8
                }
                _ => OUTSIDE,
            };
        }
    }
}

/// Rotation and translation of the homography family that maps pixel `u` at inverse depth `w` to `rotation * u + w *
/// translation` (homogeneous) in another view.
pub fn homography(
    t_reference_camera: &Pose3,
    camera: &CameraModel,
) -> (Matrix3<f32>, Vector3<f32>) {
    let k = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
    let back = Matrix3::from_columns(&[
        camera.ray(1.0, 0.0) - camera.ray(0.0, 0.0),
        camera.ray(0.0, 1.0) - camera.ray(0.0, 0.0),
        camera.ray(0.0, 0.0),
    ]);
    let rotation = k * t_reference_camera.rotation.to_rotation_matrix().matrix() * back;
    (rotation.cast(), (k * t_reference_camera.translation.vector).cast())
}

/// A `hypot` that can be vectorised: squares of single precision cannot overflow double precision.
#[inline(always)]
pub fn length(x: f32, y: f32) -> f32 {
    (f64::from(x) * f64::from(x) + f64::from(y) * f64::from(y)).sqrt() as f32
}

/// The projection of a point into a reference.
#[derive(Debug, Clone, Copy)]
pub struct Observation {
    /// Position of the projection, full-size pixels.
    position: [f32; 2],
    per_z: f32,
    /// Derivative of the position with respect to inverse depth, pixels metre.
    motion: [f32; 2],
    /// Squared length of `motion`.
    pub squared_speed: f32,
}

/// The projection of a point into a reference, with its derivatives.
pub struct PatchObservation {
    /// Position of the projection, full-size pixels.
    pub position: [f32; 2],
    /// Derivative of the position per pixel to the right in the current frame.
    pub along_u: [f32; 2],
    /// Derivative of the position per pixel down in the current frame.
    pub along_v: [f32; 2],
    /// Derivative of the position with respect to inverse depth, pixels metre.
    pub motion: [f32; 2],
    /// Length of `motion`, pixels metre.
    pub speed: f32,
}

/// Rounds to the nearest integer so that the loop can be vectorised: adding 1.5 * 2^23 leaves the integer in the mantissa.
/// Correct up to 2^22; beyond that the result is a position outside of any image.
pub fn nearest(x: f32) -> i32 {
    const MAGIC: f32 = 12_582_912.0;
    (x + MAGIC).to_bits().wrapping_sub(MAGIC.to_bits()) as i32
}

/// Fills `volume` (rows x columns of cells x planes) with the fused cost of up to [`MAX_REFERENCES`], and `unseen` (rows x
/// columns) with the number of far hypotheses that no reference sees.
pub fn sweep(
    image: &CensusImage,
    references: &[Option<Reference<'_>>],
    inverse_depth: &[f32; PLANES],
    volume: &mut [[u8; PLANES]],
    unseen: &mut [u8],
) {
    let columns = image.width / CELL;
    let lines =
        volume.par_chunks_exact_mut(columns).zip(unseen.par_chunks_exact_mut(columns)).enumerate();
    lines.for_each(|(row, (line, unseen))| {
        sweep_row(image, references, inverse_depth, row, line, unseen);
    });
}

#[multiversion(targets("x86_64+avx2+bmi1+bmi2+popcnt"))]
fn sweep_row<'a>(
    image: &CensusImage,
    references: &[Option<Reference<'a>>],
    inverse_depth: &[f32; PLANES],
    row: usize,
    line: &mut [[u8; PLANES]],
    unseen: &mut [u8],
) {
    let mut each = [[OUTSIDE; PLANES]; MAX_REFERENCES];
    for (column, (out, unseen)) in line.iter_mut().zip(unseen).enumerate() {
        let first = CELL * row * image.width + CELL * column;
        let descriptors = TAPS.map(|(dx, dy)| image.descriptors[first + dy * image.width + dx]);
        let u = (CELL * column) as f32;
        let v = (CELL * row) as f32;
        for (reference, bits) in references.iter().flatten().zip(&mut each) {
            reference.match_cell(u, v, &descriptors, inverse_depth, bits);
        }
        *unseen = fuse(&each, out);
    }
}

/// Mean over the references that see a hypothesis, without the worst of three, in which the point may be hidden. Hypotheses
/// that no reference sees get the mean cost of those that at least one does: on a plain wall, where every hypothesis matches,
/// any other cost would favour or exclude them. Returns how many of the [`FAR`] hypotheses no reference sees.
#[inline(always)]
fn fuse(each: &[[u8; PLANES]; MAX_REFERENCES], out: &mut [u8; PLANES]) -> u8 {
    let mut unseen = 0_u8;
    let mut seen = 0_u16;
    let mut total = 0_u16;
    for (plane, out) in out.iter_mut().enumerate() {
        let mut sum = 0_u8;
        let mut count = 0_u8;
        let mut worst = 0_u8;
        for bits in each {
            let seen = bits[plane] != OUTSIDE;
            let bits = if seen { bits[plane] } else { 0 };
            sum = sum.wrapping_add(bits);
            worst = worst.max(bits);
            count = count.wrapping_add(u8::from(seen));
        }
        // The sum is at most 96, so nothing here overflows: wrapping operations keep builds with overflow checks
        // vectorised.
        let kept = if count == 3 { sum.wrapping_sub(worst) } else { sum };
        let cost = if count == 1 { kept << 1 } else { kept };
        *out = if count == 0 { OUTSIDE } else { cost };
        unseen = unseen.wrapping_add(u8::from(count == 0 && plane < FAR));
        total = total.wrapping_add(u16::from(cost));
        seen = seen.wrapping_add(u16::from(count > 0));
    }
    let neutral = (total / seen.max(1)) as u8;
    for cost in out.iter_mut() {
        *cost = if *cost == OUTSIDE { neutral } else { *cost };
    }
    unseen
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
    fn positions_are_rounded_and_far_outside_stays_outside() {
        for (x, want) in [(0.4, 0), (0.6, 1), (-0.4, 0), (-0.6, -1), (639.2, 639)] {
            assert_eq!(nearest(x), want);
        }
        for x in [1e7, 1e12, f32::MAX, f32::INFINITY, -1e7, -1e30, f32::NEG_INFINITY] {
            assert!(!(0..16384).contains(&nearest(x)), "{x}");
        }
    }

    #[test]
    fn the_worst_of_three_is_left_out_and_an_unseen_hypothesis_is_neutral() {
        let mut out = [0; PLANES];
        fuse(&[[4; PLANES], [6; PLANES], [24; PLANES]], &mut out);
        assert_eq!(out[0], 10);
        fuse(&[[4; PLANES], [6; PLANES], [OUTSIDE; PLANES]], &mut out);
        assert_eq!(out[0], 10);
        fuse(&[[4; PLANES], [OUTSIDE; PLANES], [OUTSIDE; PLANES]], &mut out);
        assert_eq!(out[0], 8);
        assert_eq!(fuse(&[[OUTSIDE; PLANES]; 3], &mut out), FAR as u8);
        assert_eq!(out, [0; PLANES]);
        let mut half_seen = [4; PLANES];
        half_seen[FAR..].fill(OUTSIDE);
        half_seen[0] = 20;
        assert_eq!(fuse(&[half_seen, [OUTSIDE; PLANES], [OUTSIDE; PLANES]], &mut out), 0);
        assert_eq!((out[0], out[1], out[FAR]), (40, 8, 10));
    }

    #[test]
    fn parallax_is_f_b_over_z() {
        let mut census = CensusImage::default();
        census.width = 640;
        census.height = 192;
        let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
        let reference = Reference::new(&census, &Pose3::translation(0.1, 0.0, 0.0), &camera);
        assert!(
            (reference.parallax_px(300.0, 90.0, 0.5).unwrap() - 320.0 * 0.1 * 0.5).abs() < 1e-3
        );
        assert_eq!(reference.parallax_px(639.0, 90.0, 0.5), None);
    }
}
