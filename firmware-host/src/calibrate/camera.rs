//! The camera's mount, latency and focal length, from points that were followed between frames.
//!
//! The motion of `base_link` between two frames is known from wheels and scans. It moves the camera by `X^-1 M X`, where `X` is
//! the camera's mount. A point at the ray `r` of the first frame appears in the second at the projection of `R r + rho t`; its
//! inverse distance `rho` is unknown and is eliminated, as are small errors of the motion: the floor tilts the robot, and poses are
//! not exact. The camera's height moves nothing in planar motion; `floor` finds it.

use hal::{CameraModel, Pose2, Pose3};
use nalgebra::{
    DMatrix, DVector, Matrix5, SMatrix, Translation3, UnitQuaternion, Vector2, Vector3, Vector5,
};

use super::base_path::BasePath;
use super::camera_parameters::{
    CameraParameters, FOCAL, FORWARD, LATENCY, LEFT, PARAMETERS, PITCH, ROLL,
};
use super::floor::{LEAST_DOWN, LowPoint};
use super::frames::{ARC_RAD, FramePair, Match, ON_THE_SPOT_M, ROTATION_RAD};
use super::least_squares::{Block, Estimate, Model, Prior, Weight, fit, robust_sigma, tukey};

const NUISANCES: usize = 5;
/// Steps of the numerical derivatives: small against the parameters' effects, large against rounding.
const STEPS: [f64; PARAMETERS] = [1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 5e-3];
const NUISANCE_STEP: f64 = 1e-6;
/// Plausible deviations from the configuration.
const PLAUSIBLE: [f64; PARAMETERS] = [0.2, 0.2, 0.2, 0.2, 0.2, 0.1, 0.2];
/// Inverse distance of a point in a home: mean and standard deviation, 1/m.
const INVERSE_DISTANCE: [f64; 2] = [0.4, 0.5];
/// Standard deviation of an inverse distance that is not fitted, 1/m.
const FIXED: f64 = 1e-3;
/// Errors of a known motion. Matched scans, and wheels between them: 2 mm and 2 mrad. The floor tilts a robot that drives; one that rotates on the
/// spot keeps its tilt. 0.02 rad/m is what a floor according to DIN 18202 does over waves of a metre.
const MOTION_M: f64 = 0.002;
const MOTION_RAD: f64 = 0.002;
const TILT_RAD: f64 = 0.0003;
const TILT_RAD_PER_M: f64 = 0.02;
/// An error across the path that all arcs between two frames may have in common. It is fitted: with it the camera's place, which was off by 6
/// mm in ten simulated robots, is as uncertain as that.
const BENT_M: f64 = 0.0007;
/// No corner is followed better than this, pixels, and neither is the mean of all corners of a pair: interpolation may move all of them alike.
const LEAST_SIGMA_PX: f64 = 0.02;
/// Horizontal bands of the image. In each of them the points of a robot that rotates on the spot, whose distances do not show, are
/// as far away as those of a robot that drives.
const BANDS: usize = 6;
/// Inverse distances that are less certain than this are not averaged, 1/m.
const CERTAIN: f64 = 0.1;
/// A band with fewer certain points has the mean of all bands.
const LEAST_IN_BAND: f64 = 30.0;
/// What the mean inverse distance of the places where the robot rotates may differ from that of the places where it drives, 1/m. Our own
/// choice.
const DIFFERENT: f64 = 0.1;
/// Length of a block of time, seconds.
const BLOCK_S: f64 = 4.0;
/// Fewer pairs are no drive.
const LEAST_PAIRS: usize = 30;

/// Why the camera was not measured.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub(super) enum CameraError {
    #[error(
        "the camera is not measured: points were followed between only {pairs} pairs of frames, but {LEAST_PAIRS} are needed; record a drive among textured things, in light"
    )]
    Pairs { pairs: usize },
    #[error("the camera is not measured: frames and scans have no common solution")]
    NoSolution,
}

/// The motion of `base_link` from the first frame of a pair to the second.
fn base_motion(base: &BasePath<'_>, pair: &FramePair, latency_s: f64) -> Option<Pose2> {
    let from = base.at(pair.from_s - latency_s)?;
    let to = base.at(pair.to_s - latency_s)?;
    Some(from.inverse().compose(&to))
}

/// Frames, the known path, and the present errors of the motion between each two frames.
pub(super) struct CameraFit<'a> {
    pub camera: CameraModel,
    pub height_m: f64,
    pub base: &'a BasePath<'a>,
    /// The path by the scans alone, for derivatives by the latency: those of `base` hold the wheels' noise, which is in the residuals
    /// too and would shift the latency.
    pub quiet: &'a BasePath<'a>,
    pub pairs: &'a [FramePair],
    nuisances: Vec<Vector5<f64>>,
    /// Mean inverse distance in each band, and what is added to it, 1/m.
    inverse_m: [f64; BANDS],
    added: f64,
    /// Robust standard deviation of a point of each pair, pixels. A patch that was seen from nearer is followed less exactly.
    sigmas_px: Vec<f64>,
}

/// One point of a pair: residual and derivatives after its distance was eliminated.
struct Observation {
    residual: Vector2<f64>,
    parameters: SMatrix<f64, 2, PARAMETERS>,
    nuisances: SMatrix<f64, 2, NUISANCES>,
}

/// The motion of the camera between two frames, and its intrinsics.
#[derive(Debug, Clone, Copy)]
struct Motion {
    t_to_from: Pose3,
    focal: f64,
    /// The robot drove: distances of points show.
    drives: bool,
    /// Standard deviation of a point, pixels.
    sigma_px: f64,
}

impl<'a> CameraFit<'a> {
    pub fn new(
        camera: CameraModel,
        height_m: f64,
        [base, quiet]: [&'a BasePath<'a>; 2],
        pairs: &'a [FramePair],
    ) -> Self {
        let nuisances = vec![Vector5::zeros(); pairs.len()];
        let sigmas_px = vec![1.0; pairs.len()];
        let inverse_m = [INVERSE_DISTANCE[0]; BANDS];
        Self { camera, height_m, base, quiet, pairs, nuisances, inverse_m, added: 0.0, sigmas_px }
    }

    /// Fits the parameters.
    ///
    /// # Errors
    /// Too few pairs of frames, or no solution.
    pub fn estimate(&mut self, configured: &CameraParameters) -> Result<Estimate, CameraError> {
        if self.pairs.len() < LEAST_PAIRS {
            return Err(CameraError::Pairs { pairs: self.pairs.len() });
        }
        let mean = configured.to_vector();
        let prior = Prior { mean: mean.clone(), sigma: DVector::from_row_slice(&PLAUSIBLE) };
        let mut found = fit(self, &prior, &mean).ok_or(CameraError::NoSolution)?;
        self.added = DIFFERENT;
        let other = fit(self, &prior, &found.parameters).ok_or(CameraError::NoSolution)?;
        let change = other.parameters - &found.parameters;
        found.covariance.ger(1.0, &change, &change, 1.0);
        self.added = 0.0;
        // The errors of the motions are those of the first fit again.
        self.linearise(&found.parameters);
        self.add_bias_of_points(&mut found);
        self.add_bias_of_arcs(&mut found);
        Ok(found)
    }

    /// Adds what arcs may have in common: their paths bend a little more or less than the scans say. The place of the camera takes
    /// it up, and the focal length what that place does to rotations on the spot.
    fn add_bias_of_arcs(&self, found: &mut Estimate) {
        let place_m = BENT_M / ARC_RAD;
        let mut change = DVector::zeros(PARAMETERS);
        change[FORWARD] = place_m;
        change[FOCAL] = -place_m * self.inverse_m.iter().sum::<f64>() / BANDS as f64;
        found.covariance.ger(1.0, &change, &change, 1.0);
        found.covariance[(LEFT, LEFT)] += place_m * place_m;
    }

    /// Adds what points may have in common: an error of the image's motion during a rotation on the spot.
    fn add_bias_of_points(&self, found: &mut Estimate) {
        let share = LEAST_SIGMA_PX / (self.camera.fx * ROTATION_RAD);
        for parameter in [ROLL, PITCH, FOCAL] {
            found.covariance[(parameter, parameter)] += share * share;
        }
    }

    fn motion(
        &self,
        base: &BasePath<'_>,
        index: usize,
        at: &CameraParameters,
        errors: &Vector5<f64>,
    ) -> Option<Motion> {
        let pair = &self.pairs[index];
        let moved = base_motion(base, pair, at.latency_s)?;
        let wrong = Pose3::from_parts(
            Translation3::new(errors[3], errors[4], 0.0),
            UnitQuaternion::from_scaled_axis(Vector3::new(errors[0], errors[1], errors[2])),
        );
        let t_base_camera = at.mount(self.height_m);
        let t_from_to = t_base_camera.inverse() * moved.to_pose3() * wrong * t_base_camera;
        Some(Motion {
            t_to_from: t_from_to.inverse(),
            focal: at.focal,
            drives: moved.x_m.hypot(moved.y_m) > ON_THE_SPOT_M,
            sigma_px: self.sigmas_px[index],
        })
    }

    /// Standard deviations of the errors of a motion: rotations about x, y and z, and x and y.
    fn motion_sigma(&self, pair: &FramePair, latency_s: f64) -> Option<Vector5<f64>> {
        let moved = base_motion(self.base, pair, latency_s)?;
        let tilt_rad = TILT_RAD + TILT_RAD_PER_M * moved.x_m.hypot(moved.y_m);
        Some(Vector5::new(tilt_rad, tilt_rad, MOTION_RAD, MOTION_M, MOTION_M))
    }

    /// All points of a pair, linearised.
    fn observe(&self, index: usize, at: &CameraParameters) -> Option<Vec<Observation>> {
        let pair = &self.pairs[index];
        let errors = self.nuisances[index];
        let here = self.motion(self.base, index, at, &errors)?;
        let vector = at.to_vector();
        let mut moved = Vec::with_capacity(PARAMETERS + NUISANCES);
        for (parameter, step) in STEPS.into_iter().enumerate() {
            let base = if parameter == LATENCY { self.quiet } else { self.base };
            let mut vector = vector.clone();
            let before = self.motion(base, index, at, &errors)?;
            vector[parameter] += step;
            let at = CameraParameters::from_vector(&vector);
            moved.push([before, self.motion(base, index, &at, &errors)?]);
        }
        for nuisance in 0..NUISANCES {
            let mut errors = errors;
            errors[nuisance] += NUISANCE_STEP;
            moved.push([here, self.motion(self.base, index, at, &errors)?]);
        }
        let observations = pair.matches.iter();
        Some(observations.filter_map(|point| self.linearise_point(point, &here, &moved)).collect())
    }

    fn linearise_point(
        &self,
        point: &Match,
        here: &Motion,
        moved: &[[Motion; 2]],
    ) -> Option<Observation> {
        let fitted = self.distance(point, here)?;
        let mut observation = Observation {
            residual: fitted.residual,
            parameters: SMatrix::zeros(),
            nuisances: SMatrix::zeros(),
        };
        for (index, [before, after]) in moved.iter().enumerate() {
            let before = self.residual(point, before, fitted.inverse_m)?;
            let change = self.residual(point, after, fitted.inverse_m)? - before;
            // What a change of the distance undoes is no evidence.
            let free = change - fitted.slope * (fitted.slope.dot(&change) / fitted.stiffness);
            if index < PARAMETERS {
                observation.parameters.set_column(index, &(free / STEPS[index]));
            } else {
                observation.nuisances.set_column(index - PARAMETERS, &(free / NUISANCE_STEP));
            }
        }
        Some(observation)
    }

    /// The inverse distance with which a point fits best.
    fn distance(&self, point: &Match, motion: &Motion) -> Option<Fitted> {
        const STEP: f64 = 1e-5;
        // Without parallax a fitted distance would only explain noise, and the more of it the farther the camera is from the axle.
        let [mean, spread] = if motion.drives {
            INVERSE_DISTANCE
        } else {
            [self.inverse_m[self.band(point)] + self.added, FIXED]
        };
        let prior = (motion.sigma_px / spread).powi(2);
        let mut inverse_m = mean;
        let mut fitted = None;
        for _ in 0..4 {
            let residual = self.residual(point, motion, inverse_m)?;
            let slope = (self.residual(point, motion, inverse_m + STEP)? - residual) / STEP;
            let stiffness = slope.norm_squared() + prior;
            fitted = Some(Fitted { inverse_m, residual, slope, stiffness });
            inverse_m -= (slope.dot(&residual) + prior * (inverse_m - mean)) / stiffness;
        }
        fitted
    }

    fn band(&self, point: &Match) -> usize {
        let share = point.from[1] / self.camera.height as f64;
        ((share * BANDS as f64).max(0.0) as usize).min(BANDS - 1)
    }

    /// Averages the inverse distances in each band, from pairs between which the robot drove.
    fn average_distances(&mut self, at: &CameraParameters) {
        let mut sums = [[0.0; 2]; BANDS];
        for (index, pair) in self.pairs.iter().enumerate() {
            let Some(motion) = self.motion(self.base, index, at, &self.nuisances[index]) else {
                continue;
            };
            if !motion.drives {
                continue;
            }
            for point in &pair.matches {
                let Some(fitted) = self.distance(point, &motion) else { continue };
                let is_certain = motion.sigma_px < CERTAIN * fitted.stiffness.sqrt();
                let weight = Self::weight(&fitted.residual, motion.sigma_px).weight;
                if is_certain && weight > 0.0 {
                    let [sum, count] = &mut sums[self.band(point)];
                    *sum += fitted.inverse_m;
                    *count += 1.0;
                }
            }
        }
        let [sum, count] =
            sums.iter().fold([0.0; 2], |all, band| [all[0] + band[0], all[1] + band[1]]);
        if count < LEAST_IN_BAND {
            return;
        }
        let of_all = sum / count;
        for (mean, [sum, count]) in self.inverse_m.iter_mut().zip(sums) {
            *mean = if count < LEAST_IN_BAND { of_all } else { sum / count };
        }
    }

    /// Expected less observed position in the second frame, pixels.
    fn residual(&self, point: &Match, motion: &Motion, inverse_m: f64) -> Option<Vector2<f64>> {
        let camera = CameraModel {
            fx: self.camera.fx * motion.focal,
            fy: self.camera.fy * motion.focal,
            ..self.camera
        };
        let Motion { t_to_from, focal, .. } = motion;
        let rotated = t_to_from.rotation * self.ray(point.from, *focal);
        let there = rotated + t_to_from.translation.vector * inverse_m;
        let (u, v) = camera.project(&there.into())?;
        Some(Vector2::new(u - point.to[0], v - point.to[1]))
    }

    /// A point's robust weight.
    fn weight(residual: &Vector2<f64>, sigma_px: f64) -> Weight {
        tukey(residual.norm() / sigma_px)
    }

    /// Takes one step towards the errors of a motion that fit best.
    fn correct_motion(&mut self, index: usize, at: &CameraParameters) {
        let Some(observations) = self.observe(index, at) else { return };
        let Some(sigma) = self.motion_sigma(&self.pairs[index], at.latency_s) else { return };
        let reduced =
            Self::reduce(&observations, self.sigmas_px[index], &self.nuisances[index], &sigma);
        if let Some(inverse) = reduced.nuisance_hessian.try_inverse() {
            self.nuisances[index] -= inverse * reduced.nuisance_gradient;
        }
    }

    fn reduce(
        observations: &[Observation],
        sigma_px: f64,
        errors: &Vector5<f64>,
        sigma: &Vector5<f64>,
    ) -> Reduced {
        let prior = sigma.map(|sigma| 1.0 / (sigma * sigma));
        let mut sums = Reduced {
            hessian: SMatrix::zeros(),
            mixed: SMatrix::zeros(),
            gradient: SMatrix::zeros(),
            nuisance_hessian: Matrix5::from_diagonal(&prior),
            nuisance_gradient: prior.component_mul(errors),
            weights: 0.0,
            slopes: 0.0,
        };
        for observation in observations {
            let Weight { weight, slope } = Self::weight(&observation.residual, sigma_px);
            let scaled = weight / (sigma_px * sigma_px);
            let Observation { residual, parameters, nuisances } = observation;
            sums.hessian += parameters.transpose() * parameters * scaled;
            sums.mixed += parameters.transpose() * nuisances * scaled;
            sums.gradient += parameters.transpose() * residual * scaled;
            sums.nuisance_hessian += nuisances.transpose() * nuisances * scaled;
            sums.nuisance_gradient += nuisances.transpose() * residual * scaled;
            sums.weights += weight;
            sums.slopes += slope;
        }
        sums
    }

    /// The points below the horizon with their distances, from pairs between which the robot drove.
    pub fn low_points(&self, at: &CameraParameters) -> Vec<LowPoint> {
        let rotation = at.mount(self.height_m).rotation;
        let mut points = Vec::new();
        for (index, pair) in self.pairs.iter().enumerate() {
            let errors = &self.nuisances[index];
            let Some(motion) = self.motion(self.base, index, at, errors) else { continue };
            if !motion.drives {
                continue;
            }
            for point in &pair.matches {
                let down = -(rotation * self.ray(point.from, at.focal)).z;
                if down < LEAST_DOWN {
                    continue;
                }
                let Some(fitted) = self.distance(point, &motion) else { continue };
                if Self::weight(&fitted.residual, motion.sigma_px).weight > 0.0 {
                    let sigma = motion.sigma_px / fitted.stiffness.sqrt();
                    let inverse_m = fitted.inverse_m;
                    points.push(LowPoint { time_s: pair.to_s, down, inverse_m, sigma });
                }
            }
        }
        points
    }

    /// The direction behind a pixel, with z = 1.
    fn ray(&self, pixel: [f64; 2], focal: f64) -> Vector3<f64> {
        let ray = self.camera.ray(pixel[0], pixel[1]);
        Vector3::new(ray.x / focal, ray.y / focal, 1.0)
    }

    /// How far the points of a pair are from where they should be, pixels.
    fn distances_px(&self, index: usize, at: &CameraParameters) -> Vec<f64> {
        let Some(here) = self.motion(self.base, index, at, &self.nuisances[index]) else {
            return Vec::new();
        };
        let points = self.pairs[index].matches.iter();
        points.filter_map(|point| Some(self.distance(point, &here)?.residual.norm())).collect()
    }

    /// Robust standard deviation of all points at these parameters, pixels.
    pub fn spread_px(&self, at: &CameraParameters) -> f64 {
        let mut all = Vec::new();
        for index in 0..self.pairs.len() {
            all.extend(self.distances_px(index, at));
        }
        robust_sigma(&mut all).unwrap_or(LEAST_SIGMA_PX)
    }
}

/// A point with its best distance.
struct Fitted {
    inverse_m: f64,
    residual: Vector2<f64>,
    /// Derivative of the residual by the inverse distance.
    slope: Vector2<f64>,
    stiffness: f64,
}

/// Normal equations of a pair.
struct Reduced {
    hessian: SMatrix<f64, PARAMETERS, PARAMETERS>,
    mixed: SMatrix<f64, PARAMETERS, NUISANCES>,
    gradient: SMatrix<f64, PARAMETERS, 1>,
    nuisance_hessian: Matrix5<f64>,
    nuisance_gradient: Vector5<f64>,
    weights: f64,
    slopes: f64,
}

impl Reduced {
    /// Adds what is left for the parameters when the errors of the motion are free within their prior.
    fn add_to(&self, block: &mut Block) {
        let Some(inverse) = self.nuisance_hessian.try_inverse() else { return };
        let hessian = self.hessian - self.mixed * inverse * self.mixed.transpose();
        let gradient = self.gradient - self.mixed * inverse * self.nuisance_gradient;
        block.hessian += DMatrix::from_column_slice(PARAMETERS, PARAMETERS, hessian.as_slice());
        block.gradient += DVector::from_column_slice(gradient.as_slice());
        block.weights += self.weights;
        block.slopes += self.slopes;
    }
}

impl Model for CameraFit<'_> {
    fn linearise(&mut self, parameters: &DVector<f64>) -> Vec<Block> {
        let at = CameraParameters::from_vector(parameters);
        let last_s = self.pairs.last().map_or(0.0, |pair| pair.to_s);
        let mut blocks = vec![Block::empty(PARAMETERS); (last_s / BLOCK_S) as usize + 1];
        self.average_distances(&at);
        for index in 0..self.pairs.len() {
            let mut distances_px = self.distances_px(index, &at);
            let sigma_px = robust_sigma(&mut distances_px).unwrap_or(LEAST_SIGMA_PX);
            self.sigmas_px[index] = sigma_px.max(LEAST_SIGMA_PX);
            self.correct_motion(index, &at);
            let Some(observations) = self.observe(index, &at) else { continue };
            let pair = &self.pairs[index];
            let Some(sigma) = self.motion_sigma(pair, at.latency_s) else { continue };
            let reduced =
                Self::reduce(&observations, self.sigmas_px[index], &self.nuisances[index], &sigma);
            reduced.add_to(&mut blocks[(pair.to_s.max(0.0) / BLOCK_S) as usize]);
        }
        blocks
    }
}

#[cfg(test)]
mod tests {
    use super::super::laser_parameters::LaserParameters;
    use super::super::scan_path::ScanPose;
    use super::super::wheels::{WheelGeometry, WheelPath};
    use super::*;
    use hal::Twist2;
    use nalgebra::Point3;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const HEIGHT_M: f64 = 0.8;

    fn camera() -> CameraModel {
        CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2)
    }

    fn truth() -> CameraParameters {
        CameraParameters {
            roll_rad: 0.03,
            pitch_down_rad: -0.04,
            yaw_rad: 0.05,
            x_m: 0.02,
            y_m: -0.03,
            focal: 1.015,
            latency_s: 0.06,
        }
    }

    /// Velocities, each for two seconds.
    fn twist(second: f64) -> Twist2 {
        let parts = [(0.3, 0.0), (0.0, 0.6), (0.3, 0.4), (0.0, -0.6), (0.3, -0.4), (0.3, 0.0)];
        let (linear_mps, angular_radps) = parts[(second / 2.0) as usize % parts.len()];
        Twist2 { linear_mps, angular_radps }
    }

    /// True poses ten times a second for a minute. Velocities change only between them.
    fn poses() -> Vec<Pose2> {
        let mut poses = vec![Pose2::IDENTITY];
        for step in 0..600 {
            let moved = twist(0.1 * f64::from(step)).integrate(0.1);
            poses.push(poses[poses.len() - 1].compose(&moved));
        }
        poses
    }

    /// Random points around the robot, and where two frames show them.
    fn pair(from: usize, to: usize, poses: &[Pose2], rng: &mut Pcg64Mcg) -> FramePair {
        let mount = truth().mount(HEIGHT_M);
        let model = camera();
        let focal = model.fx * truth().focal;
        let true_model = CameraModel { fx: focal, fy: focal, ..model };
        let mut matches = Vec::new();
        while matches.len() < 60 {
            let [u, v] = [rng.random_range(10.0..630.0), rng.random_range(10.0..182.0)];
            let point = true_model.unproject(u, v, rng.random_range(1.0..6.0));
            let in_world = poses[from].to_pose3() * mount * point;
            let there: Point3<f64> = (poses[to].to_pose3() * mount).inverse() * in_world;
            let Some((u2, v2)) = true_model.project(&there) else { continue };
            if (0.0..640.0).contains(&u2) && (0.0..192.0).contains(&v2) {
                matches.push(Match { from: [u, v], to: [u2, v2] });
            }
        }
        FramePair { from_s: stamp(from), to_s: stamp(to), matches }
    }

    fn stamp(index: usize) -> f64 {
        0.1 * index as f64 + truth().latency_s
    }

    #[test]
    fn mount_focal_length_and_latency_are_found_from_exact_points() {
        let poses = poses();
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let pairs: Vec<_> =
            (0..190).map(|index| pair(3 * index, 3 * index + 3, &poses, &mut rng)).collect();
        let mut wheels = WheelPath::default();
        let mut scans = Vec::new();
        for (index, pose) in poses.iter().enumerate() {
            let time_s = 0.1 * index as f64;
            wheels.push(time_s, pose, 0.24);
            scans.push(ScanPose { time_s, pose: *pose, matched: true });
        }
        let known = LaserParameters {
            wheels: WheelGeometry { scale: [1.0, 1.0], track_m: 0.24 },
            t_base_laser: Pose2::IDENTITY,
            latency_s: 0.0,
        };
        let base = BasePath::new(&wheels, &scans, &known);
        let mut fit = CameraFit::new(camera(), HEIGHT_M, [&base, &base], &pairs);
        let configured = CameraParameters::configured(&hal::camera_mount(0.0, HEIGHT_M, 0.0));
        let found = fit.estimate(&configured).unwrap();
        let error = &found.parameters - truth().to_vector();
        let largest = [1e-3, 1e-3, 1e-3, 0.01, 0.01, 3e-3, 2e-3];
        for (index, largest) in largest.into_iter().enumerate() {
            assert!(error[index].abs() < largest, "{index}: {error}");
        }
    }
}
