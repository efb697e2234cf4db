//! Normally distributed random numbers.

use rand::{Rng, RngExt};

/// Draws a standard normal number (Box and Muller, 1958).
pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    // 1 - [0, 1) is never 0. The logarithm of 0 would be infinite.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

/// A fast source of many standard normal numbers. They are drawn with replacement from a table of
/// 4096 numbers whose sum is 0 and whose squares sum to 4096.
#[derive(Debug)]
pub(crate) struct NormalTable(Vec<f32>);

impl NormalTable {
    const BITS: usize = 12;

    /// Builds the table, which is fixed and does not depend on any seed.
    pub fn new() -> Self {
        use rand::SeedableRng;
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(0);
        let half: Vec<f64> = (0..1 << (Self::BITS - 1)).map(|_| normal(&mut rng)).collect();
        let scale = (half.len() as f64 / half.iter().map(|x| x * x).sum::<f64>()).sqrt();
        Self(half.iter().flat_map(|x| [(x * scale) as f32, (-x * scale) as f32]).collect())
    }

    /// Takes five numbers from one 64-bit draw.
    #[inline]
    pub fn five(&self, rng: &mut impl Rng) -> [f32; 5] {
        let bits = rng.next_u64() >> 4;
        std::array::from_fn(|i| {
            self.0[(bits >> (Self::BITS * i)) as usize & ((1 << Self::BITS) - 1)]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn both_generators_are_standard_normal() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let single: Vec<f64> = (0..100_000).map(|_| normal(&mut rng)).collect();
        let table = NormalTable::new();
        let many: Vec<f64> =
            (0..20_000).flat_map(|_| table.five(&mut rng)).map(f64::from).collect();
        for numbers in [single, many] {
            let count = numbers.len() as f64;
            let [mean, second, third, fourth] = [1, 2, 3, 4]
                .map(|power| numbers.iter().map(|x| x.powi(power)).sum::<f64>() / count);
            assert!(mean.abs() < 0.015 && (second - 1.0).abs() < 0.02, "{mean} {second}");
            assert!(third.abs() < 0.06 && (fourth - 3.0).abs() < 0.2, "{third} {fourth}");
            let beyond = numbers.iter().filter(|x| x.abs() > 1.96).count() as f64 / count;
            assert!((beyond - 0.05).abs() < 0.006, "{beyond}");
        }
    }
}
