//! A paired comparison of two models on the same frames, with confidence bounds.
//!
//! For each frame the difference d = candidate - resident of an error counts (a larger error is
//! worse). Frames from one place are not independent, so the bootstrap draws whole pose bins with
//! replacement (cluster bootstrap, Field and Welsh 2007). Each resample gives sum(d) / count over
//! the drawn bins, and the 5 % and 95 % quantiles of 2,000 resamples bound the mean difference. The
//! candidate is shown to be as good if the upper bound is within the margin (a non-inferiority
//! test), and shown to be worse if the lower bound is above 0. The seed is fixed, so the same
//! scores give the same verdict.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::PoseBin;

const RESAMPLES: usize = 2000;
const SEED: u64 = 1;
/// Significance level of each one-sided bound.
const LEVEL: f64 = 0.05;

/// The comparison of two models by one error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Number of frames that both models were scored on.
    pub frames: usize,
    /// Number of pose bins that the frames come from.
    pub places: usize,
    /// Mean error of the candidate.
    pub candidate: f64,
    /// Mean error of the resident model.
    pub resident: f64,
    /// Lower confidence bound of the mean difference.
    pub lower: f64,
    /// Upper confidence bound of the mean difference.
    pub upper: f64,
}

/// Compares the errors of frames, each as (pose bin, candidate's error, resident's error); `None`
/// without frames.
#[must_use]
pub fn compare(errors: &[(PoseBin, f64, f64)]) -> Option<Paired> {
    let mut bins: BTreeMap<PoseBin, (f64, f64)> = BTreeMap::new();
    let mut candidate = 0.0;
    let mut resident = 0.0;
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
    Some(Paired {
        frames: errors.len(),
        places: clusters.len(),
        candidate: candidate / count,
        resident: resident / count,
        lower: quantile(&means, LEVEL)?,
        upper: quantile(&means, 1.0 - LEVEL)?,
    })
}

fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    sorted.get((share * (sorted.len().saturating_sub(1)) as f64).round() as usize).copied()
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

    /// Errors with noise that both models share, and noise of the candidate for each place.
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
    fn the_difference_of_equal_models_is_zero() {
        let same: Vec<_> =
            errors(20, 10, 0.0, 1).iter().map(|(bin, _, error)| (*bin, *error, *error)).collect();
        let paired = compare(&same).unwrap();
        assert_eq!((paired.lower, paired.upper, paired.places, paired.frames), (0.0, 0.0, 20, 200));
        assert_eq!(compare(&[]), None);
    }

    #[test]
    fn the_bounds_contain_the_true_difference_nine_times_in_ten() {
        let within = (0..200).filter(|seed| {
            let paired = compare(&errors(25, 4, 0.01, *seed)).unwrap();
            paired.lower <= 0.01 && 0.01 <= paired.upper
        });
        // The nominal coverage is 90 %; with only 25 places a bootstrap gives bounds that are
        // slightly too narrow.
        let within = within.count();
        assert!((160..=198).contains(&within), "{within} of 200");
    }

    #[test]
    fn more_frames_of_the_same_places_do_not_narrow_the_bounds() {
        let [few, many] = [2, 100].map(|per_place| {
            let paired = compare(&errors(8, per_place, 0.0, 3)).unwrap();
            paired.upper - paired.lower
        });
        assert!((many / few - 1.0).abs() < 0.2, "{many} {few}");
    }
}
