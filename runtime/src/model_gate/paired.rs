//! A paired comparison of two models on the same frames, with confidence bounds.
//!
//! For each frame the difference d = candidate - resident of an error counts (a larger error is
//! worse). Frames from one place are not independent, so the unit is the place: the mean of d over its
//! frames. Student's t gives the bounds of the mean over places, which hold with few places, too: a percentile bootstrap over three places would accept a model at the margin in 20 %
//! of all cases instead of 5 % (simulated). The candidate is shown to be as good if the upper bound is within the
//! margin (a non-inferiority test), and shown to be worse if the lower bound is above 0.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::PoseBin;

/// The comparison of two models by one error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Number of frames that both models were scored on.
    pub frames: usize,
    /// Number of pose bins that the frames come from.
    pub places: usize,
    /// Mean error of the candidate over all frames.
    pub candidate: f64,
    /// Mean error of the resident model over all frames.
    pub resident: f64,
    /// Lower confidence bound of the mean difference over places.
    pub lower: f64,
    /// Upper confidence bound of the mean difference over places.
    pub upper: f64,
    /// Probability that the true difference is within the bounds.
    #[serde(default = "ninety_percent")]
    pub coverage: f64,
}

/// The coverage of comparisons of builds that did not note it.
fn ninety_percent() -> f64 {
    0.9
}

/// Compares the errors of frames, each as (pose bin, candidate's error, resident's error). The true difference is beyond each
/// bound with a probability of `error`. `None` with frames of fewer than two places, which have no bounds.
#[must_use]
pub fn compare(errors: &[(PoseBin, f64, f64)], error: f64) -> Option<Paired> {
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
    let places: Vec<f64> = bins.into_values().map(|(sum, count)| sum / count).collect();
    if places.len() < 2 {
        return None;
    }
    let count = places.len() as f64;
    let mean = places.iter().sum::<f64>() / count;
    let variance = places.iter().map(|place| (place - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let reach = t_quantile(places.len() - 1, error) * (variance / count).sqrt();
    Some(Paired {
        frames: errors.len(),
        places: places.len(),
        candidate: candidate / errors.len() as f64,
        resident: resident / errors.len() as f64,
        lower: mean - reach,
        upper: mean + reach,
        coverage: 1.0 - 2.0 * error,
    })
}

/// How many standard errors the bound of a mean is away from it, with this number of degrees of freedom (at least 1) and this
/// probability that the true mean is beyond the bound. Infinity for a probability that no interval has.
fn t_quantile(freedom: usize, error: f64) -> f64 {
    let t = StudentsT::new(0.0, 1.0, freedom as f64);
    t.map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// 5 % on each side.
    const ERROR: f64 = 0.05;

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
        let paired = compare(&same, ERROR).unwrap();
        assert_eq!((paired.lower, paired.upper, paired.places, paired.frames), (0.0, 0.0, 20, 200));
        assert_eq!(compare(&[], ERROR), None);
        assert_eq!(
            compare(&[(bin(0), 0.2, 0.1), (bin(0), 0.3, 0.1)], ERROR),
            None,
            "one place has no bounds"
        );
    }

    #[test]
    fn the_bounds_contain_the_true_difference_nine_times_in_ten() {
        let within = (0..200).filter(|seed| {
            let paired = compare(&errors(25, 4, 0.01, *seed), ERROR).unwrap();
            paired.lower <= 0.01 && 0.01 <= paired.upper
        });
        let within = within.count();
        assert!((168..=192).contains(&within), "{within} of 200");
    }

    #[test]
    fn the_quantiles_are_those_of_the_tables() {
        for (freedom, error, expected) in [
            (1, 0.05, 6.314),
            (4, 0.05, 2.132),
            (11, 0.05, 1.796),
            (120, 0.05, 1.658),
            (2, 0.005, 9.925),
            (10, 0.001, 4.144),
            (30, 0.0005, 3.646),
        ] {
            let found = t_quantile(freedom, error);
            assert!((found - expected).abs() < 0.001, "{freedom}, {error}: {found}");
        }
    }

    /// Share of 4000 simulated comparisons in which a model that is exactly at the margin passes.
    fn passes_at_the_margin(places: i64, noise: impl Fn(&mut Pcg64Mcg) -> f64) -> f64 {
        const MARGIN: f64 = 0.03;
        let mut rng = Pcg64Mcg::seed_from_u64(places as u64);
        let passed = (0..4000).filter(|_| {
            let rows: Vec<_> =
                (0..places).map(|place| (bin(place), MARGIN + noise(&mut rng), 0.0)).collect();
            compare(&rows, ERROR).unwrap().upper <= MARGIN
        });
        passed.count() as f64 / 4000.0
    }

    #[test]
    fn a_model_at_the_margin_passes_in_five_percent_of_all_cases_with_few_places_as_with_many() {
        // The sum of twelve uniform numbers is almost normal.
        let normal =
            |rng: &mut Pcg64Mcg| (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>() * 0.02;
        for places in [3, 5, 12, 25] {
            let passed = passes_at_the_margin(places, normal);
            assert!((0.04..0.06).contains(&passed), "{places} places: {passed}");
        }
    }

    #[test]
    fn rare_large_errors_make_the_bounds_too_narrow_with_few_places() {
        // Right at nine places of ten and wrong by ten times as much at the tenth: why a worst place is judged as well.
        let passed = [5, 12, 25].map(|places| passes_at_the_margin(places, rare));
        assert!(passed[0] > 0.5 && passed[2] < 0.2, "{passed:?}");
    }

    fn rare(rng: &mut Pcg64Mcg) -> f64 {
        if rng.random_range(0.0..1.0) < 0.1 { 0.18 } else { -0.02 }
    }

    #[test]
    fn more_frames_of_the_same_places_do_not_narrow_the_bounds() {
        let [few, many] = [2, 100].map(|per_place| {
            let paired = compare(&errors(8, per_place, 0.0, 3), ERROR).unwrap();
            paired.upper - paired.lower
        });
        assert!((many / few - 1.0).abs() < 0.2, "{many} {few}");
    }
}
