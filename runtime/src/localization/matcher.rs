//! Point-to-line matching of a scan against surfels, with a prior: Gauss-Newton in three degrees of freedom.
//!
//! The residual of a stretch at `p` in the robot's frame is `n . (R p + t - m)`, with the surfel's normal `n` and middle `m`.
//! Poses change by `(dx, dy)` in the map's axes and by `dyaw` about the robot, so the Jacobian is `[nx, ny, n . R' p]`. The
//! kernel is Geman-McClure; its width begins with what the prior allows for and shrinks to what scans of one place differ by
//! (graduated non-convexity; the threshold that adapts is the idea of KISS-ICP, Vizzo et al. 2023).

use hal::{Pose2, wrap_angle};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::scan_points::Stretch;
use super::surfel_grid::SurfelGrid;

/// Residuals are trusted up to this width at the end, metres: three times the noise of a stretch.
const FINAL_WIDTH_M: f64 = 0.04;
/// Widths at which the coarse grid finds partners and the fine grid does not.
const COARSE_WIDTH_M: f64 = 0.12;
/// The width shrinks by this factor each iteration.
const SHRINK: f64 = 0.5;
/// An alignment that has not come to rest after these iterations is taken as it is.
const MAX_ITERATIONS: usize = 12;
/// Changes smaller than this end the iterations: a tenth of a millimetre and of a milliradian.
const AT_REST: f64 = 1e-4;

/// How well a scan fits.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ScanFit {
    /// Stretches of surface that the scan was made into.
    pub stretches: u32,
    /// Share of them that are near known surfaces, and not on new ground, 0 to 1.
    pub overlap: f32,
    /// Share of those that lie on the known surfaces, 0 to 1.
    pub inliers: f32,
    /// Root mean square distance of those to their surfaces, metres.
    pub rms_m: f32,
}

impl ScanFit {
    /// Share of all stretches with a direction that lie on known surfaces.
    #[must_use]
    pub fn share(&self) -> f32 {
        self.overlap * self.inliers
    }
}

/// A scan's pose and what the scan alone says about it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Alignment {
    pub pose: Pose2,
    /// Inverse covariance of the pose by the scan alone, without the prior: x, y in the map's axes, yaw.
    pub information: Matrix3<f64>,
    pub fit: ScanFit,
}

/// A predicted pose with its inverse covariance (x, y in the map's axes, yaw).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prior {
    pub pose: Pose2,
    pub information: Matrix3<f64>,
    /// Standard deviation of a point's position that the prior leaves, metres: the first width of the kernel.
    pub width_m: f64,
}

/// The surfaces to match against, in two resolutions.
pub(crate) struct Surfaces {
    pub fine: SurfelGrid,
    pub coarse: SurfelGrid,
}

impl Surfaces {
    pub(crate) fn new() -> Self {
        Self { fine: SurfelGrid::new(0.1), coarse: SurfelGrid::new(0.4) }
    }

    pub(crate) fn clear(&mut self, origin: [f64; 2]) {
        self.fine.clear(origin);
        self.coarse.clear(origin);
    }

    pub(crate) fn insert(&mut self, stretches: &[Stretch], pose: &Pose2) {
        self.fine.insert(stretches, pose);
        self.coarse.insert(stretches, pose);
    }
}

/// Normal equations of one iteration.
#[derive(Default)]
struct Equations {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// Sums over inliers.
    count: f64,
    squares: f64,
    weighted_squares: f64,
    weights: f64,
}

/// Aligns `stretches` with `surfaces`, starting at the prior. `None` if the equations have no solution.
pub(crate) fn align(
    surfaces: &Surfaces,
    stretches: &[Stretch],
    prior: &Prior,
) -> Option<Alignment> {
    let mut pose = prior.pose;
    let mut width_m = prior.width_m.clamp(FINAL_WIDTH_M, 0.5);
    let mut equations = Equations::default();
    for _ in 0..MAX_ITERATIONS {
        let grid = if width_m > COARSE_WIDTH_M { &surfaces.coarse } else { &surfaces.fine };
        equations = equations_at(grid, stretches, &pose, width_m);
        let off = Vector3::new(
            pose.x_m - prior.pose.x_m,
            pose.y_m - prior.pose.y_m,
            wrap_angle(pose.yaw_rad - prior.pose.yaw_rad),
        );
        let hessian = equations.hessian + prior.information;
        let gradient = equations.gradient + prior.information * off;
        let step = -hessian.cholesky()?.solve(&gradient);
        pose = Pose2::new(pose.x_m + step.x, pose.y_m + step.y, pose.yaw_rad + step.z);
        if !pose.is_finite() {
            return None;
        }
        if width_m <= FINAL_WIDTH_M && step.amax() < AT_REST {
            break;
        }
        width_m = (width_m * SHRINK).max(FINAL_WIDTH_M);
    }
    let known = known(&surfaces.coarse, stretches, &pose);
    Some(equations.into_alignment(pose, known, stretches))
}

/// Stretches that have a surface of their direction in the coarse grid.
fn known(grid: &SurfelGrid, stretches: &[Stretch], pose: &Pose2) -> usize {
    let [x, y, sin, cos] = grid.relative(pose);
    stretches
        .iter()
        .filter(|stretch| stretch.has_normal())
        .filter(|stretch| grid.nearest(&stretch.moved(x, y, sin, cos)).is_some())
        .count()
}

fn equations_at(grid: &SurfelGrid, stretches: &[Stretch], pose: &Pose2, width_m: f64) -> Equations {
    let [x, y, sin, cos] = grid.relative(pose);
    let width_squared = (width_m * width_m) as f32;
    let mut equations = Equations::default();
    for stretch in stretches.iter().filter(|stretch| stretch.has_normal()) {
        let there = stretch.moved(x, y, sin, cos);
        let Some(surfel) = grid.nearest(&there) else { continue };
        let residual = surfel.nx * (there.x - surfel.x) + surfel.ny * (there.y - surfel.y);
        let square = residual * residual;
        if square > 9.0 * width_squared {
            continue;
        }
        let kernel = width_squared / (width_squared + square);
        // The surfel's own uncertainty counts too: a new surfel is as uncertain as the stretch.
        let precision = stretch.weight * surfel.weight / (stretch.weight + surfel.weight);
        let weight = f64::from(kernel * kernel * precision);
        let (rx, ry) = (there.x - x, there.y - y);
        let jacobian = Vector3::new(
            f64::from(surfel.nx),
            f64::from(surfel.ny),
            f64::from(surfel.ny * rx - surfel.nx * ry),
        );
        equations.add(&jacobian, f64::from(residual), weight, f64::from(precision));
    }
    equations
}

impl Equations {
    #[inline]
    fn add(&mut self, jacobian: &Vector3<f64>, residual: f64, weight: f64, precision: f64) {
        let weighted = jacobian * weight;
        self.hessian += weighted * jacobian.transpose();
        self.gradient += weighted * residual;
        if residual.abs() < 2.0 * FINAL_WIDTH_M {
            self.count += 1.0;
            self.squares += residual * residual;
        }
        self.weighted_squares += weight * residual * residual;
        self.weights += weight / precision;
    }

    fn into_alignment(self, pose: Pose2, known: usize, stretches: &[Stretch]) -> Alignment {
        // Residuals that are larger than their weights say make the result that much less certain.
        let excess = (self.weighted_squares / self.weights.max(1.0)).max(1.0);
        let with_normal = stretches.iter().filter(|stretch| stretch.has_normal()).count();
        let fit = ScanFit {
            stretches: u32::try_from(stretches.len()).unwrap_or(u32::MAX),
            overlap: known as f32 / with_normal.max(1) as f32,
            inliers: (self.count / known.max(1) as f64).min(1.0) as f32,
            rms_m: (self.squares / self.count.max(1.0)).sqrt() as f32,
        };
        Alignment { pose, information: self.hessian / (excess * CORRELATION), fit }
    }
}

/// Errors of neighbouring stretches are alike (they see the same unevenness, the same error of the map), so a scan
/// counts as a quarter of its stretches.
const CORRELATION: f64 = 4.0;
