//! `meta/stats.json`: what training normalizes by.

use serde_json::{Value, json};

/// LeRobot's quantiles, by the names it gives them.
const QUANTILES: [(&str, f64); 5] =
    [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];

/// All values of a feature of numbers.
pub(super) struct Numbers {
    width: usize,
    values: Vec<f64>,
}

impl Numbers {
    pub(super) fn new(width: usize) -> Self {
        Self { width, values: Vec::new() }
    }

    pub(super) fn push(&mut self, values: impl IntoIterator<Item = f64>) {
        self.values.extend(values);
    }

    pub(super) fn json(&self) -> Value {
        let columns: Vec<Vec<f64>> = (0..self.width)
            .map(|at| {
                let mut column: Vec<f64> =
                    self.values.iter().skip(at).step_by(self.width).copied().collect();
                column.sort_unstable_by(f64::total_cmp);
                column
            })
            .collect();
        let each = |of: &dyn Fn(&[f64]) -> f64| {
            columns.iter().map(|column| of(column)).collect::<Vec<_>>()
        };
        let at = |column: &[f64], rank: u64| column.get(rank as usize).copied().unwrap_or(0.0);
        let mut stats = json!({
            "min": each(&|column| at(column, 0)),
            "max": each(&|column| at(column, (column.len() as u64).saturating_sub(1))),
            "mean": each(&|column| moments(column).0),
            "std": each(&|column| moments(column).1),
            "count": [self.values.len() / self.width],
        });
        for (name, q) in QUANTILES {
            stats[name] =
                json!(each(&|column| quantile(column.len() as u64, q, |rank| at(column, rank))));
        }
        stats
    }
}

/// Mean and standard deviation of the population.
fn moments(column: &[f64]) -> (f64, f64) {
    let count = column.len().max(1) as f64;
    let mean = column.iter().sum::<f64>() / count;
    (mean, (column.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt())
}

/// Between the two values next to it, as NumPy does by default. `at` gives the value of a rank.
fn quantile(count: u64, q: f64, at: impl Fn(u64) -> f64) -> f64 {
    let position = q * count.saturating_sub(1) as f64;
    let (below, part) = (position.floor() as u64, position.fract());
    let low = at(below);
    if part == 0.0 { low } else { low + part * (at(below + 1) - low) }
}

/// How often each value comes in each channel of all pictures.
pub(super) struct Pixels {
    counts: [[u64; 256]; 3],
    pictures: u64,
}

impl Default for Pixels {
    fn default() -> Self {
        Self { counts: [[0; 256]; 3], pictures: 0 }
    }
}

impl Pixels {
    pub(super) fn push(&mut self, rgb: &[u8]) {
        for pixel in rgb.chunks_exact(3) {
            for (counts, value) in self.counts.iter_mut().zip(pixel) {
                if let Some(count) = counts.get_mut(usize::from(*value)) {
                    *count += 1;
                }
            }
        }
        self.pictures += 1;
    }

    /// Of values from 0 to 1, channel by channel, as LeRobot's pictures are.
    pub(super) fn json(&self) -> Value {
        let each = |of: &dyn Fn(&[u64; 256]) -> f64| {
            self.counts.iter().map(|counts| vec![vec![of(counts) / 255.0]]).collect::<Vec<_>>()
        };
        let total = |counts: &[u64; 256]| counts.iter().sum::<u64>();
        let weighted = |counts: &[u64; 256], of: &dyn Fn(f64) -> f64| {
            let sum: f64 = counts
                .iter()
                .enumerate()
                .map(|(value, count)| of(value as f64) * *count as f64)
                .sum();
            sum / total(counts).max(1) as f64
        };
        let mean = |counts: &[u64; 256]| weighted(counts, &|value| value);
        let std = |counts: &[u64; 256]| {
            let mean = mean(counts);
            weighted(counts, &|value| (value - mean).powi(2)).sqrt()
        };
        let mut stats = json!({
            "min": each(&|counts| ranked(counts, 0)),
            "max": each(&|counts| ranked(counts, total(counts).saturating_sub(1))),
            "mean": each(&mean),
            "std": each(&std),
            "count": [self.pictures],
        });
        for (name, q) in QUANTILES {
            stats[name] =
                json!(each(&|counts| quantile(total(counts), q, |rank| ranked(counts, rank))));
        }
        stats
    }
}

/// The value of a rank, counted from 0.
fn ranked(counts: &[u64; 256], rank: u64) -> f64 {
    let mut below = 0;
    let found = counts.iter().position(|count| {
        below += count;
        below > rank
    });
    found.unwrap_or(255) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_statistics_that_numpy_computes() {
        // numpy: a = [4, 1, 3, 2]; a.mean(), a.std(), numpy.quantile(a, [0.1, 0.5, 0.99])
        let mut numbers = Numbers::new(2);
        for value in [4.0, 1.0, 3.0, 2.0] {
            numbers.push([value, -7.0]);
        }
        let stats = numbers.json();
        assert_eq!((&stats["min"], &stats["max"]), (&json!([1.0, -7.0]), &json!([4.0, -7.0])));
        assert_eq!((&stats["mean"], &stats["count"]), (&json!([2.5, -7.0]), &json!([4])));
        for (name, expected) in
            [("std", 1.118_033_988_749_895), ("q10", 1.3), ("q50", 2.5), ("q99", 3.97)]
        {
            assert!(
                (stats[name][0].as_f64().unwrap() - expected).abs() < 1e-12,
                "{name}: {}",
                stats[name]
            );
        }
    }

    #[test]
    fn pixels_have_the_statistics_of_their_numbers() {
        let (mut pixels, mut numbers) = (Pixels::default(), Numbers::new(3));
        let rgb: Vec<u8> = (0..600_u32).map(|i| (i * i * 7 % 251) as u8).collect();
        pixels.push(&rgb);
        numbers.push(rgb.iter().map(|value| f64::from(*value) / 255.0));
        let (pixels, numbers) = (pixels.json(), numbers.json());
        for name in ["min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99"] {
            for channel in 0..3 {
                let (a, b) = (&pixels[name][channel][0][0], &numbers[name][channel]);
                assert!(
                    (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-12,
                    "{name} {channel}: {a} {b}"
                );
            }
        }
    }
}
