//! Logistic regression of the probability that a depth is right.

use anyhow::{Context, Result};
use nalgebra::{SMatrix, SVector};

/// Samples: `N` features, whether the depth was right, and a weight.
#[derive(Debug, Clone, Default)]
pub struct Samples<const N: usize> {
    rows: Vec<([f32; N], bool, f32)>,
}

impl<const N: usize> Samples<N> {
    /// Adds a sample of weight 1.
    pub fn add(&mut self, features: [f32; N], right: bool) {
        self.rows.push((features, right, 1.0));
    }

    /// Adds the samples of one sequence, weighted so that every sequence counts the same.
    pub fn add_sequence(&mut self, mut sequence: Self) {
        let weight = 1e4 / sequence.rows.len().max(1) as f32;
        sequence.rows.iter_mut().for_each(|row| row.2 = weight);
        self.rows.append(&mut sequence.rows);
    }

    /// The weights of the logistic model with the highest posterior probability, by Newton's method, with a weak prior around
    /// 0.
    ///
    /// # Errors
    /// When the samples do not determine the weights.
    pub fn fit(&self) -> Result<[f64; N]> {
        let mut weights = SVector::<f64, N>::zeros();
        for _ in 0..25 {
            let mut hessian = SMatrix::<f64, N, N>::identity() * 1e-2;
            let mut gradient = -weights * 1e-2;
            for (features, right, weight) in &self.rows {
                let x = SVector::<f64, N>::from_fn(|i, _| f64::from(features[i]));
                let p = 1.0 / (1.0 + (-weights.dot(&x)).exp());
                gradient += x * (f64::from(u8::from(*right)) - p) * f64::from(*weight);
                hessian += x * x.transpose() * (p * (1.0 - p) * f64::from(*weight)).max(1e-12);
            }
            weights +=
                hessian.cholesky().context("the features are linearly dependent")?.solve(&gradient);
        }
        Ok(weights.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_that_generated_the_samples_is_found() {
        let mut samples = Samples::<2>::default();
        for index in 0..20_000_u32 {
            let x = (index % 100) as f32 / 50.0 - 1.0;
            let p = 1.0 / (1.0 + (-(0.5 + 2.0 * x)).exp());
            let die = (index.wrapping_mul(2_654_435_761) >> 8) as f32 / (1_u32 << 24) as f32;
            samples.add([1.0, x], die < p);
        }
        let [a, b] = samples.fit().unwrap();
        assert!((a - 0.5).abs() < 0.1 && (b - 2.0).abs() < 0.1, "{a} {b}");
    }
}
