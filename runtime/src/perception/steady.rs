//! Steadies where the camera is said to look.
//!
//! Odometry and tracking jitter: a milliradian from picture to picture is a third of a pixel at f = 320, as much parallax as
//! ten centimetres of depth have at five metres. From one picture to the next things move little by their depth, so flow and
//! what is believed of the depth tell the turn between two pictures far better; but turns add up to drift, and drift is what
//! odometry corrects. How far odometry is believed follows from its jitter: without any it is taken at its word.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix2x3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::census::CensusImage;
use super::flow::FlowField;
use super::fusion::Belief;

/// Unknowns: the turn, by which factor depth is wrong in the middle of the picture and more towards its right and lower
/// edge, and the error of the step. Where believed depth is wrong, all of it is, and must not pass for a turn.
const UNKNOWNS: usize = 9;
/// Expected errors of depth (a factor) ...
const DEPTH_ERROR: f64 = 0.1;
/// ... of the step, metres ...
const STEP_ERROR_M: f64 = 0.003;
/// ... of the turn, radians and as a share of it ...
const TURN_ERROR_RAD: f64 = 0.005;
const TURN_ERROR: f64 = 0.05;
/// ... of flow, pixels; generous, because neighbours are wrong together ...
const FLOW_ERROR_PX: f64 = 2.0;
/// ... and of the turn after flow was asked, radians.
const SEEN_ERROR_RAD: f64 = 0.0003;
/// Only what is so probably right counts, every so many cells, this far from the edge, pixels.
const LEAST_CONFIDENCE: f32 = 0.8;
const EVERY: usize = 4;
const MARGIN: f64 = 8.0;
/// Fewer cells than this say nothing.
const LEAST_CELLS: usize = 25;
/// Robust scale from one iteration to the next, pixels: far outliers first.
const SCALES_PX: [f64; 4] = [4.0, 2.0, 1.0, 1.0];
/// Jitter that is expected before it is measured, radians, and pictures in its mean square.
const FIRST_JITTER_RAD: f64 = 0.002;
const JITTER_MEMORY: f64 = 20.0;
/// Nothing is known of the rotation: more than anything that it is weighed against, rad^2.
const UNKNOWN: f64 = 1.0;

/// Steadies a camera's poses from picture to picture.
#[derive(Debug)]
pub struct SteadyRotation {
    before: Option<Before>,
    /// How wrong the steady rotation may be about each axis, rad^2.
    variance: f64,
    /// How the last turn was corrected, in the camera's axes.
    correction: Vector3<f64>,
    /// Mean square of odometry's jitter about each axis, rad^2, and of how many pictures.
    jitter: f64,
    pictures: f64,
    equations: Vec<Equation>,
}

#[derive(Debug, Clone, Copy)]
struct Before {
    said: Pose3,
    steady: Pose3,
}

/// What is believed of the picture before.
#[derive(Debug, Clone, Copy)]
pub struct Believed<'a> {
    /// Of every cell, row-major.
    pub beliefs: &'a [Belief],
    /// The probability that it is right.
    pub confidence: &'a [f32],
    /// The camera of the cells.
    pub cells: &'a CameraModel,
}

/// Flow from a picture to the one before.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    pub flow: &'a FlowField,
    pub picture: &'a CensusImage,
    /// Describes the picture's positions.
    pub camera: &'a CameraModel,
}

/// How far off a cell is found in the picture before, pixels, and how that answers to the unknowns.
#[derive(Debug)]
struct Equation {
    slopes: SMatrix<f64, 2, UNKNOWNS>,
    off: Vector2<f64>,
}

impl Default for SteadyRotation {
    fn default() -> Self {
        Self {
            before: None,
            variance: UNKNOWN,
            correction: Vector3::zeros(),
            jitter: FIRST_JITTER_RAD * FIRST_JITTER_RAD,
            pictures: 1.0,
            equations: Vec::new(),
        }
    }
}

impl SteadyRotation {
    /// Standard deviation of odometry's jitter about each axis, radians.
    pub fn jitter_rad(&self) -> f64 {
        self.jitter.max(0.0).sqrt()
    }

    /// Forgets the pose before.
    pub fn forget(&mut self) {
        self.before = None;
    }

    /// Begins at `said` (`t_odom_camera`).
    pub fn begin(&mut self, said: &Pose3) {
        self.before = Some(Before { said: *said, steady: *said });
        self.variance = UNKNOWN;
        self.correction = Vector3::zeros();
    }

    /// `said` (`t_odom_camera`) with its rotation steadied, or as it is when too little is believed.
    pub fn steady(&mut self, said: &Pose3, seen: Seen<'_>, believed: Believed<'_>) -> Pose3 {
        let steady = self.before.and_then(|before| {
            let turn = before.said.rotation.inverse() * said.rotation;
            let expected = Pose3::from_parts(said.translation, before.steady.rotation * turn);
            let correction = self.correction(&(expected.inverse() * before.steady), seen, believed)?;
            Some(self.weigh(&expected, said, correction))
        });
        let Some(steady) = steady else {
            self.begin(said);
            return *said;
        };
        self.before = Some(Before { said: *said, steady });
        steady
    }

    /// Between the rotation that flow leads to and the one that odometry says (Kalman 1960).
    fn weigh(&mut self, expected: &Pose3, said: &Pose3, correction: Vector3<f64>) -> Pose3 {
        // What turns back at once is jitter: an error e of one pose makes two turns wrong, by e and by -e. Drift does not.
        let jitter = -correction.dot(&self.correction) / 3.0;
        self.pictures = (self.pictures + 1.0).min(JITTER_MEMORY);
        self.jitter += (jitter - self.jitter) / self.pictures;
        self.correction = correction;
        self.variance += SEEN_ERROR_RAD * SEEN_ERROR_RAD;
        let share = self.variance / (self.variance + self.jitter.max(0.0));
        self.variance *= 1.0 - share;
        let seen = expected.rotation * UnitQuaternion::from_scaled_axis(correction);
        let back = (seen.inverse() * said.rotation).scaled_axis() * share;
        Pose3::from_parts(said.translation, seen * UnitQuaternion::from_scaled_axis(back))
    }

    /// How the camera is turned beside `t_now_before`, a rotation vector in its own axes: robust least squares
    /// (Geman-McClure) with the expected errors as prior. `None` where too little is known.
    fn correction(&mut self, t_now_before: &Pose3, seen: Seen<'_>, believed: Believed<'_>) -> Option<Vector3<f64>> {
        let Believed { beliefs, confidence, cells } = believed;
        self.equations.clear();
        self.equations.reserve(beliefs.len().div_ceil(EVERY * EVERY));
        for (row, line) in beliefs.chunks_exact(cells.width).enumerate().step_by(EVERY) {
            for (column, belief) in line.iter().enumerate().step_by(EVERY) {
                if confidence[row * cells.width + column] >= LEAST_CONFIDENCE {
                    let u = column as f64 + f64::from(belief.offset[0]);
                    let v = row as f64 + f64::from(belief.offset[1]);
                    let point = cells.ray(u, v) / f64::from(belief.inverse_depth);
                    self.equations.extend(equation(t_now_before, &point, seen));
                }
            }
        }
        if self.equations.len() < LEAST_CELLS {
            return None;
        }
        let turn_error = TURN_ERROR_RAD + TURN_ERROR * t_now_before.rotation.angle();
        solve(&self.equations, turn_error)
    }
}

/// Of `point` in the camera before; `None` where flow does not show it.
fn equation(t_now_before: &Pose3, point: &Vector3<f64>, seen: Seen<'_>) -> Option<Equation> {
    let Seen { flow, picture, camera } = seen;
    let turned = t_now_before.rotation * point;
    let now = turned + t_now_before.translation.vector;
    let (u, v) = camera.project(&now.into())?;
    let inside = |at: f64, size: usize| at >= MARGIN && at < size as f64 - MARGIN;
    if !inside(u, camera.width) || !inside(v, camera.height) {
        return None;
    }
    let place = v.round() as usize * picture.width + u.round() as usize;
    let [flow_u, flow_v] = flow.values()[place].map(f64::from);
    // Without texture, flow is what the neighbours do.
    if picture.descriptors[place] == 0 || !(flow_u + flow_v).is_finite() {
        return None;
    }
    let before = camera.project(&(*point).into())?;
    let off = Vector2::new(u + flow_u - before.0, v + flow_v - before.1);
    let (x, y, z) = (now.x / now.z, now.y / now.z, now.z);
    let slope = Matrix2x3::new(camera.fx, 0.0, -camera.fx * x, 0.0, camera.fy, -camera.fy * y) / z;
    let mut slopes = SMatrix::<f64, 2, UNKNOWNS>::zeros();
    // A camera turned by omega sees the point at now - omega x now.
    slopes.fixed_columns_mut::<3>(0).copy_from(&(slope * now.cross_matrix()));
    let by_depth = slope * turned;
    let (right, down) = (2.0 * u / camera.width as f64 - 1.0, 2.0 * v / camera.height as f64 - 1.0);
    for (column, factor) in [1.0, right, down].into_iter().enumerate() {
        slopes.set_column(3 + column, &(by_depth * factor));
    }
    slopes.fixed_columns_mut::<3>(6).copy_from(&-slope);
    Some(Equation { slopes, off })
}

/// The turn that explains the equations.
fn solve(equations: &[Equation], turn_error: f64) -> Option<Vector3<f64>> {
    let mut prior = SVector::<f64, UNKNOWNS>::repeat(turn_error.powi(-2));
    prior.fixed_rows_mut::<3>(3).fill(DEPTH_ERROR.powi(-2));
    prior.fixed_rows_mut::<3>(6).fill(STEP_ERROR_M.powi(-2));
    let mut unknowns = SVector::<f64, UNKNOWNS>::zeros();
    for scale_px in SCALES_PX {
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_diagonal(&prior);
        let mut right = SVector::<f64, UNKNOWNS>::zeros();
        for Equation { slopes, off } in equations {
            let error = (off + slopes * unknowns).norm() / scale_px;
            let weighted = slopes.transpose() * ((1.0 + error * error).powi(-2) / (FLOW_ERROR_PX * FLOW_ERROR_PX));
            normal += weighted * slopes;
            right -= weighted * off;
        }
        unknowns = normal.cholesky()?.solve(&right);
    }
    Some(unknowns.fixed_rows::<3>(0).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::test_scene::{depth_m, pose};

    /// Odometry's error of the picture with this index, radians.
    type Error = fn(usize) -> Vector3<f64>;

    fn camera() -> CameraModel {
        CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
    }

    /// Forward on an arc, past a slanted wall.
    fn path(index: usize) -> Pose3 {
        let index = index as f64;
        pose([0.01 * index, 0.0, 0.01 * index], 0.002 * index)
    }

    /// Uniform white noise of 2 mrad about each axis.
    fn jitter(index: usize) -> Vector3<f64> {
        let noise = |axis: usize| {
            let hash = ((index * 3 + axis) as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            ((hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        Vector3::new(noise(0), noise(1), noise(2)) * (0.002 * 12.0_f64.sqrt())
    }

    /// Errors of the steadied rotations of 80 pictures. Depth and flow are true.
    fn travel(error: Error) -> Vec<Vector3<f64>> {
        let (camera, cells) = (camera(), camera().resized(80, 24));
        let mut picture = CensusImage::default();
        (picture.width, picture.height, picture.descriptors) = (320, 96, vec![1; 320 * 96]);
        let confidence = vec![1.0; 80 * 24];
        let mut steady = SteadyRotation::default();
        let mut beliefs = vec![Belief::default(); 80 * 24];
        let mut errors = Vec::new();
        for index in 0..80_usize {
            let (now, before) = (path(index), path(index.saturating_sub(1)));
            let mut flow = FlowField::zero(320, 96);
            for (at, flow) in flow.values_mut().iter_mut().enumerate() {
                let (u, v) = ((at % 320) as f64, (at / 320) as f64);
                let point = now * camera.unproject(u, v, depth_m(&camera, &now, u, v));
                let (x, y) = camera.project(&before.inverse_transform_point(&point)).unwrap();
                *flow = [(x - u) as f32, (y - v) as f32];
            }
            let said = now * UnitQuaternion::from_scaled_axis(error(index));
            let seen = Seen { flow: &flow, picture: &picture, camera: &camera };
            let believed = Believed { beliefs: &beliefs, confidence: &confidence, cells: &cells };
            let found = steady.steady(&said, seen, believed);
            assert_eq!(found.translation, said.translation);
            errors.push((now.rotation.inverse() * found.rotation).scaled_axis());
            for (at, belief) in beliefs.iter_mut().enumerate() {
                let depth = depth_m(&cells, &now, (at % 80) as f64, (at / 80) as f64);
                *belief = Belief { inverse_depth: (1.0 / depth) as f32, evidence: 1.0, votes: 1.0, offset: [0.0; 2] };
            }
        }
        errors
    }

    /// Root mean square of how errors change over ten pictures, once the jitter is known.
    fn over_ten(errors: &[Vector3<f64>]) -> f64 {
        let squares: Vec<f64> = errors[20..].windows(11).map(|w| (w[10] - w[0]).norm_squared()).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    #[test]
    fn jitter_shrinks_to_less_than_a_third() {
        let said: Vec<Vector3<f64>> = (0..80).map(jitter).collect();
        let (steadied, said) = (over_ten(&travel(jitter)), over_ten(&said));
        assert!(steadied < said / 3.0, "{steadied} {said}");
    }

    #[test]
    fn odometry_without_jitter_is_taken_at_its_word() {
        let worst = travel(|_| Vector3::zeros()).iter().map(Vector3::norm).fold(0.0, f64::max);
        assert!(worst < 1e-4, "{worst}");
    }

    #[test]
    fn drift_is_not_taken_for_jitter() {
        let drift: Error = |index| Vector3::new(0.0, 0.001 * index as f64, 0.0);
        let last = travel(drift)[79];
        assert!((last - drift(79)).norm() < 1e-3, "{last}");
    }

    #[test]
    fn without_anything_believed_the_pose_stays() {
        let mut steady = SteadyRotation::default();
        let cells = camera().resized(80, 24);
        let believed = Believed { beliefs: &[], confidence: &[], cells: &cells };
        let (flow, picture) = (FlowField::zero(320, 96), CensusImage::default());
        let seen = Seen { flow: &flow, picture: &picture, camera: &camera() };
        for index in 0..3 {
            let said = path(index) * UnitQuaternion::from_scaled_axis(jitter(index));
            assert_eq!(steady.steady(&said, seen, believed), said);
        }
    }
}
