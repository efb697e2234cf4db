//! Least squares in information form: sums that can be added and removed block by block.

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// What some equations say of `N` parameters: with the normal equations `information * parameters = pull`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Sums<const N: usize> {
    pub information: SMatrix<f64, N, N>,
    pub pull: SVector<f64, N>,
}

impl<const N: usize> Default for Sums<N> {
    fn default() -> Self {
        Self { information: SMatrix::zeros(), pull: SVector::zeros() }
    }
}

impl<const N: usize> Sums<N> {
    /// The equation `factors . parameters = value`, whose error has `variance`.
    pub(crate) fn of(factors: SVector<f64, N>, value: f64, variance: f64) -> Self {
        let information = factors * factors.transpose() / variance;
        Self { information, pull: factors * (value / variance) }
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.information += other.information;
        self.pull += other.pull;
    }

    pub(crate) fn scaled(&self, share: f64) -> Self {
        Self { information: self.information * share, pull: self.pull * share }
    }

    /// What the equations pull away from `center`.
    pub(crate) fn pull_from(&self, center: &SVector<f64, N>) -> SVector<f64, N> {
        self.pull - self.information * center
    }

    /// The same equations with parameters that count from `center`.
    pub(crate) fn beside(&self, center: &SVector<f64, N>) -> Self {
        Self { information: self.information, pull: self.pull_from(center) }
    }

    /// The parameters and their covariance, if before the equations they were expected to be zero with standard deviations
    /// `expected`.
    pub(crate) fn solve(
        &self,
        expected: &SVector<f64, N>,
    ) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>)> {
        let prior = expected.map(|sigma| sigma.powi(-2));
        let covariance = (self.information + SMatrix::from_diagonal(&prior)).try_inverse()?;
        let parameters = covariance * self.pull;
        parameters.iter().all(|value| value.is_finite()).then_some((parameters, covariance))
    }
}
