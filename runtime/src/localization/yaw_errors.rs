//! Two numbers that a sensor of yaw does not report, learnt from what the scans say.
//!
//! A Kalman filter with slowly changing states. A wheel's numbers are radians per metre and per radian, a gyroscope's are radians per
//! second (bias) and per radian (scale).

use hal::wrap_angle;
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// A measurement that contradicts the numbers by more than this many standard deviations is slip or a wrong match, not their error.
pub(super) const MAX_SURPRISE: f64 = 4.0;

/// The learnt numbers and how certain they are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct YawErrors {
    numbers: Vector2<f64>,
    covariance: Matrix2<f64>,
}

impl YawErrors {
    /// Nothing is learnt yet; `std` are the standard deviations of the numbers over sensors of this kind.
    pub(super) fn new(std: [f64; 2]) -> Self {
        let [first, second] = std.map(|std| std * std);
        Self { numbers: Vector2::zeros(), covariance: Matrix2::new(first, 0.0, 0.0, second) }
    }

    /// Radians that the sensor did not report while it reported this much of both inputs.
    pub(super) fn unreported(&self, reported: &Vector2<f64>) -> f64 {
        self.numbers.dot(reported)
    }

    /// Variance of [`unreported`](Self::unreported), rad^2.
    pub(super) fn variance(&self, reported: &Vector2<f64>) -> f64 {
        (reported.transpose() * self.covariance * reported)[0]
    }

    /// The numbers may have changed: their variances grow.
    pub(super) fn forget(&mut self, variances: [f64; 2]) {
        self.covariance += Matrix2::from_diagonal(&Vector2::from(variances));
    }

    /// The sensor did not report `unreported_rad`, measured with variance `noise`. Returns whether that was learnt: a surprise is not.
    pub(super) fn learn(
        &mut self,
        reported: &Vector2<f64>,
        unreported_rad: f64,
        noise: f64,
    ) -> bool {
        let surprise = wrap_angle(unreported_rad - self.numbers.dot(reported));
        let spread = self.covariance * reported;
        let expected = reported.dot(&spread) + noise;
        if surprise * surprise > MAX_SURPRISE * MAX_SURPRISE * expected {
            return false;
        }
        let gain = spread / expected;
        self.numbers += gain * surprise;
        self.covariance -= gain * spread.transpose();
        true
    }

    pub(super) fn numbers(&self) -> [f64; 2] {
        self.numbers.into()
    }

    #[cfg(test)]
    pub(super) fn set(&mut self, numbers: [f64; 2]) {
        self.numbers = numbers.into();
    }
}
