//! Filters the rotation of the camera's poses.
//!
//! Odometry and tracking jitter: a milliradian from frame to frame is a third of a pixel at f = 320, as much parallax as ten
//! centimetres of depth have at five metres. From one frame to the next, image motion depends little on depth, so flow and
//! believed depth measure the rotation between two frames far better; for points of unknown depth, the distance from the
//! epipolar line still does. But such rotations accumulate to drift, which odometry corrects. The weight of odometry follows
//! from its jitter: without any jitter, its rotation is taken unchanged.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix2, Matrix2x3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::belief::Belief;
use super::census::CensusImage;
use super::flow::FlowField;
use super::mount_equations::{Moved, mount_equations};
use crate::calibration_watch::Sums;
use crate::snapshot::remembers;

/// Unknowns: the rotation, the factor by which depth is wrong (in the middle of the image and its change towards the right
/// and the lower edge), and the error of the translation. Where believed depth is wrong, neighbouring depth is wrong in the
/// same way, and must not be mistaken for a rotation.
const UNKNOWNS: usize = 9;
/// Expected error of believed depth, as a factor.
const DEPTH_ERROR: f64 = 0.1;
/// Expected error of the translation between two frames, metres.
const STEP_ERROR_M: f64 = 0.003;
/// Expected error of the rotation between two frames, radians.
const ROTATION_ERROR_RAD: f64 = 0.005;
/// Expected error of the rotation between two frames, as a share of the rotation.
const ROTATION_ERROR: f64 = 0.05;
/// Expected error of flow, pixels; generous, because errors of neighbouring cells are correlated.
const FLOW_ERROR_PX: f64 = 2.0;
/// Expected error of a rotation that was estimated from flow, radians.
const ESTIMATE_ERROR_RAD: f64 = 0.0003;
/// Beliefs with a lower confidence count as unknown depth: the point may be anywhere on its epipolar line.
const LEAST_CONFIDENCE: f32 = 0.8;
/// Expected error of unknown depth, as a factor.
const UNKNOWN_DEPTH_ERROR: f64 = 1.0;
/// Every fourth cell of every fourth row is used.
const EVERY: usize = 4;
/// Minimum distance of a used cell from the image's edge, pixels.
const MARGIN: f64 = 8.0;
/// With fewer cells than this, flow is not used.
const LEAST_CELLS: usize = 25;
/// An image says something of the camera's mount only if this share of the cells has flow, and if the mean weight of their robust loss
/// is at least the next number: on a bare wall, the flow of many cells is wrong. In 300 s of the simulated hour of docs/calibration.md,
/// the pitch by a frame with a smaller weight had an error of 0.2 to 0.7 of the stated one, with a larger weight 0.04 to 0.1.
const LEAST_MOUNT_CELLS: f64 = 0.4;
const LEAST_AGREEMENT: f64 = 0.4;
/// Scale of the robust loss from one iteration to the next, pixels: it first includes far outliers.
const SCALES_PX: [f64; 4] = [4.0, 2.0, 1.0, 1.0];
/// Jitter that is assumed before it is measured, radians.
const FIRST_JITTER_RAD: f64 = 0.002;
/// Number of frames over which the mean square of the jitter is taken.
const JITTER_MEMORY: f64 = 20.0;

/// Filters the rotation of a camera's poses from frame to frame.
#[derive(Debug)]
pub struct RotationFilter {
    before: Option<Before>,
    /// Variance of the filtered rotation about each axis, rad^2.
    variance: Vector3<f64>,
    /// The last correction of the rotation between two frames, in the camera's axes.
    correction: Option<Vector3<f64>>,
    /// Mean square of the corrections about each axis, rad^2.
    mean_square: f64,
    /// Negated mean product of consecutive corrections about each axis, rad^2.
    reversal: f64,
    /// Number of frames in these means, at most [`JITTER_MEMORY`].
    frames: f64,
    equations: Vec<Equation>,
    /// The correction by flow in the last update.
    measured: Option<Correction>,
}

/// By how much a yaw between two frames is wrong, as image motion shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct YawError {
    /// The yaw of image motion less that of the poses, radians.
    pub rad: f64,
    /// Variance of `rad`, rad^2.
    pub variance_rad2: f64,
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Before {
    measured: Pose3,
    filtered: Pose3,
}

/// The believed depth of the previous frame.
#[derive(Debug, Clone, Copy)]
pub struct DepthPrior<'a> {
    /// One per cell, row-major.
    pub beliefs: &'a [Belief],
    /// One per cell, row-major.
    pub confidence: &'a [f32],
    /// The camera of the cells.
    pub cells: &'a CameraModel,
    /// Depth of cells without a belief, metres.
    pub scene_depth_m: f64,
}

/// The flow from a frame to the one before.
#[derive(Debug, Clone, Copy)]
pub struct FlowObservation<'a> {
    pub flow: &'a FlowField,
    pub image: &'a CensusImage,
    /// Has its pixels at the positions of `image`.
    pub camera: &'a CameraModel,
}

/// The correction of the rotation between two frames that follows from flow.
#[derive(Debug, Clone, Copy)]
struct Correction {
    /// Rotation vector in the camera's axes.
    rotation: Vector3<f64>,
    /// Variance about each axis, rad^2.
    variance: Vector3<f64>,
    /// What the same flow says of the camera's mount, if most of the image shows one motion.
    mount: Option<Sums<3>>,
}

/// The linearised reprojection error of one cell in the previous frame.
#[derive(Debug)]
struct Equation {
    /// Derivatives of the error with respect to the unknowns.
    jacobian: SMatrix<f64, 2, UNKNOWNS>,
    error_px: Vector2<f64>,
}

impl Default for RotationFilter {
    fn default() -> Self {
        Self {
            before: None,
            variance: Vector3::zeros(),
            correction: None,
            mean_square: 2.0 * FIRST_JITTER_RAD * FIRST_JITTER_RAD,
            reversal: FIRST_JITTER_RAD * FIRST_JITTER_RAD,
            frames: 1.0,
            equations: Vec::new(),
            measured: None,
        }
    }
}

impl RotationFilter {
    /// Standard deviation of the odometry's jitter about each axis, radians.
    pub fn jitter_rad(&self) -> f64 {
        self.jitter().sqrt()
    }

    /// Variance of the odometry's jitter about each axis, rad^2. With jitter alone, the reversal is half of the mean square.
    /// With errors of flow alone it is zero in the mean, and up to a fifth randomly: so a quarter of the mean square does not
    /// count.
    fn jitter(&self) -> f64 {
        (2.0 * (self.reversal - 0.25 * self.mean_square)).max(0.0)
    }

    /// What flow says of the rotation about `axis` (a unit vector in the camera's axes) since the previous frame, beside the
    /// measured poses. `None` where the last update did not use flow.
    pub fn error_about(&self, axis: &Vector3<f64>) -> Option<YawError> {
        let Correction { rotation, variance, .. } = self.measured?;
        let variance_rad2 = variance.dot(&axis.component_mul(axis));
        Some(YawError { rad: rotation.dot(axis), variance_rad2 })
    }

    /// What flow says of the camera's mount: pitch, yaw and roll beside the configured ones. `None` where the last update did not
    /// use flow, or where flow does not agree on one motion.
    pub(crate) fn mount(&self) -> Option<Sums<3>> {
        self.measured?.mount
    }

    /// Forgets the previous pose.
    pub fn forget(&mut self) {
        self.before = None;
    }

    /// Restarts at `measured` (`t_odom_camera`).
    pub fn restart(&mut self, measured: &Pose3) {
        self.before = Some(Before { measured: *measured, filtered: *measured });
        self.variance = Vector3::zeros();
        self.correction = None;
        self.measured = None;
    }

    /// Returns `measured` (`t_odom_camera`) with its rotation filtered, or unchanged when flow shows too little.
    pub fn update(
        &mut self,
        measured: &Pose3,
        observed: FlowObservation<'_>,
        prior: DepthPrior<'_>,
    ) -> Pose3 {
        let Some(filtered) = self.filter(measured, observed, prior) else {
            self.restart(measured);
            return *measured;
        };
        self.before = Some(Before { measured: *measured, filtered });
        filtered
    }

    fn filter(
        &mut self,
        measured: &Pose3,
        observed: FlowObservation<'_>,
        prior: DepthPrior<'_>,
    ) -> Option<Pose3> {
        let before = self.before?;
        let rotation = before.measured.rotation.inverse() * measured.rotation;
        let predicted =
            Pose3::from_parts(measured.translation, before.filtered.rotation * rotation);
        let t_now_before = predicted.inverse() * before.filtered;
        let correction = self.correction(&t_now_before, observed, prior)?;
        self.measured = Some(correction);
        Some(self.fuse(&predicted, measured, correction))
    }

    /// Weighs the rotation that flow gives against the odometry's (Kalman 1960).
    fn fuse(&mut self, predicted: &Pose3, measured: &Pose3, correction: Correction) -> Pose3 {
        // An error that reverses in the next frame is jitter: an error e of one pose makes two rotations wrong, by e and by
        // -e. Drift does not reverse.
        if let Some(before) = self.correction.replace(correction.rotation) {
            self.frames = (self.frames + 1.0).min(JITTER_MEMORY);
            self.mean_square +=
                (correction.rotation.norm_squared() / 3.0 - self.mean_square) / self.frames;
            self.reversal +=
                (-correction.rotation.dot(&before) / 3.0 - self.reversal) / self.frames;
        }
        self.variance += correction.variance;
        let jitter = self.jitter();
        let gain = self.variance.map(|variance| variance / (variance + jitter));
        self.variance.component_mul_assign(&gain.map(|gain| 1.0 - gain));
        let from_flow = predicted.rotation * UnitQuaternion::from_scaled_axis(correction.rotation);
        let innovation = (from_flow.inverse() * measured.rotation).scaled_axis();
        let update = UnitQuaternion::from_scaled_axis(innovation.component_mul(&gain));
        Pose3::from_parts(measured.translation, from_flow * update)
    }

    /// The error of the rotation of `t_now_before`, by robust least squares (Geman-McClure) with the expected errors as
    /// prior. `None` when too few cells can be used.
    fn correction(
        &mut self,
        t_now_before: &Pose3,
        observed: FlowObservation<'_>,
        prior: DepthPrior<'_>,
    ) -> Option<Correction> {
        let DepthPrior { beliefs, confidence, cells, scene_depth_m } = prior;
        self.equations.clear();
        let examined = cells.width.div_ceil(EVERY) * cells.height.div_ceil(EVERY);
        self.equations.reserve(examined);
        for row in (0..cells.height).step_by(EVERY) {
            for column in (0..cells.width).step_by(EVERY) {
                let index = row * cells.width + column;
                let belief = beliefs.get(index).filter(|_| confidence[index] >= LEAST_CONFIDENCE);
                let [du, dv] = belief.map_or([0.0; 2], |belief| belief.offset.map(f64::from));
                let depth =
                    belief.map_or(scene_depth_m, |belief| 1.0 / f64::from(belief.inverse_depth));
                let depth_error = if belief.is_some() { DEPTH_ERROR } else { UNKNOWN_DEPTH_ERROR };
                let point = cells.ray(column as f64 + du, row as f64 + dv) * depth;
                self.equations.extend(equation(t_now_before, &point, depth_error, observed));
            }
        }
        if self.equations.len() < LEAST_CELLS {
            return None;
        }
        let rotation_error = ROTATION_ERROR_RAD + ROTATION_ERROR * t_now_before.rotation.angle();
        let mut correction = solve(&self.equations, rotation_error, t_now_before)?;
        if (self.equations.len() as f64) < LEAST_MOUNT_CELLS * examined as f64 {
            correction.mount = None;
        }
        Some(correction)
    }
}

/// The equation of `point`, given in the previous camera; `None` where flow does not measure it.
fn equation(
    t_now_before: &Pose3,
    point: &Vector3<f64>,
    depth_error: f64,
    observed: FlowObservation<'_>,
) -> Option<Equation> {
    let FlowObservation { flow, image, camera } = observed;
    let rotated = t_now_before.rotation * point;
    let now = rotated + t_now_before.translation.vector;
    let (u, v) = camera.project(&now.into())?;
    let columns = MARGIN..camera.width as f64 - MARGIN;
    let rows = MARGIN..camera.height as f64 - MARGIN;
    if !columns.contains(&u) || !rows.contains(&v) {
        return None;
    }
    let at = v.round() as usize * image.width + u.round() as usize;
    let [flow_u, flow_v] = flow.values()[at].map(f64::from);
    // Without texture, flow only follows its neighbours.
    if image.descriptors[at] == 0 || !(flow_u + flow_v).is_finite() {
        return None;
    }
    let before = camera.project(&(*point).into())?;
    let error_px = Vector2::new(u + flow_u - before.0, v + flow_v - before.1);
    let x = now.x / now.z;
    let y = now.y / now.z;
    let z = now.z;
    let projection =
        Matrix2x3::new(camera.fx, 0.0, -camera.fx * x, 0.0, camera.fy, -camera.fy * y) / z;
    let mut jacobian = SMatrix::<f64, 2, UNKNOWNS>::zeros();
    // A camera rotated by omega sees the point at now - omega x now.
    jacobian.fixed_columns_mut::<3>(0).copy_from(&(projection * now.cross_matrix()));
    let by_depth = projection * rotated;
    let right = 2.0 * u / camera.width as f64 - 1.0;
    let down = 2.0 * v / camera.height as f64 - 1.0;
    for (column, factor) in [1.0, right, down].into_iter().enumerate() {
        jacobian.set_column(3 + column, &(by_depth * factor));
    }
    jacobian.fixed_columns_mut::<3>(6).copy_from(&-projection);
    // The weight of the error along the epipolar line decreases with the uncertainty of depth.
    let along_px = depth_error * by_depth.norm();
    let reduction = 1.0 - 1.0 / along_px.hypot(1.0);
    let direction = by_depth.try_normalize(1e-9).unwrap_or_default();
    let across = Matrix2::identity() - direction * direction.transpose() * reduction;
    Some(Equation { jacobian: across * jacobian, error_px: across * error_px })
}

/// The rotation that fits the equations best.
fn solve(equations: &[Equation], rotation_error: f64, t_now_before: &Pose3) -> Option<Correction> {
    let mut prior = SVector::<f64, UNKNOWNS>::repeat(rotation_error.powi(-2));
    prior.fixed_rows_mut::<3>(3).fill(DEPTH_ERROR.powi(-2));
    prior.fixed_rows_mut::<3>(6).fill(STEP_ERROR_M.powi(-2));
    let mut unknowns = SVector::<f64, UNKNOWNS>::zeros();
    let mut covariance = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
    let mut agreement = 0.0;
    for scale_px in SCALES_PX {
        agreement = 0.0;
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_diagonal(&prior);
        let mut right = SVector::<f64, UNKNOWNS>::zeros();
        for Equation { jacobian, error_px } in equations {
            let error = (error_px + jacobian * unknowns).norm() / scale_px;
            let weight = (1.0 + error * error).powi(-2);
            agreement += weight / equations.len() as f64;
            let weighted = jacobian.transpose() * (weight / (FLOW_ERROR_PX * FLOW_ERROR_PX));
            normal += weighted * jacobian;
            right -= weighted * error_px;
        }
        let cholesky = normal.cholesky()?;
        unknowns = cholesky.solve(&right);
        covariance = cholesky.inverse();
    }
    let variance = covariance.diagonal();
    Some(Correction {
        rotation: unknowns.fixed_rows::<3>(0).into(),
        variance: Vector3::from(variance.fixed_rows::<3>(0))
            .add_scalar(ESTIMATE_ERROR_RAD * ESTIMATE_ERROR_RAD),
        mount: (agreement >= LEAST_AGREEMENT)
            .then(|| mount_equations(&moved(t_now_before, &unknowns, &covariance, &prior))),
    })
}

/// The part of the unknowns that a wrong mount explains: rotation and translation.
fn moved(
    t_now_before: &Pose3,
    unknowns: &SVector<f64, UNKNOWNS>,
    covariance: &SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    prior: &SVector<f64, UNKNOWNS>,
) -> Moved {
    const PARTS: [usize; 6] = [0, 1, 2, 6, 7, 8];
    Moved {
        rotation: t_now_before.rotation.to_rotation_matrix().into_inner(),
        translation_m: t_now_before.translation.vector,
        errors: SVector::from_fn(|row, _| unknowns[PARTS[row]]),
        covariance: SMatrix::from_fn(|row, column| covariance[(PARTS[row], PARTS[column])]),
        prior: SVector::from_fn(|row, _| prior[PARTS[row]]),
    }
}

remembers!(RotationFilter: before, variance, correction, mean_square, reversal, frames);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::test_scene::{depth_m, pose};

    /// The odometry's error at the frame with this index, radians.
    type Error = fn(usize) -> Vector3<f64>;

    fn camera() -> CameraModel {
        CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2)
    }

    /// Depth of a slanted wall between a floor and a ceiling.
    fn depth(camera: &CameraModel, at: &Pose3, u: f64, v: f64) -> f64 {
        let down = camera.ray(u, v).y;
        let level = if down > 0.0 { 0.4 } else { -0.6 };
        depth_m(camera, at, u, v).min(level / down)
    }

    /// Forward on an arc.
    fn path(index: usize) -> Pose3 {
        let index = index as f64;
        pose([0.01 * index, 0.0, 0.01 * index], 0.002 * index)
    }

    /// Uniform white noise of 2 mrad about each axis.
    fn jitter(index: usize) -> Vector3<f64> {
        Vector3::new(noise(index, 0), noise(index, 1), noise(index, 2)) * (0.002 * 12.0_f64.sqrt())
    }

    fn noise(index: usize, axis: usize) -> f64 {
        let hash = ((index * 3 + axis) as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        ((hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64
            / f64::from(1 << 24)
            - 0.5
    }

    /// Errors of the filtered rotations of 80 frames, with true depth and flow.
    fn travel(error: Error) -> Vec<Vector3<f64>> {
        let image = textured();
        let mut filter = RotationFilter::default();
        let mut beliefs = vec![Belief::default(); 160 * 48];
        let mut errors = Vec::new();
        for index in 0..80_usize {
            let now = path(index);
            let measured = now * UnitQuaternion::from_scaled_axis(error(index));
            let flow = true_flow(index);
            let found = update(&mut filter, &measured, &flow, &image, &beliefs);
            assert_eq!(found.translation, measured.translation);
            errors.push((now.rotation.inverse() * found.rotation).scaled_axis());
            beliefs = true_beliefs(&now);
        }
        errors
    }

    /// An image with texture in all of its pixels.
    fn textured() -> CensusImage {
        let mut image = CensusImage::default();
        image.width = 640;
        image.height = 192;
        image.descriptors = vec![1; 640 * 192];
        image
    }

    fn update(
        filter: &mut RotationFilter,
        measured: &Pose3,
        flow: &FlowField,
        image: &CensusImage,
        beliefs: &[Belief],
    ) -> Pose3 {
        let cells = camera().resized(160, 48);
        let confidence = vec![1.0; 160 * 48];
        let observed = FlowObservation { flow, image, camera: &camera() };
        let prior =
            DepthPrior { beliefs, confidence: &confidence, cells: &cells, scene_depth_m: 2.0 };
        filter.update(measured, observed, prior)
    }

    fn true_flow(index: usize) -> FlowField {
        let camera = camera();
        let now = path(index);
        let before = path(index.saturating_sub(1));
        let mut flow = FlowField::zero(640, 192);
        for (at, flow) in flow.values_mut().iter_mut().enumerate() {
            let u = (at % 640) as f64;
            let v = (at / 640) as f64;
            let point = now * camera.unproject(u, v, depth(&camera, &now, u, v));
            let (x, y) = camera.project(&before.inverse_transform_point(&point)).unwrap();
            *flow = [(x - u) as f32, (y - v) as f32];
        }
        flow
    }

    fn true_beliefs(now: &Pose3) -> Vec<Belief> {
        let cells = camera().resized(160, 48);
        let belief = |at: usize| {
            let depth = depth(&cells, now, (at % 160) as f64, (at / 160) as f64);
            let inverse_depth = (1.0 / depth) as f32;
            Belief { inverse_depth, evidence: 1.0, votes: 1.0, offset: [0.0; 2] }
        };
        (0..160 * 48).map(belief).collect()
    }

    /// Whether an image says something of the camera's mount. In the first of its columns, as a share of all, `change` makes the flow
    /// or the texture wrong.
    fn says_something(share: f64, change: fn(&mut [f32; 2], &mut u32)) -> bool {
        let mut filter = RotationFilter::default();
        let mut image = textured();
        update(&mut filter, &path(0), &true_flow(0), &image, &true_beliefs(&path(0)));
        let mut flow = true_flow(1);
        for (at, flow) in flow.values_mut().iter_mut().enumerate() {
            if ((at % 640) as f64) < share * 640.0 {
                change(flow, &mut image.descriptors[at]);
            }
        }
        update(&mut filter, &path(1), &flow, &image, &true_beliefs(&path(0)));
        filter.mount().is_some()
    }

    #[test]
    fn an_image_whose_flow_does_not_agree_on_one_motion_says_nothing_of_the_mount() {
        let is_wrong = |flow: &mut [f32; 2], _: &mut u32| flow[1] += 6.0;
        assert!(says_something(0.0, is_wrong));
        assert!(says_something(0.3, is_wrong));
        assert!(!says_something(0.7, |flow, _| *flow = [flow[1] * 20.0, flow[0] * 20.0]));
    }

    #[test]
    fn an_image_that_is_mostly_without_texture_says_nothing_of_the_mount() {
        assert!(says_something(0.3, |_, texture| *texture = 0));
        assert!(!says_something(0.7, |_, texture| *texture = 0));
    }

    /// Root mean square change of the errors over ten frames, after the jitter has been measured.
    fn over_ten(errors: &[Vector3<f64>]) -> f64 {
        let squares: Vec<f64> =
            errors[20..].windows(11).map(|w| (w[10] - w[0]).norm_squared()).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    #[test]
    fn jitter_is_reduced_to_little_more_than_half() {
        let measured: Vec<Vector3<f64>> = (0..80).map(jitter).collect();
        let filtered = over_ten(&travel(jitter));
        let measured = over_ten(&measured);
        assert!(filtered < 0.55 * measured, "{filtered} {measured}");
    }

    #[test]
    fn odometry_without_jitter_is_not_changed() {
        let worst = travel(|_| Vector3::zeros()).iter().map(Vector3::norm).fold(0.0, f64::max);
        assert!(worst < 1e-4, "{worst}");
    }

    #[test]
    fn drift_is_not_mistaken_for_jitter() {
        let drift: Error = |index| Vector3::new(0.0, 0.001 * index as f64, 0.0);
        let last = travel(drift)[79];
        assert!((last - drift(79)).norm() < 1e-3, "{last}");
    }

    #[test]
    fn without_texture_the_pose_stays() {
        let mut filter = RotationFilter::default();
        let cells = camera().resized(160, 48);
        let prior = DepthPrior { beliefs: &[], confidence: &[], cells: &cells, scene_depth_m: 2.0 };
        let flow = FlowField::zero(640, 192);
        let mut image = CensusImage::default();
        image.width = 640;
        image.height = 192;
        image.descriptors = vec![0; 640 * 192];
        let observed = FlowObservation { flow: &flow, image: &image, camera: &camera() };
        for index in 0..3 {
            let measured = path(index) * UnitQuaternion::from_scaled_axis(jitter(index));
            assert_eq!(filter.update(&measured, observed, prior), measured);
        }
    }
}
