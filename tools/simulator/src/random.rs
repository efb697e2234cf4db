//! Random numbers with a distribution.

use rand::{Rng, RngExt};

/// A standard normal number (Box and Muller, 1958).
pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    // 1 - [0, 1) is never 0, whose logarithm is infinite.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}
