//! A paired comparison of two models on the same frames, with confidence bounds.
//!
//! For each frame the difference d = candidate - resident of an error counts (a larger error is
//! worse). Frames from one place are not independent, so the unit is the place: the mean of d over its
//! frames. Student's t gives the bounds of the mean over places (5 % on each side), which hold with
//! few places, too: a percentile bootstrap over three places would accept a model at the margin in 20 %
//! of all cases instead of 5 % (simulated). The candidate is shown to be as good if the upper bound is within the
//! margin (a non-inferiority test), and shown to be worse if the lower bound is above 0.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

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
}

/// Compares the errors of frames, each as (pose bin, candidate's error, resident's error); `None` with
/// frames of fewer than two places, which have no bounds.
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
    let places: Vec<f64> = bins.into_values().map(|(sum, count)| sum / count).collect();
    if places.len() < 2 {
        return None;
    }
    let count = places.len() as f64;
    let mean = places.iter().sum::<f64>() / count;
    let variance = places.iter().map(|place| (place - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let reach = t_quantile(places.len() - 1) * (variance / count).sqrt();
    Some(Paired {
        frames: errors.len(),
        places: places.len(),
        candidate: candidate / errors.len() as f64,
        resident: resident / errors.len() as f64,
        lower: mean - reach,
        upper: mean + reach,
    })
}

/// The 95 % quantile of Student's t with this number of degrees of freedom: from a table up to eight, and by the expansion of
/// Cornish and Fisher beyond (Abramowitz and Stegun 26.7.5; off by less than 0.002).
fn t_quantile(freedom: usize) -> f64 {
    const TABLE: [f64; 9] = [f64::INFINITY, 6.314, 2.920, 2.353, 2.132, 2.015, 1.943, 1.895, 1.860];
    /// The quantile of the normal distribution.
    const NORMAL: f64 = 1.644_854;
    TABLE.get(freedom).copied().unwrap_or_else(|| {
        let n = freedom as f64;
        let z = NORMAL;
        let first = (z.powi(3) + z) / 4.0;
        let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
        z + first / n + second / (n * n)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

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
        assert_eq!(
            compare(&[(bin(0), 0.2, 0.1), (bin(0), 0.3, 0.1)]),
            None,
            "one place has no bounds"
        );
    }

    #[test]
    fn the_bounds_contain_the_true_difference_nine_times_in_ten() {
        let within = (0..200).filter(|seed| {
            let paired = compare(&errors(25, 4, 0.01, *seed)).unwrap();
            paired.lower <= 0.01 && 0.01 <= paired.upper
        });
        let within = within.count();
        assert!((168..=192).contains(&within), "{within} of 200");
    }

    #[test]
    fn the_quantiles_are_those_of_the_tables() {
        for (freedom, expected) in
            [(1, 6.314), (4, 2.132), (5, 2.015), (8, 1.860), (11, 1.796), (24, 1.711), (120, 1.658)]
        {
            let found = t_quantile(freedom);
            assert!((found - expected).abs() < 0.002, "{freedom}: {found}");
        }
    }

    /// Share of 4000 simulated comparisons in which a model that is exactly at the margin passes.
    fn passes_at_the_margin(places: i64, noise: impl Fn(&mut Pcg64Mcg) -> f64) -> f64 {
        const MARGIN: f64 = 0.03;
        let mut rng = Pcg64Mcg::seed_from_u64(places as u64);
        let passed = (0..4000).filter(|_| {
            let rows: Vec<_> =
                (0..places).map(|place| (bin(place), MARGIN + noise(&mut rng), 0.0)).collect();
            compare(&rows).unwrap().upper <= MARGIN
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
        let rare = |rng: &mut Pcg64Mcg| if rng.random_range(0.0..1.0) < 0.1 { 0.18 } else { -0.02 };
        let passed = [5, 12, 25].map(|places| passes_at_the_margin(places, rare));
        assert!(passed[0] > 0.5 && passed[2] < 0.2, "{passed:?}");
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
