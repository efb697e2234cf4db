//! Wheels and scanner together: wheel radii, track, the scanner's place and its latency.
//!
//! The structure of Censi, Franchi, Marchionni and Oriolo 2013 ("Simultaneous calibration of odometry and sensor parameters for
//! mobile robots"): over a span of the drive, the scanner's motion by matched scans must be that of the wheels, seen from where
//! the scanner is mounted. Two differences: the latency is a parameter too, and the spans of the yaw are shorter than those of
//! the translation, because noise of the wheels dominates the former and noise of the scans the latter. The translation takes
//! its yaw from the scans, so that noise of the wheels' yaw does not enter it.

use hal::{Pose2, wrap_angle};
use nalgebra::DVector;

use super::drive::Drive;
use super::laser_parameters::LaserParameters;
use super::least_squares::{Block, Estimate, Model, Prior, fit, robust_sigma};
use super::scan_path::{ScanPose, laser_motion, match_scans};
use super::span_noise::{Extent, SpanNoise};
use super::wheels::WheelPath;

/// Number of parameters, in this order: radius left and right (share of the configured), track (m), the scanner's x, y (m) and
/// yaw (rad), its latency (s).
pub(super) const PARAMETERS: usize = 7;
/// Index of the latency.
pub(super) const LATENCY: usize = 6;
/// Step of the numerical derivatives: shares, metres, radians and seconds alike.
const STEP: f64 = 1e-4;
/// No scanner matches better than this: a tenth of a millimetre and of a milliradian. It keeps weights finite.
const LEAST_SIGMA: f64 = 1e-4;
/// Plausible deviations from the configuration. What the drive says nothing about stays within them.
const PLAUSIBLE: [f64; 2] = [0.2, 0.2];
const PLAUSIBLE_TRACK: f64 = 0.3;
const PLAUSIBLE_PLACE_M: f64 = 0.3;
const PLAUSIBLE_YAW_RAD: f64 = 0.5;
const PLAUSIBLE_LATENCY_S: f64 = 0.2;
/// A span ends when the robot has driven or rotated this far, metres or radians. In short spans the latency shows; in long ones
/// the noise of a match (some 2 mm) is small against the motion.
const YAW_SPAN: f64 = 0.08;
const TRANSLATION_SPAN: f64 = 0.3;
/// A robot that drove less than this stays where it is, metres: ten times the noise of a match.
const LEAST_DISTANCE_M: f64 = 0.02;
/// A span that takes longer includes a stop, seconds. Spans of a robot that stands say nothing.
const LONGEST_SPAN_S: f64 = 3.0;
/// Length of a block of time, seconds: several times longer than what neighbouring matches have in common.
const BLOCK_S: f64 = 4.0;
/// Scans are matched again with better starts, because a match is drawn a little to where it began. In each round the residuals
/// count as this many times more uncertain than they are: a robust fit that trusts them too early keeps a wrong latency, with
/// which most spans agree already.
const ROUNDS: [f64; 4] = [10.0, 3.0, 1.0, 1.0];
/// What the latency is off by in every drive, however long, seconds; probably because the wheels are known once a tick, and their
/// speeds count as constant between ticks. It is fitted to drives of ten minutes by ten simulated robots.
const COMMON_LATENCY_S: f64 = 0.0007;
/// Fewer spans than this are no drive.
const LEAST_SPANS: usize = 30;

/// Two scans and the motion between them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Span {
    from_s: f64,
    to_s: f64,
    /// Motion of the scanner in its own frame.
    moved: Pose2,
    /// Yaw of the motion, not wrapped.
    yaw_rad: f64,
    extent: Extent,
}

/// What is compared over a span. Along the robot's heading the wheels' noise counts, across it only that of the scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compared {
    Yaw,
    Along,
    Across,
}

/// Robust deviations between scans and wheels. What is left, and what it was with the configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residuals {
    /// Of the yaw over a short span, radians.
    pub yaw_rad: f64,
    /// Of the translation over a long span, metres.
    pub translation_m: f64,
}

/// The result for wheels and scanner.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LaserResult {
    pub estimate: Estimate,
    pub parameters: LaserParameters,
    /// The scanner's path with which it was found.
    pub path: Vec<ScanPose>,
    pub before: Residuals,
    pub after: Residuals,
    /// Compared spans: of the yaw, and of the translation.
    pub spans: [usize; 2],
}

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LaserError {
    #[error(transparent)]
    Scanner(#[from] runtime::localization::LocalizationError),
    #[error(
        "only {spans} spans of the drive can be compared, but {LEAST_SPANS} are needed: the robot hardly moved, or its scans do not fit together; record a minute in which it drives and rotates among walls"
    )]
    Spans { spans: usize },
    #[error(
        "wheels and scans have no common solution; check that the wheels are not swapped or inverted (`firmware-host init --turn-wheels`)"
    )]
    NoSolution,
}

/// Estimates the parameters of wheels and scanner from a drive.
///
/// # Errors
/// Too little motion, scans that do not fit together, or no solution.
pub(super) fn estimate(drive: &Drive) -> Result<LaserResult, LaserError> {
    let configured = LaserParameters::configured(&drive.configured);
    let prior = prior(&configured);
    let mut parameters = configured;
    let mut last = None;
    for widened in ROUNDS {
        let path = match_scans(drive, &parameters)?;
        let mut spans = Spans::new(&drive.wheels, &path, &parameters);
        spans.widened = widened;
        let count = spans.yaw.len().min(spans.translation.len());
        if count < LEAST_SPANS {
            return Err(LaserError::Spans { spans: count });
        }
        let mut estimate =
            fit(&mut spans, &prior, &parameters.to_vector()).ok_or(LaserError::NoSolution)?;
        estimate.covariance[(LATENCY, LATENCY)] += COMMON_LATENCY_S * COMMON_LATENCY_S;
        parameters = LaserParameters::from_vector(&estimate.parameters);
        last = Some(LaserResult {
            before: spans.residuals(&configured),
            after: spans.residuals(&parameters),
            spans: [spans.yaw.len(), spans.translation.len()],
            estimate,
            parameters,
            path,
        });
    }
    last.ok_or(LaserError::NoSolution)
}

fn prior(configured: &LaserParameters) -> Prior {
    let [left, right] = PLAUSIBLE;
    let track_m = PLAUSIBLE_TRACK * configured.wheels.track_m;
    let place = PLAUSIBLE_PLACE_M;
    let sigma = vec![left, right, track_m, place, place, PLAUSIBLE_YAW_RAD, PLAUSIBLE_LATENCY_S];
    Prior { mean: configured.to_vector(), sigma: DVector::from_vec(sigma) }
}

/// The spans of a drive.
struct Spans<'a> {
    wheels: &'a WheelPath,
    /// What the wheels would report without noise, by the scans. Derivatives are taken there: those of the wheels' own path hold the
    /// noise of the residuals, which makes every rotation look too large (regression dilution) and shifts the latency.
    quiet: WheelPath,
    yaw: Vec<Span>,
    translation: Vec<Span>,
    /// How many times more uncertain residuals count than they are.
    widened: f64,
}

impl<'a> Spans<'a> {
    /// `parameters` only say where spans end and how the yaw is unwrapped.
    fn new(wheels: &'a WheelPath, path: &[ScanPose], parameters: &LaserParameters) -> Self {
        let quiet = quiet(path, parameters);
        let cut = |length| cut(wheels, &quiet, path, parameters, length);
        let yaw = cut(YAW_SPAN);
        let translation = cut(TRANSLATION_SPAN);
        Self { wheels, quiet, yaw, translation, widened: 1.0 }
    }

    fn spans(&self, compared: Compared) -> &[Span] {
        match compared {
            Compared::Yaw => &self.yaw,
            Compared::Along | Compared::Across => &self.translation,
        }
    }

    /// By how much the wheels say more than the scans.
    fn residual(&self, compared: Compared, span: &Span, parameters: &LaserParameters) -> f64 {
        residual(self.wheels, compared, span, parameters)
    }

    /// All residuals.
    fn all(&self, compared: Compared, parameters: &LaserParameters) -> Vec<f64> {
        let spans = self.spans(compared).iter();
        spans.map(|span| self.residual(compared, span, parameters)).collect()
    }

    /// Adds all residuals.
    fn add(&self, compared: Compared, parameters: &DVector<f64>, blocks: &mut [Block]) {
        let residuals = self.all(compared, &LaserParameters::from_vector(parameters));
        let spans = self.spans(compared);
        let extents: Vec<Extent> = spans.iter().map(|span| span.extent).collect();
        let noise = SpanNoise::estimate(&residuals, &extents);
        for (span, residual) in spans.iter().zip(residuals) {
            let sigma = noise.map_or(0.0, |noise| noise.sigma(&span.extent));
            let sigma = self.widened * sigma.max(LEAST_SIGMA);
            let jacobian = self.derivative(compared, span, parameters);
            blocks[span.block()].add(&jacobian, residual, sigma);
        }
    }

    /// Central differences of a residual.
    fn derivative(
        &self,
        compared: Compared,
        span: &Span,
        parameters: &DVector<f64>,
    ) -> DVector<f64> {
        // Where the robot stays, the noise of the scans would be all of the derivative, and it is in the residual as well: every
        // rotation on the spot would make the wheels a little larger.
        let [_, distance_m, _] = span.extent;
        let stays = compared != Compared::Yaw && distance_m < LEAST_DISTANCE_M;
        let path = if stays { self.wheels } else { &self.quiet };
        let mut gradient = DVector::zeros(PARAMETERS);
        for index in 0..PARAMETERS {
            let mut residuals = [0.0; 2];
            for (change_of, change) in residuals.iter_mut().zip([STEP, -STEP]) {
                let mut moved = parameters.clone();
                moved[index] += change;
                let moved = LaserParameters::from_vector(&moved);
                *change_of = residual(path, compared, span, &moved);
            }
            gradient[index] = (residuals[0] - residuals[1]) / (2.0 * STEP);
        }
        gradient
    }

    /// The robust deviation over all spans.
    fn deviation(&self, compared: &[Compared], parameters: &LaserParameters) -> f64 {
        let mut all = Vec::new();
        for compared in compared {
            all.extend(self.all(*compared, parameters));
        }
        robust_sigma(&mut all).unwrap_or(0.0)
    }

    fn residuals(&self, parameters: &LaserParameters) -> Residuals {
        Residuals {
            yaw_rad: self.deviation(&[Compared::Yaw], parameters),
            translation_m: self.deviation(&[Compared::Along, Compared::Across], parameters),
        }
    }
}

/// By how much a path of wheels says more than the scans over a span.
fn residual(
    path: &WheelPath,
    compared: Compared,
    span: &Span,
    parameters: &LaserParameters,
) -> f64 {
    let times_s = [span.from_s, span.to_s].map(|time_s| time_s - parameters.latency_s);
    let [from_s, to_s] = times_s;
    let wheels = &parameters.wheels;
    if compared == Compared::Yaw {
        return path.motion(wheels, from_s, to_s).yaw_rad - span.yaw_rad;
    }
    let moved = path.motion_with_yaw(wheels, from_s, to_s, span.yaw_rad);
    let expected = laser_motion(&moved, &parameters.t_base_laser);
    let [x_m, y_m] = [expected.x_m - span.moved.x_m, expected.y_m - span.moved.y_m];
    // From the scanner's axes to those of the robot.
    let (sin, cos) = parameters.t_base_laser.yaw_rad.sin_cos();
    match compared {
        Compared::Along => cos * x_m - sin * y_m,
        _ => sin * x_m + cos * y_m,
    }
}

/// The reports of wheels that drove exactly as the scans say.
pub(super) fn quiet(path: &[ScanPose], parameters: &LaserParameters) -> WheelPath {
    let LaserParameters { wheels, t_base_laser, latency_s } = parameters;
    let to_base = t_base_laser.inverse();
    let mut quiet = WheelPath::default();
    for scan in path {
        let pose = t_base_laser.compose(&scan.pose).compose(&to_base);
        quiet.push(scan.time_s - latency_s, &pose, wheels.track_m);
    }
    quiet.reported_with(wheels.scale)
}

/// Cuts the path into spans of at least this length, metres or radians.
fn cut(
    wheels: &WheelPath,
    quiet: &WheelPath,
    path: &[ScanPose],
    parameters: &LaserParameters,
    length: f64,
) -> Vec<Span> {
    let mut spans = Vec::new();
    let Some(mut from) = path.first() else { return spans };
    let mut last = from;
    let mut yaw_rad = 0.0;
    for scan in &path[1..] {
        let step_rad = wrap_angle(scan.pose.yaw_rad - last.pose.yaw_rad);
        let is_broken = !scan.matched || scan.time_s - from.time_s > LONGEST_SPAN_S;
        last = scan;
        if is_broken {
            from = scan;
            yaw_rad = 0.0;
            continue;
        }
        yaw_rad += step_rad;
        let times_s = [from.time_s, scan.time_s].map(|time_s| time_s - parameters.latency_s);
        let motion = wheels.motion(&parameters.wheels, times_s[0], times_s[1]);
        if motion.distance_m + motion.rotation_rad < length {
            continue;
        }
        let motion = quiet.motion(&parameters.wheels, times_s[0], times_s[1]);
        spans.push(Span {
            from_s: from.time_s,
            to_s: scan.time_s,
            moved: from.pose.inverse().compose(&scan.pose),
            yaw_rad,
            extent: [1.0, motion.distance_m, motion.rotation_rad],
        });
        from = scan;
        yaw_rad = 0.0;
    }
    spans
}

impl Model for Spans<'_> {
    fn linearise(&mut self, parameters: &DVector<f64>) -> Vec<Block> {
        let last_s = self.yaw.iter().chain(&self.translation).map(|span| span.to_s);
        let blocks = (last_s.fold(0.0, f64::max) / BLOCK_S) as usize + 1;
        let mut blocks = vec![Block::empty(PARAMETERS); blocks];
        for compared in [Compared::Yaw, Compared::Along, Compared::Across] {
            self.add(compared, parameters, &mut blocks);
        }
        blocks
    }
}

impl Span {
    fn block(&self) -> usize {
        (self.to_s.max(0.0) / BLOCK_S) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::super::drive::Configured;
    use super::super::wheels::WheelGeometry;
    use super::*;
    use hal::Twist2;

    const CONFIGURED: Configured =
        Configured { wheel_radius_m: 0.05, track_m: 0.24, t_base_laser: Pose2::IDENTITY };

    fn truth() -> LaserParameters {
        LaserParameters {
            wheels: WheelGeometry { scale: [1.03, 0.98], track_m: 0.255 },
            t_base_laser: Pose2::new(0.12, -0.02, 0.06),
            latency_s: 0.05,
        }
    }

    /// Velocities of the drive, each for a second and a half.
    fn twist(second: f64) -> Twist2 {
        let [forward, left, arc, right] = [(0.3, 0.0), (0.0, 0.8), (0.2, 0.4), (0.0, -0.8)]
            .map(|(linear_mps, angular_radps)| Twist2 { linear_mps, angular_radps });
        let parts = [forward, left, arc, right, forward, right, arc, left];
        parts[(second / 1.5) as usize % parts.len()]
    }

    const STEP_S: f64 = 0.01;

    /// True poses every hundredth of a second for a minute.
    fn true_path() -> Vec<Pose2> {
        let mut poses = vec![Pose2::IDENTITY];
        for step in 0..6000 {
            let moved = twist(STEP_S * f64::from(step)).integrate(STEP_S);
            poses.push(poses[poses.len() - 1].compose(&moved));
        }
        poses
    }

    /// What the wheels of the true robot report, as it is configured.
    fn reports() -> WheelPath {
        let LaserParameters { wheels: WheelGeometry { scale, track_m }, .. } = truth();
        let mut odom = Pose2::IDENTITY;
        let mut path = WheelPath::default();
        for step in 0..6000 {
            let time_s = STEP_S * f64::from(step);
            path.push(time_s, &odom, CONFIGURED.track_m);
            let Twist2 { linear_mps, angular_radps } = twist(time_s);
            let side_mps = 0.5 * angular_radps * track_m;
            let left_mps = (linear_mps - side_mps) / scale[0];
            let right_mps = (linear_mps + side_mps) / scale[1];
            let believed = Twist2 {
                linear_mps: 0.5 * (left_mps + right_mps),
                angular_radps: (right_mps - left_mps) / CONFIGURED.track_m,
            };
            odom = odom.compose(&believed.integrate(STEP_S));
        }
        path
    }

    /// Where the scanner was, ten times a second.
    fn scans() -> Vec<ScanPose> {
        let LaserParameters { t_base_laser, latency_s, .. } = truth();
        let path = true_path();
        let start = path[0].compose(&t_base_laser);
        (0..600)
            .map(|index: usize| {
                let pose = path[10 * index].compose(&t_base_laser);
                ScanPose {
                    time_s: 0.1 * index as f64 + latency_s,
                    pose: start.inverse().compose(&pose),
                    matched: true,
                }
            })
            .collect()
    }

    #[test]
    fn wheels_scanner_and_latency_are_found_from_paths_without_noise() {
        let wheels = reports();
        let configured = LaserParameters::configured(&CONFIGURED);
        let mut parameters = configured.to_vector();
        for widened in ROUNDS {
            let at = LaserParameters::from_vector(&parameters);
            let mut spans = Spans::new(&wheels, &scans(), &at);
            spans.widened = widened;
            parameters = fit(&mut spans, &prior(&configured), &parameters).unwrap().parameters;
        }
        let error = &parameters - truth().to_vector();
        let largest = [1e-3, 1e-3, 3e-4, 1e-3, 1e-3, 1e-3, 1e-3];
        for (index, largest) in largest.into_iter().enumerate() {
            assert!(error[index].abs() < largest, "{index}: {error}");
        }
    }

    #[test]
    fn a_straight_drive_does_not_show_track_and_place_of_the_scanner() {
        let mut wheels = WheelPath::default();
        let mut scans = Vec::new();
        for index in 0..600 {
            let time_s = 0.1 * f64::from(index);
            let pose = Pose2::new(0.3 * time_s, 0.0, 0.0);
            wheels.push(time_s, &pose, CONFIGURED.track_m);
            scans.push(ScanPose { time_s, pose, matched: true });
        }
        let configured = LaserParameters::configured(&CONFIGURED);
        let mut spans = Spans::new(&wheels, &scans, &configured);
        let found = fit(&mut spans, &prior(&configured), &configured.to_vector()).unwrap();
        for (index, least_sigma) in [(2, 0.05), (3, 0.1), (4, 0.1)] {
            assert!(found.sigma(index) > least_sigma, "{index}: {}", found.sigma(index));
        }
        assert!(found.sigma(0) < 0.01 && found.sigma(1) < 0.01);
    }
}
