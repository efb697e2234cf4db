//! Periodic value noise: sums of random lattices, interpolated smoothly, that wrap at the texture's
//! border.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A periodic grid of values, row-major. Its sides are powers of two.
#[derive(Debug, Clone)]
pub struct Field {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Field {
    pub fn new(width: usize, height: usize) -> Self {
        debug_assert!(width.is_power_of_two() && height.is_power_of_two());
        Self { width, height, values: vec![0.0; width * height] }
    }

    /// Sums octaves from `cells` (columns and rows of the coarsest lattice) on, each twice as fine
    /// as the one before and `gain` times as strong, scaled to mean 0 and standard deviation 1. A
    /// gain of 1 has the same contrast at every scale, as photographs of surfaces have.
    pub fn fractal(
        size: [usize; 2],
        cells: [usize; 2],
        octaves: u32,
        gain: f32,
        seed: u64,
    ) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut field = Self::new(size[0], size[1]);
        for octave in 0..octaves {
            let lattice = [(cells[0] << octave).min(size[0]), (cells[1] << octave).min(size[1])];
            field.add_lattice(lattice, gain.powi(octave as i32), &mut rng);
        }
        field.standardise();
        field
    }

    /// Adds one octave of `cells` lattice points with values in -amplitude..amplitude.
    fn add_lattice(&mut self, cells: [usize; 2], amplitude: f32, rng: &mut Pcg64Mcg) {
        let lattice: Vec<f32> =
            (0..cells[0] * cells[1]).map(|_| rng.random_range(-amplitude..=amplitude)).collect();
        let columns: Vec<Station> =
            (0..self.width).map(|x| Station::new(x, self.width, cells[0])).collect();
        let weights: Vec<f32> = columns.iter().map(|column| column.t).collect();
        let runs: Vec<&[Station]> = columns.chunk_by(|a, b| a.low == b.low).collect();
        let mut row = vec![0.0; cells[0]];
        for (y, out) in self.values.chunks_exact_mut(self.width).enumerate() {
            let place = Station::new(y, self.height, cells[1]);
            let low = &lattice[place.low * cells[0]..][..cells[0]];
            let high = &lattice[place.high * cells[0]..][..cells[0]];
            for ((value, a), b) in row.iter_mut().zip(low).zip(high) {
                *value = a + (b - a) * place.t;
            }
            // Texels between the same two lattice points together, for vector registers.
            let mut x = 0;
            for run in &runs {
                let texels = x..x + run.len();
                let start = row[run[0].low];
                let rise = row[run[0].high] - start;
                for (value, t) in out[texels.clone()].iter_mut().zip(&weights[texels.clone()]) {
                    *value += start + rise * t;
                }
                x = texels.end;
            }
        }
    }

    /// Shifts and scales to mean 0 and standard deviation 1.
    pub fn standardise(&mut self) {
        let n = self.values.len() as f32;
        let mean = self.values.iter().sum::<f32>() / n;
        let variance = self.values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n;
        let scale = 1.0 / variance.sqrt().max(1e-6);
        self.values.iter_mut().for_each(|v| *v = (*v - mean) * scale);
    }

    /// The value at a texel, wrapped: masks, because a division for every texel takes longer than
    /// the rest.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.values[(y & (self.height - 1)) * self.width + (x & (self.width - 1))]
    }
}

/// Lattice points before and after a texel, and the smooth weight of the later one.
struct Station {
    low: usize,
    high: usize,
    t: f32,
}

impl Station {
    fn new(i: usize, size: usize, cells: usize) -> Self {
        let p = (i as f32 + 0.5) * cells as f32 / size as f32;
        let low = p as usize % cells;
        let t = p.fract();
        Self { low, high: (low + 1) % cells, t: t * t * (3.0 - 2.0 * t) }
    }
}

/// A hash of two numbers, in 0..1.
#[inline]
pub fn hash(a: u64, b: u64) -> f32 {
    let mut h = a.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ b.wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    h = (h ^ (h >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h = (h ^ (h >> 32)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((h ^ (h >> 31)) >> 40) as f32 / (1 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_wraps_without_a_seam_and_is_standardised() {
        let field = Field::fractal([64, 32], [4, 2], 3, 0.7, 5);
        let inside: f32 =
            (0..32).map(|y| absolute_difference(field.at(30, y), field.at(31, y))).sum();
        let across: f32 =
            (0..32).map(|y| absolute_difference(field.at(63, y), field.at(64, y))).sum();
        assert!(across < 3.0 * inside, "seam {across} against {inside}");
        let mean = field.values.iter().sum::<f32>() / 2048.0;
        let power = field.values.iter().map(|v| v * v).sum::<f32>() / 2048.0;
        assert!(mean.abs() < 1e-3 && (power - 1.0).abs() < 1e-3, "{mean} {power}");
    }

    fn absolute_difference(a: f32, b: f32) -> f32 {
        (a - b).abs()
    }
}
