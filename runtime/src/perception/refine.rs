//! Corrects the rotation between two frames from image matches.
//!
//! Odometry and hand-held tracking measure a rotation to a few milliradians at best, a rolling shutter adds to the error, and
//! far away a milliradian is as much as the parallax of several centimetres. A wrong rotation moves matches off their
//! epipolar lines; the distances of a few dozen corners from their lines give the rotation by robust least squares, whatever
//! the depth of each corner. A rotation that moves matches *along* their lines looks like depth and is left as the pose has
//! it.

use hal::{CameraModel, Pose3};
use multiversion::multiversion;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::census::{CensusImage, NOWHERE};

/// One corner is selected in every cell of this size, full-size pixels.
const CELL: usize = 32;
/// Spacing of the corner candidates in a cell, full-size pixels.
const GRID: usize = 8;
/// Minimum distance of a corner from the edge, half of a patch, full-size pixels.
const MARGIN: usize = 8;
/// Minimum strength of a corner (smaller eigenvalue of the structure tensor over 5x5 samples), grey levels squared.
const CORNER: f32 = 400.0;
/// Maximum distance of a match from its line, full-size pixels: 15 mrad at f = 520.
const REACH_PX: i32 = 8;
/// Step along the line, full-size pixels.
const STEP_PX: f64 = 2.0;
/// Number of whole-pixel distances from a line that are compared.
const DISTANCES: usize = 2 * REACH_PX as usize + 1;
/// Minimum depth of a match, metres: below a metre, lines are long and corners are few.
const NEAR_M: f64 = 1.0;
/// Positions of the descriptors of a patch, whose middle is at (6, 6).
const PATCH: [(usize, usize); 5] = [(0, 0), (12, 0), (6, 6), (0, 12), (12, 12)];
/// Maximum number of differing bits of a match, of 120.
const MAX_BITS: u32 = 39;
/// Minimum difference in bits from matches at other distances from the line.
const CLEAR_BITS: u32 = 8;
/// With fewer corners than this, the rotation is not corrected.
const MIN_CORNERS: usize = 8;
/// Weight of keeping the position along the lines, against 1 for each corner's distance from its line.
const ALONG: f64 = 0.3;

/// Corners of a frame, as full-size positions.
#[derive(Debug, Default)]
pub struct Corners {
    /// The strongest corner of every cell.
    cells: Vec<Option<(usize, usize)>>,
    points: Vec<(usize, usize)>,
    residuals: Vec<Option<Residual>>,
}

impl Corners {
    /// The strongest corner of every cell that has one.
    pub fn find(&mut self, image: &CensusImage) {
        let columns = cells_along(image.width);
        let rows = cells_along(image.height);
        (0..columns * rows)
            .into_par_iter()
            .with_min_len(columns)
            .map(|cell| strongest(image, cell % columns, cell / columns))
            .collect_into_vec(&mut self.cells);
        self.points.clear();
        self.points.extend(self.cells.iter().flatten());
    }
}

/// Number of cells along a side of `size` pixels.
fn cells_along(size: usize) -> usize {
    size.saturating_sub(2 * MARGIN).div_ceil(CELL)
}

/// Positions of the corner candidates of a cell along one axis.
fn candidates(cell: usize, size: usize) -> impl Iterator<Item = usize> {
    let first = MARGIN + cell * CELL;
    (first..(first + CELL).min(size - MARGIN)).step_by(GRID)
}

fn strongest(image: &CensusImage, column: usize, row: usize) -> Option<(usize, usize)> {
    let mut best = (CORNER, None);
    for y in candidates(row, image.height) {
        for x in candidates(column, image.width) {
            let strength = strength(image, x, y);
            if strength > best.0 {
                best = (strength, Some((x, y)));
            }
        }
    }
    best.1
}

fn strength(image: &CensusImage, x: usize, y: usize) -> f32 {
    let mut xx = 0.0;
    let mut xy = 0.0;
    let mut yy = 0.0;
    for v in (y - 4..=y + 4).step_by(2) {
        for u in (x - 4..=x + 4).step_by(2) {
            let gx = grey(image, u + 2, v) - grey(image, u - 2, v);
            let gy = grey(image, u, v + 2) - grey(image, u, v - 2);
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
        }
    }
    (xx + yy) / 2.0 - ((xx - yy) * (xx - yy) / 4.0 + xy * xy).sqrt()
}

fn grey(image: &CensusImage, x: usize, y: usize) -> f32 {
    f32::from(image.smooth[y * image.width + x]) / 256.0
}

/// The distance of a corner's match from its epipolar line, with derivatives with respect to a small rotation of the reference.
#[derive(Debug)]
struct Residual {
    /// d(distance from the line) / d(rotation), pixels per radian.
    across: Vector3<f64>,
    /// d(position along the line) / d(rotation), pixels per radian.
    along: Vector3<f64>,
    off_px: f64,
}

/// `t_reference_camera` with its rotation corrected. `camera` has its pixels at the positions of the descriptors.
pub fn refine_rotation(
    image: &CensusImage,
    corners: &mut Corners,
    reference: &CensusImage,
    t_reference_camera: &Pose3,
    camera: &CameraModel,
) -> Pose3 {
    let Corners { points, residuals, .. } = corners;
    points
        .par_iter()
        .map(|corner| residual(image, *corner, reference, t_reference_camera, camera))
        .collect_into_vec(residuals);
    // Expected error of the pose's rotation: tracking jitter, and a share of the rotation for timing and shutter.
    let sigma_rad = 0.002 + 0.05 * t_reference_camera.rotation.angle();
    let correction = UnitQuaternion::from_scaled_axis(solve(residuals, sigma_rad));
    Pose3::from_parts(t_reference_camera.translation, correction * t_reference_camera.rotation)
}

#[multiversion(targets("x86_64+avx2+popcnt"))]
fn residual(
    image: &CensusImage,
    (x, y): (usize, usize),
    reference: &CensusImage,
    t_reference_camera: &Pose3,
    camera: &CameraModel,
) -> Option<Residual> {
    let far = t_reference_camera.rotation * camera.ray(x as f64, y as f64);
    let baseline = t_reference_camera.translation.vector;
    // The match of a point with inverse depth w is where `far + w baseline` is projected.
    let begin = camera.project(&far.into())?;
    let end = camera.project(&(far + baseline * (1.0 / NEAR_M)).into())?;
    let dx = end.0 - begin.0;
    let dy = end.1 - begin.1;
    let length = dx.hypot(dy);
    // The direction of a shorter line is unreliable.
    if length < 4.0 {
        return None;
    }
    let dx = dx / length;
    let dy = dy / length;
    let patch = Patch::new(image, (x, y), reference);
    // The lowest cost at every distance from the line, and the inverse depth at which it occurs.
    let mut best = [(u32::MAX, 0.0); DISTANCES];
    let steps = ((length / STEP_PX) as usize).clamp(2, 64);
    for step in 0..=steps {
        let w = step as f64 / steps as f64 / NEAR_M;
        let Some(middle) = camera.project(&(far + baseline * w).into()) else { continue };
        for (best, cost) in best.iter_mut().zip(patch.costs_across(middle, (-dy, dx))) {
            if cost < best.0 {
                *best = (cost, w);
            }
        }
    }
    let winner = (0..best.len()).min_by_key(|index| best[*index].0)?;
    let (cost, w) = best[winner];
    // A point on a straight edge matches everywhere along the edge and must not be used.
    let rival =
        best.iter().enumerate().filter(|(i, _)| i.abs_diff(winner) > 2).map(|(_, b)| b.0).min()?;
    if cost > MAX_BITS || rival < cost + CLEAR_BITS || winner == 0 || winner == best.len() - 1 {
        return None;
    }
    let p = far + baseline * w;
    // d(pixel) / d(rotation): the point moves by omega x far.
    let du = Vector3::new(camera.fx / p.z, 0.0, -camera.fx * p.x / (p.z * p.z));
    let dv = Vector3::new(0.0, camera.fy / p.z, -camera.fy * p.y / (p.z * p.z));
    let off_px = winner as f64 - f64::from(REACH_PX);
    Some(Residual {
        across: far.cross(&(dv * dx - du * dy)),
        along: far.cross(&(du * dx + dv * dy)),
        off_px,
    })
}

/// The descriptors around a corner, and the reference in which they are searched.
struct Patch<'a> {
    descriptors: [u32; PATCH.len()],
    /// Index offset of every descriptor from the first one, in the reference.
    offsets: [usize; PATCH.len()],
    reference: &'a CensusImage,
}

impl<'a> Patch<'a> {
    #[inline(always)]
    fn new(image: &CensusImage, (x, y): (usize, usize), reference: &'a CensusImage) -> Self {
        let here = (y - 6) * image.width + x - 6;
        let descriptors = PATCH.map(|(dx, dy)| image.descriptors[here + dy * image.width + dx]);
        Self { descriptors, offsets: PATCH.map(|(dx, dy)| dy * reference.width + dx), reference }
    }

    /// Number of differing bits at every whole-pixel distance of up to [`REACH_PX`] from `middle` along `direction`;
    /// `u32::MAX` too near to the edge.
    #[inline(always)]
    fn costs_across(&self, middle: (f64, f64), direction: (f64, f64)) -> [u32; DISTANCES] {
        let width = self.reference.width as i32;
        let margin = MARGIN as i32;
        let right = width - margin;
        let bottom = self.reference.height as i32 - margin;
        let mut places = [NOWHERE; DISTANCES];
        for (index, place) in places.iter_mut().enumerate() {
            let off = index as f64 - f64::from(REACH_PX);
            let u = round_to_pixel(middle.0 + off * direction.0);
            let v = round_to_pixel(middle.1 + off * direction.1);
            let inside = (u >= margin) & (v >= margin) & (u < right) & (v < bottom);
            let first = (v - 6).wrapping_mul(width).wrapping_add(u - 6);
            *place = if inside { first as u32 } else { NOWHERE };
        }
        // A loop, because a closure given to `map` would be compiled without AVX2.
        let mut costs = [u32::MAX; DISTANCES];
        for (cost, place) in costs.iter_mut().zip(places) {
            *cost = self.cost_at(place).unwrap_or(u32::MAX);
        }
        costs
    }

    #[inline(always)]
    fn cost_at(&self, place: u32) -> Option<u32> {
        let there = self.reference.descriptors.get(place as usize..)?;
        let mut bits = 0;
        for (descriptor, offset) in self.descriptors.iter().zip(&self.offsets) {
            bits += (descriptor ^ there.get(*offset)?).count_ones();
        }
        Some(bits)
    }
}

/// Rounds a non-negative number to the nearest integer so that the loop can be vectorised: adding 1.5 * 2^52 leaves the
/// integer in the mantissa.
#[inline(always)]
fn round_to_pixel(x: f64) -> i32 {
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    ((x + 0.5).clamp(-1.0, 1e6).floor() + MAGIC).to_bits() as i32
}

/// The rotation vector that fits the distances best: iteratively reweighted least squares (Geman-McClure, its scale
/// shrinking from the search range to one pixel) with the pose as prior.
fn solve(residuals: &[Option<Residual>], sigma_rad: f64) -> Vector3<f64> {
    let mut omega = Vector3::zeros();
    if residuals.iter().flatten().count() < MIN_CORNERS {
        return omega;
    }
    for scale_px in [6.0, 4.0, 3.0, 2.0, 1.5, 1.0, 1.0, 1.0] {
        let mut normal = Matrix3::identity() / (sigma_rad * sigma_rad);
        let mut right = Vector3::zeros();
        for Residual { across, along, off_px } in residuals.iter().flatten() {
            let error = (off_px - across.dot(&omega)) / scale_px;
            let weight = (1.0 + error * error).powi(-2);
            normal += weight * across * across.transpose() + ALONG * along * along.transpose();
            right += weight * across * *off_px;
        }
        let Some(cholesky) = normal.cholesky() else { return Vector3::zeros() };
        omega = cholesky.solve(&right);
    }
    omega
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals of corners all over an image for a true rotation, seen by a camera that moved along `direction`.
    fn residuals(
        direction: Vector3<f64>,
        truth: Vector3<f64>,
        outliers: usize,
    ) -> Vec<Option<Residual>> {
        let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
        let mut all = Vec::new();
        for index in 0..60_usize {
            let far = camera.ray((index * 97 % 640) as f64, (index * 53 % 192) as f64);
            let p = far + direction * 0.05;
            let du = Vector3::new(camera.fx / p.z, 0.0, -camera.fx * p.x / (p.z * p.z));
            let dv = Vector3::new(0.0, camera.fy / p.z, -camera.fy * p.y / (p.z * p.z));
            let dx = du.dot(&direction);
            let dy = dv.dot(&direction);
            let length = dx.hypot(dy);
            let dx = dx / length;
            let dy = dy / length;
            let across = far.cross(&(dv * dx - du * dy));
            let off_px = if index < outliers { 7.0 } else { across.dot(&truth) };
            all.push(Some(Residual { across, along: far.cross(&(du * dx + dv * dy)), off_px }));
        }
        all
    }

    #[test]
    fn pitch_and_roll_of_a_sideways_motion_are_found_despite_outliers() {
        let truth = Vector3::new(0.006, 0.0, -0.004);
        let omega = solve(&residuals(Vector3::x(), truth, 12), 0.01);
        assert!((omega - truth).norm() < 0.001, "{omega}");
    }

    #[test]
    fn a_rotation_that_looks_like_depth_is_not_corrected() {
        // Yaw moves everything along the lines of a sideways motion.
        let omega = solve(&residuals(Vector3::x(), Vector3::new(0.0, 0.01, 0.0), 0), 0.01);
        assert!(omega.y.abs() < 0.003, "{omega}");
    }

    #[test]
    fn few_corners_change_nothing() {
        let mut few = residuals(Vector3::z(), Vector3::new(0.01, 0.0, 0.0), 0);
        few.truncate(MIN_CORNERS - 1);
        assert_eq!(solve(&few, 0.01), Vector3::zeros());
    }
}
