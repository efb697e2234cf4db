//! Steadies where the camera is said to look.
//!
//! Odometry and tracking jitter: a milliradian from picture to picture is a third of a pixel at f = 320, as much parallax as
//! ten centimetres of depth have at five metres. From one picture to the next things move little by their depth, so flow and
//! what is believed of the depth tell the turn between two pictures far better; where nothing is believed, what is off its
//! epipolar line still does. But turns add up to drift, and drift is what odometry corrects. How far odometry is believed
//! follows from its jitter: without any it is taken at its word.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix2, Matrix2x3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::belief::Belief;
use super::census::CensusImage;
use super::flow::FlowField;
use crate::snapshot::remembers;

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
/// What is believed less than this is taken for unknown: it may be anywhere on its epipolar line.
const LEAST_CONFIDENCE: f32 = 0.8;
const UNKNOWN_DEPTH_ERROR: f64 = 1.0;
/// Every so many cells count, this far from the edge, pixels.
const EVERY: usize = 4;
const MARGIN: f64 = 8.0;
/// Fewer cells than this say nothing.
const LEAST_CELLS: usize = 25;
/// Robust scale from one iteration to the next, pixels: far outliers first.
const SCALES_PX: [f64; 4] = [4.0, 2.0, 1.0, 1.0];
/// Jitter that is expected before it is measured, radians, and pictures in its mean square.
const FIRST_JITTER_RAD: f64 = 0.002;
const JITTER_MEMORY: f64 = 20.0;
/// Steadies a camera's poses from picture to picture.
#[derive(Debug)]
pub struct SteadyRotation {
    before: Option<Before>,
    /// How wrong the steady rotation may be about each axis, rad^2.
    variance: Vector3<f64>,
    /// How the last turn was corrected, in the camera's axes.
    correction: Option<Vector3<f64>>,
    /// Of the corrections about each axis, rad^2: mean square, mean product of two neighbours with the sign turned, and of how
    /// many pictures.
    square: f64,
    turned_back: f64,
    pictures: f64,
    equations: Vec<Equation>,
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
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
    /// Depth of what nothing is believed of, metres.
    pub scene_depth_m: f64,
}

/// Flow from a picture to the one before.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    pub flow: &'a FlowField,
    pub picture: &'a CensusImage,
    /// Describes the picture's positions.
    pub camera: &'a CameraModel,
}

/// How flow corrects a turn, a rotation vector in the camera's axes, and how wrong that may be about each, rad^2.
#[derive(Debug, Clone, Copy, Default)]
struct Turn {
    correction: Vector3<f64>,
    variance: Vector3<f64>,
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
            variance: Vector3::zeros(),
            correction: None,
            square: 2.0 * FIRST_JITTER_RAD * FIRST_JITTER_RAD,
            turned_back: FIRST_JITTER_RAD * FIRST_JITTER_RAD,
            pictures: 1.0,
            equations: Vec::new(),
        }
    }
}

impl SteadyRotation {
    /// Standard deviation of odometry's jitter about each axis, radians.
    pub fn jitter_rad(&self) -> f64 {
        self.jitter().sqrt()
    }

    /// Mean square of odometry's jitter about each axis, rad^2. Jitter alone turns half of the mean square back, errors of flow
    /// nothing in the mean, but a fifth by chance: up to a quarter is no jitter.
    fn jitter(&self) -> f64 {
        (2.0 * (self.turned_back - 0.25 * self.square)).max(0.0)
    }

    /// Forgets the pose before.
    pub fn forget(&mut self) {
        self.before = None;
    }

    /// Begins at `said` (`t_odom_camera`).
    pub fn begin(&mut self, said: &Pose3) {
        self.before = Some(Before { said: *said, steady: *said });
        self.variance = Vector3::zeros();
        self.correction = None;
    }

    /// `said` (`t_odom_camera`) with its rotation steadied, or as it is when too little is seen.
    pub fn steady(&mut self, said: &Pose3, seen: Seen<'_>, believed: Believed<'_>) -> Pose3 {
        let steady = self.before.and_then(|before| {
            let turn = before.said.rotation.inverse() * said.rotation;
            let expected = Pose3::from_parts(said.translation, before.steady.rotation * turn);
            let correction =
                self.correction(&(expected.inverse() * before.steady), seen, believed)?;
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
    fn weigh(&mut self, expected: &Pose3, said: &Pose3, turn: Turn) -> Pose3 {
        // What turns back at once is jitter: an error e of one pose makes two turns wrong, by e and by -e. Drift does not.
        if let Some(before) = self.correction.replace(turn.correction) {
            self.pictures = (self.pictures + 1.0).min(JITTER_MEMORY);
            self.square += (turn.correction.norm_squared() / 3.0 - self.square) / self.pictures;
            self.turned_back +=
                (-turn.correction.dot(&before) / 3.0 - self.turned_back) / self.pictures;
        }
        self.variance += turn.variance;
        let jitter = self.jitter();
        let share = self.variance.map(|variance| variance / (variance + jitter));
        self.variance.component_mul_assign(&share.map(|share| 1.0 - share));
        let seen = expected.rotation * UnitQuaternion::from_scaled_axis(turn.correction);
        let back = (seen.inverse() * said.rotation).scaled_axis().component_mul(&share);
        Pose3::from_parts(said.translation, seen * UnitQuaternion::from_scaled_axis(back))
    }

    /// How the camera is turned beside `t_now_before`, a rotation vector in its own axes: robust least squares
    /// (Geman-McClure) with the expected errors as prior. `None` where too little is known.
    fn correction(
        &mut self,
        t_now_before: &Pose3,
        seen: Seen<'_>,
        believed: Believed<'_>,
    ) -> Option<Turn> {
        let Believed { beliefs, confidence, cells, scene_depth_m } = believed;
        self.equations.clear();
        self.equations.reserve((cells.width * cells.height).div_ceil(EVERY * EVERY));
        for row in (0..cells.height).step_by(EVERY) {
            for column in (0..cells.width).step_by(EVERY) {
                let index = row * cells.width + column;
                let belief = beliefs.get(index).filter(|_| confidence[index] >= LEAST_CONFIDENCE);
                let [du, dv] = belief.map_or([0.0; 2], |belief| belief.offset.map(f64::from));
                let depth =
                    belief.map_or(scene_depth_m, |belief| 1.0 / f64::from(belief.inverse_depth));
                let depth_error = if belief.is_some() { DEPTH_ERROR } else { UNKNOWN_DEPTH_ERROR };
                let point = cells.ray(column as f64 + du, row as f64 + dv) * depth;
                self.equations.extend(equation(t_now_before, &point, depth_error, seen));
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
fn equation(
    t_now_before: &Pose3,
    point: &Vector3<f64>,
    depth_error: f64,
    seen: Seen<'_>,
) -> Option<Equation> {
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
    // Along its line the cell counts less the less its depth is known.
    let along_px = depth_error * by_depth.norm();
    let less = 1.0 - 1.0 / along_px.hypot(1.0);
    let direction = by_depth.try_normalize(1e-9).unwrap_or_default();
    let across = Matrix2::identity() - direction * direction.transpose() * less;
    Some(Equation { slopes: across * slopes, off: across * off })
}

/// The turn that explains the equations.
fn solve(equations: &[Equation], turn_error: f64) -> Option<Turn> {
    let mut prior = SVector::<f64, UNKNOWNS>::repeat(turn_error.powi(-2));
    prior.fixed_rows_mut::<3>(3).fill(DEPTH_ERROR.powi(-2));
    prior.fixed_rows_mut::<3>(6).fill(STEP_ERROR_M.powi(-2));
    let mut unknowns = SVector::<f64, UNKNOWNS>::zeros();
    let mut turn = Turn::default();
    for scale_px in SCALES_PX {
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_diagonal(&prior);
        let mut right = SVector::<f64, UNKNOWNS>::zeros();
        for Equation { slopes, off } in equations {
            let error = (off + slopes * unknowns).norm() / scale_px;
            let weighted = slopes.transpose()
                * ((1.0 + error * error).powi(-2) / (FLOW_ERROR_PX * FLOW_ERROR_PX));
            normal += weighted * slopes;
            right -= weighted * off;
        }
        let cholesky = normal.cholesky()?;
        unknowns = cholesky.solve(&right);
        let variance = cholesky.inverse().diagonal();
        turn = Turn {
            correction: unknowns.fixed_rows::<3>(0).into(),
            variance: Vector3::from(variance.fixed_rows::<3>(0))
                .add_scalar(SEEN_ERROR_RAD * SEEN_ERROR_RAD),
        };
    }
    Some(turn)
}

remembers!(SteadyRotation: before, variance, correction, square, turned_back, pictures);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::test_scene::{depth_m, pose};

    /// Odometry's error of the picture with this index, radians.
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
        let noise = |axis: usize| {
            let hash = ((index * 3 + axis) as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            ((hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64
                / f64::from(1 << 24)
                - 0.5
        };
        Vector3::new(noise(0), noise(1), noise(2)) * (0.002 * 12.0_f64.sqrt())
    }

    /// Errors of the steadied rotations of 80 pictures. Depth and flow are true.
    fn travel(error: Error) -> Vec<Vector3<f64>> {
        let (camera, cells) = (camera(), camera().resized(160, 48));
        let mut picture = CensusImage::default();
        (picture.width, picture.height, picture.descriptors) = (640, 192, vec![1; 640 * 192]);
        let confidence = vec![1.0; 160 * 48];
        let mut steady = SteadyRotation::default();
        let mut beliefs = vec![Belief::default(); 160 * 48];
        let mut errors = Vec::new();
        for index in 0..80_usize {
            let (now, before) = (path(index), path(index.saturating_sub(1)));
            let mut flow = FlowField::zero(640, 192);
            for (at, flow) in flow.values_mut().iter_mut().enumerate() {
                let (u, v) = ((at % 640) as f64, (at / 640) as f64);
                let point = now * camera.unproject(u, v, depth(&camera, &now, u, v));
                let (x, y) = camera.project(&before.inverse_transform_point(&point)).unwrap();
                *flow = [(x - u) as f32, (y - v) as f32];
            }
            let said = now * UnitQuaternion::from_scaled_axis(error(index));
            let seen = Seen { flow: &flow, picture: &picture, camera: &camera };
            let believed = Believed {
                beliefs: &beliefs,
                confidence: &confidence,
                cells: &cells,
                scene_depth_m: 2.0,
            };
            let found = steady.steady(&said, seen, believed);
            assert_eq!(found.translation, said.translation);
            errors.push((now.rotation.inverse() * found.rotation).scaled_axis());
            for (at, belief) in beliefs.iter_mut().enumerate() {
                let depth = depth(&cells, &now, (at % 160) as f64, (at / 160) as f64);
                *belief = Belief {
                    inverse_depth: (1.0 / depth) as f32,
                    evidence: 1.0,
                    votes: 1.0,
                    offset: [0.0; 2],
                };
            }
        }
        errors
    }

    /// Root mean square of how errors change over ten pictures, once the jitter is known.
    fn over_ten(errors: &[Vector3<f64>]) -> f64 {
        let squares: Vec<f64> =
            errors[20..].windows(11).map(|w| (w[10] - w[0]).norm_squared()).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    #[test]
    fn jitter_shrinks_to_little_more_than_half() {
        let said: Vec<Vector3<f64>> = (0..80).map(jitter).collect();
        let (steadied, said) = (over_ten(&travel(jitter)), over_ten(&said));
        assert!(steadied < 0.55 * said, "{steadied} {said}");
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
    fn without_texture_the_pose_stays() {
        let mut steady = SteadyRotation::default();
        let cells = camera().resized(160, 48);
        let believed =
            Believed { beliefs: &[], confidence: &[], cells: &cells, scene_depth_m: 2.0 };
        let flow = FlowField::zero(640, 192);
        let mut picture = CensusImage::default();
        (picture.width, picture.height, picture.descriptors) = (640, 192, vec![0; 640 * 192]);
        let seen = Seen { flow: &flow, picture: &picture, camera: &camera() };
        for index in 0..3 {
            let said = path(index) * UnitQuaternion::from_scaled_axis(jitter(index));
            assert_eq!(steady.steady(&said, seen, believed), said);
        }
    }
}
