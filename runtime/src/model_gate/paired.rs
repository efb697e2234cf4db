//! Is one model worse than the other on the same pictures, or is that chance?
//!
//! Of each picture the difference d = candidate - resident counts, of an error (more is worse). Pictures from one place are no
//! independent evidence, so the bootstrap draws whole pose bins with replacement (Field and Welsh 2007, cluster bootstrap): each
//! resample gives sum(d) / count over the drawn bins, and the 5 % and 95 % quantiles of 2,000 of them bound the mean difference.
//! The candidate is shown to be as good when the upper bound is within the margin (a non-inferiority test), and shown to be worse
//! when the lower bound is above 0. The seed is fixed: the same scores give the same verdict.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::PoseBin;

const RESAMPLES: usize = 2000;
const SEED: u64 = 1;
/// One-sided level.
const LEVEL: f64 = 0.05;

/// What comparing two models by one error gave.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Pictures that both models were scored on.
    pub pictures: usize,
    /// Places that they come from.
    pub places: usize,
    /// Mean error of the candidate.
    pub candidate: f64,
    /// Mean error of the resident model.
    pub resident: f64,
    /// Lower end of the mean difference.
    pub lower: f64,
    /// Upper end of the mean difference.
    pub upper: f64,
}

/// Compares errors (place, candidate, resident) picture by picture; `None` without any.
#[must_use]
pub fn compare(errors: &[(PoseBin, f64, f64)]) -> Option<Paired> {
    let mut bins: BTreeMap<PoseBin, (f64, f64)> = BTreeMap::new();
    let (mut candidate, mut resident) = (0.0, 0.0);
    for (bin, one, other) in errors {
        let (sum, count) = bins.entry(*bin).or_default();
        *sum += one - other;
        *count += 1.0;
        candidate += one;
        resident += other;
    }
    let clusters: Vec<(f64, f64)> = bins.into_values().collect();
    let count = errors.len() as f64;
    let mut rng = Pcg64Mcg::seed_from_u64(SEED);
    let mut means: Vec<f64> =
        (0..RESAMPLES).filter_map(|_| resampled_mean(&clusters, &mut rng)).collect();
    means.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        means.get((share * (means.len().saturating_sub(1)) as f64).round() as usize).copied()
    };
    Some(Paired {
        pictures: errors.len(),
        places: clusters.len(),
        candidate: candidate / count,
        resident: resident / count,
        lower: quantile(LEVEL)?,
        upper: quantile(1.0 - LEVEL)?,
    })
}

fn resampled_mean(clusters: &[(f64, f64)], rng: &mut Pcg64Mcg) -> Option<f64> {
    if clusters.is_empty() {
        return None;
    }
    let drawn =
        (0..clusters.len()).filter_map(|_| clusters.get(rng.random_range(0..clusters.len())));
    let (sum, count) = drawn.fold((0.0, 0.0), |(sum, count), (s, c)| (sum + s, count + c));
    Some(sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bin(x: i64) -> PoseBin {
        PoseBin { x, y: 0, sector: 0 }
    }

    /// Errors with noise that both models share and noise of their own.
    fn errors(places: i64, per_place: usize, offset: f64, seed: u64) -> Vec<(PoseBin, f64, f64)> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut rows = Vec::new();
        for place in 0..places {
            let shared: f64 = rng.random_range(0.1..0.5);
            let local: f64 = rng.random_range(-0.02..0.02);
            for _ in 0..per_place {
                rows.push((bin(place), shared + offset + local, shared));
            }
        }
        rows
    }

    #[test]
    fn equal_models_differ_by_nothing() {
        let same: Vec<_> =
            errors(20, 10, 0.0, 1).iter().map(|(bin, _, error)| (*bin, *error, *error)).collect();
        let paired = compare(&same).unwrap();
        assert_eq!(
            (paired.lower, paired.upper, paired.places, paired.pictures),
            (0.0, 0.0, 20, 200)
        );
        assert_eq!(compare(&[]), None);
    }

    #[test]
    fn the_bounds_hold_the_true_difference_nine_times_in_ten() {
        let within = (0..200).filter(|seed| {
            let paired = compare(&errors(25, 4, 0.01, *seed)).unwrap();
            paired.lower <= 0.01 && 0.01 <= paired.upper
        });
        // 90 % nominal; a bootstrap of 25 places is a little too sure of itself.
        let within = within.count();
        assert!((160..=198).contains(&within), "{within} of 200");
    }

    #[test]
    fn many_pictures_of_one_place_are_no_more_evidence_than_few() {
        let wide = |per_place| {
            let paired = compare(&errors(8, per_place, 0.0, 3)).unwrap();
            paired.upper - paired.lower
        };
        assert!((wide(100) / wide(2) - 1.0).abs() < 0.2, "{} {}", wide(100), wide(2));
    }
}
