//! How uncertain what is compared over a span is: scans by a constant, wheels by how far they drove and rotated.
//!
//! The errors of wheels are independent from one bit of the path to the next, so that their variances grow with the distance and
//! with the rotation. Spans differ in both. With one standard deviation for all of them, those that drive far seem to have
//! outliers: they lose weight although they say most.

use super::least_squares::robust_sigma;

/// What the variance of a span grows with: 1 for the scans, metres and radians for the wheels.
pub(super) type Extent = [f64; 3];

/// Steps of the estimate, our own choice.
const ITERATIONS: usize = 20;
/// A part of the variance is measured by at least this many spans in which it is the largest. Otherwise it stays what it was assumed to be.
const LEAST_SPANS: usize = 12;

/// Variances of a residual: of the scans, of the wheels for each metre, and of the wheels for each radian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SpanNoise {
    variances: [f64; 3],
}

impl SpanNoise {
    /// Estimates the variances from residuals of spans with different extents, by medians: outliers do not count. `None` without
    /// residuals, or when most of them are 0.
    pub fn estimate(residuals: &[f64], extents: &[Extent]) -> Option<Self> {
        let sigma = robust_sigma(&mut residuals.to_vec()).filter(|sigma| *sigma > 0.0)?;
        let mut noise = Self::shared_out(sigma * sigma, extents);
        for _ in 0..ITERATIONS {
            for part in 0..noise.variances.len() {
                let measured = noise.excess(residuals, extents, |extent| {
                    2.0 * noise.part(part, extent) > noise.variance(extent)
                });
                if let Some(excess) = measured {
                    noise.variances[part] *= excess;
                }
            }
        }
        let excess = noise.excess(residuals, extents, |_| true).unwrap_or(1.0);
        noise.variances = noise.variances.map(|variance| excess * variance);
        Some(noise)
    }

    /// A third of `variance` for each part in an average span.
    fn shared_out(variance: f64, extents: &[Extent]) -> Self {
        let mut variances = [0.0; 3];
        for (part, share) in variances.iter_mut().enumerate() {
            let sum: f64 = extents.iter().map(|extent| extent[part]).sum();
            *share = if sum > 0.0 { variance * extents.len() as f64 / (3.0 * sum) } else { 0.0 };
        }
        Self { variances }
    }

    /// How many times larger the variance of the chosen spans is than this noise says.
    fn excess(
        &self,
        residuals: &[f64],
        extents: &[Extent],
        is_chosen: impl Fn(&Extent) -> bool,
    ) -> Option<f64> {
        let chosen = residuals.iter().zip(extents).filter(|(_, extent)| is_chosen(extent));
        let mut normalised: Vec<f64> =
            chosen.map(|(residual, extent)| residual / self.sigma(extent)).collect();
        if normalised.len() < LEAST_SPANS {
            return None;
        }
        robust_sigma(&mut normalised).map(|sigma| sigma * sigma)
    }

    fn part(&self, part: usize, extent: &Extent) -> f64 {
        self.variances[part] * extent[part]
    }

    fn variance(&self, extent: &Extent) -> f64 {
        (0..extent.len()).map(|part| self.part(part, extent)).sum()
    }

    /// The standard deviation of the residual of a span.
    pub fn sigma(&self, extent: &Extent) -> f64 {
        self.variance(extent).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const TRUE: SpanNoise = SpanNoise { variances: [1e-6, 1e-4, 4e-4] };

    /// Spans that drive, spans that rotate and spans that do both, with residuals of the true noise.
    fn spans(count: usize, seed: u64) -> (Vec<f64>, Vec<Extent>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let extents: Vec<Extent> = (0..count)
            .map(|_| match rng.random_range(0..4) {
                0 => [1.0, 0.3, 0.0],
                1 => [1.0, 0.0, 0.3],
                2 => [1.0, 1e-4, 1e-4],
                _ => [1.0, rng.random_range(0.0..0.3), 0.02],
            })
            .collect();
        let normal = |rng: &mut Pcg64Mcg| (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let residuals =
            extents.iter().map(|extent| TRUE.sigma(extent) * normal(&mut rng)).collect();
        (residuals, extents)
    }

    fn ratios(noise: &SpanNoise) -> [f64; 3] {
        [0, 1, 2].map(|part| (noise.variances[part] / TRUE.variances[part]).sqrt())
    }

    #[test]
    fn the_noise_of_scans_distances_and_rotations_is_told_apart() {
        let (residuals, extents) = spans(10_000, 1);
        let ratios = ratios(&SpanNoise::estimate(&residuals, &extents).unwrap());
        assert!(ratios.iter().all(|ratio| (0.93..1.07).contains(ratio)), "{ratios:?}");
    }

    #[test]
    fn one_span_in_ten_that_is_wild_changes_little() {
        let (mut residuals, extents) = spans(2000, 2);
        residuals.iter_mut().step_by(10).for_each(|residual| *residual += 1.0);
        let ratios = ratios(&SpanNoise::estimate(&residuals, &extents).unwrap());
        assert!(ratios.iter().all(|ratio| (0.9..1.4).contains(ratio)), "{ratios:?}");
    }

    #[test]
    fn a_robot_that_never_rotates_still_has_the_noise_of_its_distances() {
        let (residuals, extents) = spans(10_000, 3);
        let straight = |extent: &Extent| extent[2] < 0.01;
        let kept: Vec<usize> = (0..extents.len()).filter(|i| straight(&extents[*i])).collect();
        let residuals: Vec<f64> = kept.iter().map(|i| residuals[*i]).collect();
        let extents: Vec<Extent> = kept.iter().map(|i| [1.0, extents[*i][1], 0.0]).collect();
        let noise = SpanNoise::estimate(&residuals, &extents).unwrap();
        let far = noise.sigma(&[1.0, 0.3, 0.0]) / TRUE.sigma(&[1.0, 0.3, 0.0]);
        assert!((0.93..1.07).contains(&far), "{far}");
    }

    #[test]
    fn residuals_of_0_and_none_at_all_have_no_noise() {
        assert_eq!(SpanNoise::estimate(&[], &[]), None);
        assert_eq!(SpanNoise::estimate(&[0.0; 20], &[[1.0, 0.1, 0.1]; 20]), None);
    }
}
