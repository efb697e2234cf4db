//! `meta/stats.json`: the statistics by which training normalizes its inputs.

use serde_json::{Value, json};

/// The quantiles that LeRobot uses, with their names.
const QUANTILES: [(&str, f64); 5] =
    [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];

/// All values of a numeric feature with `width` columns.
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
        let mut stats = json!({
            "min": for_each(&columns, |column| value_of_rank(column, 0)),
            "max": for_each(&columns, |column| {
                value_of_rank(column, (column.len() as u64).saturating_sub(1))
            }),
            "mean": for_each(&columns, |column| moments(column).0),
            "std": for_each(&columns, |column| moments(column).1),
            "count": [self.values.len() / self.width],
        });
        for (name, q) in QUANTILES {
            stats[name] = json!(for_each(&columns, |column| {
                quantile(column.len() as u64, q, |rank| value_of_rank(column, rank))
            }));
        }
        stats
    }
}

fn for_each(columns: &[Vec<f64>], statistic: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    columns.iter().map(|column| statistic(column)).collect()
}

/// The value of a rank, counted from 0, in a sorted column.
fn value_of_rank(column: &[f64], rank: u64) -> f64 {
    column.get(rank as usize).copied().unwrap_or(0.0)
}

/// The mean and the standard deviation of the population.
fn moments(column: &[f64]) -> (f64, f64) {
    let count = column.len().max(1) as f64;
    let mean = column.iter().sum::<f64>() / count;
    (mean, (column.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt())
}

/// A quantile with linear interpolation between the two nearest values, as NumPy does by default. `at` returns the value of a
/// rank.
fn quantile(count: u64, q: f64, at: impl Fn(u64) -> f64) -> f64 {
    let position = q * count.saturating_sub(1) as f64;
    let below = position.floor() as u64;
    let part = position.fract();
    let low = at(below);
    if part == 0.0 { low } else { low + part * (at(below + 1) - low) }
}

/// The number of pixels with each value.
type Histogram = [u64; 256];

/// A histogram of each channel over all images.
pub(super) struct Pixels {
    counts: [Histogram; 3],
    images: u64,
}

impl Default for Pixels {
    fn default() -> Self {
        Self { counts: [[0; 256]; 3], images: 0 }
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
        self.images += 1;
    }

    /// The statistics of each channel, for values scaled from 0 to 1 as in LeRobot's images.
    pub(super) fn json(&self) -> Value {
        let mut stats = json!({
            "min": self.for_each_channel(|counts| pixel_of_rank(counts, 0)),
            "max": self.for_each_channel(|counts| {
                pixel_of_rank(counts, total(counts).saturating_sub(1))
            }),
            "mean": self.for_each_channel(mean),
            "std": self.for_each_channel(standard_deviation),
            "count": [self.images],
        });
        for (name, q) in QUANTILES {
            stats[name] = json!(self.for_each_channel(|counts| {
                quantile(total(counts), q, |rank| pixel_of_rank(counts, rank))
            }));
        }
        stats
    }

    /// A statistic of each channel, in the shape channels x 1 x 1.
    fn for_each_channel(&self, statistic: impl Fn(&Histogram) -> f64) -> Vec<Vec<Vec<f64>>> {
        self.counts.iter().map(|counts| vec![vec![statistic(counts) / 255.0]]).collect()
    }
}

fn total(counts: &Histogram) -> u64 {
    counts.iter().sum()
}

/// The mean of `of(value)` over all pixels.
fn weighted_mean(counts: &Histogram, of: impl Fn(f64) -> f64) -> f64 {
    let sum: f64 =
        counts.iter().enumerate().map(|(value, count)| of(value as f64) * *count as f64).sum();
    sum / total(counts).max(1) as f64
}

fn mean(counts: &Histogram) -> f64 {
    weighted_mean(counts, |value| value)
}

fn standard_deviation(counts: &Histogram) -> f64 {
    let mean = mean(counts);
    weighted_mean(counts, |value| (value - mean).powi(2)).sqrt()
}

/// The pixel value of a rank, counted from 0.
fn pixel_of_rank(counts: &Histogram, rank: u64) -> f64 {
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
    fn statistics_of_numbers_equal_those_of_numpy() {
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
    fn statistics_of_pixels_equal_those_of_the_same_numbers() {
        let mut pixels = Pixels::default();
        let mut numbers = Numbers::new(3);
        let rgb: Vec<u8> = (0..600_u32).map(|i| (i * i * 7 % 251) as u8).collect();
        pixels.push(&rgb);
        numbers.push(rgb.iter().map(|value| f64::from(*value) / 255.0));
        let pixels = pixels.json();
        let numbers = numbers.json();
        for name in ["min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99"] {
            for channel in 0..3 {
                let a = &pixels[name][channel][0][0];
                let b = &numbers[name][channel];
                assert!(
                    (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-12,
                    "{name} {channel}: {a} {b}"
                );
            }
        }
    }
}
