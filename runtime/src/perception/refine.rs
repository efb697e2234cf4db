//! Corrects the rotation between two pictures by looking at them.
//!
//! Odometry and hand-held tracking know a turn to a few milliradians at best, a rolling shutter bends it further, and a
//! milliradian is as much as several centimetres of parallax far away. A wrong rotation moves matches off their epipolar
//! lines; the distances of a few dozen corners from their lines give the rotation by robust least squares, whatever the
//! depth of each corner. What moves matches *along* their lines looks like depth and is left to the pose.

use hal::{CameraModel, Pose3};
use multiversion::multiversion;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::census::{CensusImage, NOWHERE};

/// One corner is looked for in every cell of this size, full-size pixels.
const CELL: usize = 32;
/// Places that are tried in a cell, full-size pixels apart.
const GRID: usize = 8;
/// Corners keep this distance from the edge: half of a patch.
const MARGIN: usize = 8;
/// Least strength of a corner (smaller eigenvalue of the structure tensor over 5x5 samples), grey levels squared.
const CORNER: f32 = 400.0;
/// Matches are looked for up to this far from their line, full-size pixels: 15 mrad at f = 520.
const REACH_PX: i32 = 8;
/// Step along the line, full-size pixels.
const STEP_PX: f64 = 2.0;
/// Whole distances from a line that are looked at.
const DISTANCES: usize = 2 * REACH_PX as usize + 1;
/// Nearest depth of a match, metres: the last metre has long lines and few corners.
const NEAR_M: f64 = 1.0;
/// Descriptors of a patch, which has its middle at (6, 6).
const PATCH: [(usize, usize); 5] = [(0, 0), (12, 0), (6, 6), (0, 12), (12, 12)];
/// A match may differ in so many of its 120 bits, and must beat matches at other distances from the line by as many.
const MAX_BITS: u32 = 39;
const CLEAR_BITS: u32 = 8;
/// Fewer corners than this say nothing.
const MIN_CORNERS: usize = 8;
/// Weight of staying in place along the lines, against 1 for each corner's distance from its line.
const ALONG: f64 = 0.3;

/// Corners of a picture, as full-size positions.
#[derive(Debug, Default)]
pub struct Corners {
    /// The strongest of every cell, if it has one.
    cells: Vec<Option<(usize, usize)>>,
    points: Vec<(usize, usize)>,
    residuals: Vec<Option<Residual>>,
}

impl Corners {
    /// The strongest corner of every cell that has one.
    pub fn find(&mut self, picture: &CensusImage) {
        let cells_within = |size: usize| size.saturating_sub(2 * MARGIN).div_ceil(CELL);
        let (columns, rows) = (cells_within(picture.width), cells_within(picture.height));
        let strongest = |cell: usize| strongest(picture, cell % columns, cell / columns);
        (0..columns * rows)
            .into_par_iter()
            .with_min_len(columns)
            .map(strongest)
            .collect_into_vec(&mut self.cells);
        self.points.clear();
        self.points.extend(self.cells.iter().flatten());
    }
}

fn strongest(picture: &CensusImage, column: usize, row: usize) -> Option<(usize, usize)> {
    let places = |cell: usize, size: usize| {
        let first = MARGIN + cell * CELL;
        (first..(first + CELL).min(size - MARGIN)).step_by(GRID)
    };
    let mut best = (CORNER, None);
    for y in places(row, picture.height) {
        for x in places(column, picture.width) {
            let strength = strength(picture, x, y);
            if strength > best.0 {
                best = (strength, Some((x, y)));
            }
        }
    }
    best.1
}

fn strength(picture: &CensusImage, x: usize, y: usize) -> f32 {
    let grey = |x: usize, y: usize| f32::from(picture.smooth[y * picture.width + x]) / 256.0;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for v in (y - 4..=y + 4).step_by(2) {
        for u in (x - 4..=x + 4).step_by(2) {
            let (gx, gy) = (grey(u + 2, v) - grey(u - 2, v), grey(u, v + 2) - grey(u, v - 2));
            (xx, xy, yy) = (xx + gx * gx, xy + gx * gy, yy + gy * gy);
        }
    }
    (xx + yy) / 2.0 - ((xx - yy) * (xx - yy) / 4.0 + xy * xy).sqrt()
}

/// How a corner's match answers to a small rotation of the reference, and how far off its line it was found.
#[derive(Debug)]
struct Residual {
    /// d(distance from the line) / d(rotation), pixels per radian.
    across: Vector3<f64>,
    /// d(place along the line) / d(rotation), pixels per radian.
    along: Vector3<f64>,
    off_px: f64,
}

/// `t_reference_camera` with its rotation corrected. `camera` describes the positions of descriptors.
pub fn refine_rotation(
    picture: &CensusImage,
    corners: &mut Corners,
    reference: &CensusImage,
    t_reference_camera: &Pose3,
    camera: &CameraModel,
) -> Pose3 {
    let Corners { points, residuals, .. } = corners;
    let residual =
        |corner: &(usize, usize)| residual(picture, *corner, reference, t_reference_camera, camera);
    points.par_iter().map(residual).collect_into_vec(residuals);
    // How far off the pose's rotation may be: tracking jitter, and a share of the turn for timing and shutter.
    let sigma_rad = 0.002 + 0.05 * t_reference_camera.rotation.angle();
    let turn = UnitQuaternion::from_scaled_axis(solve(residuals, sigma_rad));
    Pose3::from_parts(t_reference_camera.translation, turn * t_reference_camera.rotation)
}

#[multiversion(targets("x86_64+avx2+popcnt"))]
fn residual(
    picture: &CensusImage,
    (x, y): (usize, usize),
    reference: &CensusImage,
    t_reference_camera: &Pose3,
    camera: &CameraModel,
) -> Option<Residual> {
    let far = t_reference_camera.rotation * camera.ray(x as f64, y as f64);
    let point = |w: f64| far + t_reference_camera.translation.vector * w;
    let place = |w: f64| camera.project(&point(w).into());
    let (begin, end) = (place(0.0)?, place(1.0 / NEAR_M)?);
    let (dx, dy) = (end.0 - begin.0, end.1 - begin.1);
    let length = dx.hypot(dy);
    // A line shorter than that has no direction.
    if length < 4.0 {
        return None;
    }
    let (dx, dy) = (dx / length, dy / length);
    let patch = Patch::new(picture, (x, y), reference);
    // Best cost for every distance from the line, and the inverse depth where it was found.
    let mut best = [(u32::MAX, 0.0); DISTANCES];
    let steps = ((length / STEP_PX) as usize).clamp(2, 64);
    for step in 0..=steps {
        let w = step as f64 / steps as f64 / NEAR_M;
        let Some(middle) = place(w) else { continue };
        for (best, cost) in best.iter_mut().zip(patch.costs_across(middle, (-dy, dx))) {
            if cost < best.0 {
                *best = (cost, w);
            }
        }
    }
    let winner = (0..best.len()).min_by_key(|index| best[*index].0)?;
    let (cost, w) = best[winner];
    // A point on a straight edge fits everywhere along it and must not vote.
    let rival =
        best.iter().enumerate().filter(|(i, _)| i.abs_diff(winner) > 2).map(|(_, b)| b.0).min()?;
    if cost > MAX_BITS || rival < cost + CLEAR_BITS || winner == 0 || winner == best.len() - 1 {
        return None;
    }
    let p = point(w);
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

/// The descriptors around a corner, and the picture that they are looked for in.
struct Patch<'a> {
    descriptors: [u32; PATCH.len()],
    /// From the first descriptor of a patch in the reference to every one.
    offsets: [usize; PATCH.len()],
    reference: &'a CensusImage,
}

impl<'a> Patch<'a> {
    #[inline(always)]
    fn new(picture: &CensusImage, (x, y): (usize, usize), reference: &'a CensusImage) -> Self {
        let here = (y - 6) * picture.width + x - 6;
        let descriptors = PATCH.map(|(dx, dy)| picture.descriptors[here + dy * picture.width + dx]);
        Self { descriptors, offsets: PATCH.map(|(dx, dy)| dy * reference.width + dx), reference }
    }

    /// Differing bits with the patches at every whole distance of up to [`REACH_PX`] from `middle` in `direction`; `u32::MAX`
    /// too near to the edge.
    #[inline(always)]
    fn costs_across(&self, middle: (f64, f64), direction: (f64, f64)) -> [u32; DISTANCES] {
        let (width, margin) = (self.reference.width as i32, MARGIN as i32);
        let (right, bottom) = (width - margin, self.reference.height as i32 - margin);
        let mut places = [NOWHERE; DISTANCES];
        for (index, place) in places.iter_mut().enumerate() {
            let off = index as f64 - f64::from(REACH_PX);
            let (u, v) = (whole(middle.0 + off * direction.0), whole(middle.1 + off * direction.1));
            let inside = (u >= margin) & (v >= margin) & (u < right) & (v < bottom);
            let first = (v - 6).wrapping_mul(width).wrapping_add(u - 6);
            *place = if inside { first as u32 } else { NOWHERE };
        }
        // A loop: what is given to `map` would be compiled without the vector unit.
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

/// Rounds what is not negative to the nearest integer without leaving the vector unit: adding 1.5 * 2^52 leaves the integer
/// in the mantissa.
#[inline(always)]
fn whole(x: f64) -> i32 {
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    ((x + 0.5).clamp(-1.0, 1e6).floor() + MAGIC).to_bits() as i32
}

/// The rotation vector that explains the distances: iteratively reweighted least squares (Geman-McClure, its scale
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

    /// Residuals of corners all over a picture for a true rotation, seen by a camera that moved along `direction`.
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
            let (dx, dy) = (du.dot(&direction), dv.dot(&direction));
            let (dx, dy) = (dx / dx.hypot(dy), dy / dx.hypot(dy));
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
    fn what_looks_like_depth_is_left_alone() {
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
