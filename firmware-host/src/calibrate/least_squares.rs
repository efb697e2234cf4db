//! Robust least squares of a few parameters, with standard deviations that hold for correlated residuals.
//!
//! Gauss-Newton with Tukey's biweight, whose width follows the residuals' median. Neighbouring residuals share a scan, a keyframe
//! or a bump of the floor. Observations are therefore gathered in blocks of time, and the covariance is that of the blocks'
//! gradients (the "sandwich" for clusters of Liang and Zeger 1986), but never less than that of independent residuals.

use nalgebra::{DMatrix, DVector};

/// Width of Tukey's biweight in standard deviations: 95 % as efficient as least squares when residuals are normal.
const TUKEY_WIDTH: f64 = 4.685;
/// The median of absolute normal residuals is this many times smaller than their standard deviation.
const MEDIAN_TO_SIGMA: f64 = 1.4826;
/// Steps that are smaller than this share of every standard deviation end the iterations.
const AT_REST: f64 = 0.01;
const MAX_ITERATIONS: usize = 60;

/// The linearised observations of one block of time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Block {
    /// Sum of `w J^T J`, with weights `w` that include the inverse variance.
    pub hessian: DMatrix<f64>,
    /// Sum of `w J^T r`.
    pub gradient: DVector<f64>,
    /// Sums of the robust weights and of the slopes of the influence function, each 1 for a residual of 0.
    pub weights: f64,
    pub slopes: f64,
}

impl Block {
    /// A block without observations.
    pub fn empty(parameters: usize) -> Self {
        Self {
            hessian: DMatrix::zeros(parameters, parameters),
            gradient: DVector::zeros(parameters),
            weights: 0.0,
            slopes: 0.0,
        }
    }

    /// Adds one observation with its Jacobian and its standard deviation.
    pub fn add(&mut self, jacobian: &DVector<f64>, residual: f64, sigma: f64) {
        let Weight { weight, slope } = tukey(residual / sigma);
        let scaled = weight / (sigma * sigma);
        self.hessian.ger(scaled, jacobian, jacobian, 1.0);
        self.gradient.axpy(scaled * residual, jacobian, 1.0);
        self.weights += weight;
        self.slopes += slope;
    }
}

/// Tukey's biweight of a normalised residual, and the slope of its influence function there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Weight {
    pub weight: f64,
    pub slope: f64,
}

pub(super) fn tukey(normalised: f64) -> Weight {
    let square = (normalised / TUKEY_WIDTH).powi(2);
    if square >= 1.0 {
        return Weight { weight: 0.0, slope: 0.0 };
    }
    Weight { weight: (1.0 - square).powi(2), slope: (1.0 - square) * (1.0 - 5.0 * square) }
}

/// Robust standard deviation of residuals around 0. `None` without residuals.
pub(super) fn robust_sigma(residuals: &mut [f64]) -> Option<f64> {
    residuals.iter_mut().for_each(|residual| *residual = residual.abs());
    let middle = residuals.len() / 2;
    if residuals.is_empty() {
        return None;
    }
    let (_, median, _) = residuals.select_nth_unstable_by(middle, f64::total_cmp);
    Some(MEDIAN_TO_SIGMA * *median)
}

/// A model with observations.
pub(super) trait Model {
    /// The observations, linearised at `parameters`, gathered in blocks of time.
    fn linearise(&mut self, parameters: &DVector<f64>) -> Vec<Block>;
}

/// What is known of the parameters without any observation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Prior {
    pub mean: DVector<f64>,
    /// How far the parameters may plausibly be from their means.
    pub sigma: DVector<f64>,
}

/// The parameters that fit best.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Estimate {
    pub parameters: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

impl Estimate {
    /// Standard deviation of one parameter.
    pub fn sigma(&self, index: usize) -> f64 {
        self.covariance[(index, index)].max(0.0).sqrt()
    }
}

/// Fits `model`, starting at `start`. `None` when the equations have no finite solution.
pub(super) fn fit(model: &mut impl Model, prior: &Prior, start: &DVector<f64>) -> Option<Estimate> {
    let information = DMatrix::from_diagonal(&prior.sigma.map(|sigma| 1.0 / (sigma * sigma)));
    let mut parameters = start.clone();
    for _ in 0..MAX_ITERATIONS {
        let blocks = model.linearise(&parameters);
        let hessian = blocks.iter().fold(information.clone(), |sum, block| sum + &block.hessian);
        let pull = &information * (&parameters - &prior.mean);
        let gradient = blocks.iter().fold(pull, |sum, block| sum + &block.gradient);
        let inverse = hessian.cholesky()?.inverse();
        let step = -(&inverse * gradient);
        if !step.iter().all(|change| change.is_finite()) {
            return None;
        }
        parameters += &step;
        if (0..step.len()).all(|index| step[index].abs() < AT_REST * inverse[(index, index)].sqrt())
        {
            break;
        }
    }
    let covariance = covariance(&model.linearise(&parameters), &information)?;
    Some(Estimate { parameters, covariance })
}

/// The covariance by the gradients of the blocks. For each parameter it is at least that of independent residuals.
fn covariance(blocks: &[Block], information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let weights: f64 = blocks.iter().map(|block| block.weights).sum();
    let slopes: f64 = blocks.iter().map(|block| block.slopes).sum();
    // The second derivative of a robust cost is smaller than its weights say.
    let shrink = if slopes > 0.0 { (slopes / weights).min(1.0) } else { 1.0 };
    let sum = blocks.iter().fold(0.0 * information, |sum, block| sum + &block.hessian);
    let bread = (shrink * sum + information).cholesky()?.inverse();
    let used = blocks.iter().filter(|block| block.weights > 0.0).count() as f64;
    let small_sample = if used > 1.0 { used / (used - 1.0) } else { 1.0 };
    let mut meat = information.clone();
    for block in blocks {
        meat.ger(small_sample, &block.gradient, &block.gradient, 1.0);
    }
    let mut covariance = &bread * meat * &bread;
    for index in 0..covariance.nrows() {
        let raise = (bread[(index, index)] / covariance[(index, index)].max(1e-300)).sqrt();
        if raise > 1.0 {
            covariance.row_mut(index).scale_mut(raise);
            covariance.column_mut(index).scale_mut(raise);
        }
    }
    Some(covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// `y = a + b x`, some observations of which are wrong.
    struct Line {
        points: Vec<[f64; 2]>,
        block: usize,
    }

    fn residual(parameters: &DVector<f64>, [x, y]: &[f64; 2]) -> f64 {
        parameters[0] + parameters[1] * x - y
    }

    impl Model for Line {
        fn linearise(&mut self, parameters: &DVector<f64>) -> Vec<Block> {
            let mut residuals: Vec<f64> =
                self.points.iter().map(|point| residual(parameters, point)).collect();
            let sigma = robust_sigma(&mut residuals).unwrap();
            let blocks = self.points.chunks(self.block).map(|points| {
                let mut block = Block::empty(2);
                for point in points {
                    let jacobian = DVector::from_vec(vec![1.0, point[0]]);
                    block.add(&jacobian, residual(parameters, point), sigma);
                }
                block
            });
            blocks.collect()
        }
    }

    fn prior() -> Prior {
        Prior { mean: DVector::zeros(2), sigma: DVector::from_element(2, 100.0) }
    }

    /// Points of `1 + 2 x` whose noise stays the same over `alike` neighbours.
    fn points(rng: &mut Pcg64Mcg, alike: usize) -> Vec<[f64; 2]> {
        let mut noise = 0.0;
        (0..400)
            .map(|index: usize| {
                if index.is_multiple_of(alike) {
                    noise = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                }
                let x = (0.37 * index as f64).sin();
                [x, 1.0 + 2.0 * x + noise]
            })
            .collect()
    }

    #[test]
    fn a_tenth_of_wild_observations_changes_nothing() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut points = points(&mut rng, 1);
        points.iter_mut().step_by(10).for_each(|point| point[1] += 50.0);
        let start = DVector::zeros(2);
        let found = fit(&mut Line { points, block: 20 }, &prior(), &start).unwrap();
        assert!((found.parameters[0] - 1.0).abs() < 0.2, "{}", found.parameters);
        assert!((found.parameters[1] - 2.0).abs() < 0.3, "{}", found.parameters);
    }

    #[test]
    fn standard_deviations_cover_the_truth_with_independent_and_with_correlated_noise() {
        for alike in [1, 10] {
            let mut rng = Pcg64Mcg::seed_from_u64(7);
            let mut covered = 0;
            for _ in 0..300 {
                let mut line = Line { points: points(&mut rng, alike), block: 20 };
                let found = fit(&mut line, &prior(), &DVector::zeros(2)).unwrap();
                covered += usize::from((found.parameters[0] - 1.0).abs() < 2.0 * found.sigma(0));
            }
            // 95.4 % of 300 are 286; twenty blocks and their spread allow for less.
            assert!((270..=298).contains(&covered), "{covered} of 300 with {alike} alike");
        }
    }

    #[test]
    fn a_parameter_without_evidence_keeps_its_prior() {
        let points = vec![[0.0, 3.0], [0.0, 3.1], [0.0, 2.9], [0.0, 3.05]];
        let found = fit(&mut Line { points, block: 2 }, &prior(), &DVector::zeros(2)).unwrap();
        assert!((found.parameters[0] - 3.0).abs() < 0.1);
        assert!(found.parameters[1].abs() < 1e-9 && (found.sigma(1) - 100.0).abs() < 1e-6);
    }

    #[test]
    fn the_biweight_is_one_at_zero_and_ends_at_its_width() {
        assert_eq!(tukey(0.0), Weight { weight: 1.0, slope: 1.0 });
        assert_eq!(tukey(-5.0), Weight { weight: 0.0, slope: 0.0 });
    }
}
