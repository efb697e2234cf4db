//! Optional disturbances that make rendered frames as difficult as real ones.

use hal::settings::OutOfRange;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::random::NormalTable;
use crate::render::{Lighting, SunPatches};

hal::settings! {
    /// What makes real images harder than rendered ones. The default is a steady camera in steady light with a little sensor
    /// noise.
    pub struct Nuisances {
        /// Largest drift of the exposure. One stop doubles or halves the light.
        exposure_drift_stops: f64 = 0.0, in 0.0..=4.0, unit "stops";
        /// Period of the slower part of the drift.
        exposure_drift_period_s: f64 = 20.0, in 0.1..=1000000.0, unit "s";
        /// Amplitude of the flicker of lamps on mains, as a fraction of their light.
        flicker: f64 = 0.0, in 0.0..=1.0;
        /// Frequency of the flicker: twice the mains frequency. The frame rate aliases it to slow waves.
        flicker_hz: f64 = 100.0, in 0.0..=100000.0, unit "Hz";
        /// Strength of sun patches on floor and walls, relative to white.
        sun_patches: f64 = 0.0, in 0.0..=4.0;
        /// Standard deviation of the sensor's noise, in steps of the 8-bit image.
        sensor_noise: f64 = 1.5, in 0.0..=64.0;
        /// Exposure time, for motion blur; 0 for none.
        shutter_s: f64 = 0.0, in 0.0..=1.0, unit "s";
        /// Number of people who walk about.
        people: usize = 0, in 0..=32, unit "people";
        /// Number of cats and small dogs that walk about and lie down from time to time. One that lies is lower than the plane of
        /// the scanner.
        pets: usize = 0, in 0..=8, unit "pets";
    }
}

/// A nuisance is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("nuisance `{field}` is {value}, but must be from {allowed}")]
#[non_exhaustive]
pub struct NuisanceError {
    /// Name of the field of [`Nuisances`].
    pub field: &'static str,
    /// The refused value.
    pub value: f64,
    /// The range of allowed values.
    pub allowed: &'static str,
}

impl From<OutOfRange> for NuisanceError {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        Self { field: key, value, allowed }
    }
}

impl Nuisances {
    /// No disturbance: the renderer's images are unchanged.
    #[must_use]
    pub fn none() -> Self {
        Self { sensor_noise: 0.0, ..Self::default() }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// Reports the first value that is not a number or is outside its range.
    pub fn check(&self) -> Result<(), NuisanceError> {
        Ok(self.check_ranges()?)
    }

    /// Light factor at a time: the camera's exposure drift times the lamps' flicker. The drift is a
    /// sum of two sines, starts at 1 and stays within `exposure_drift_stops`.
    #[must_use]
    pub fn gain(&self, time_ns: u64) -> f64 {
        use std::f64::consts::{SQRT_2, TAU};
        let time_s = time_ns as f64 * 1e-9;
        let phase = TAU * time_s / self.exposure_drift_period_s;
        let drift = 0.65 * phase.sin() + 0.35 * (phase * 3.0 * SQRT_2).sin();
        let flicker = self.flicker * (TAU * (time_s * self.flicker_hz).fract()).sin();
        (self.exposure_drift_stops * drift).exp2() * (1.0 + flicker)
    }

    /// The scene's lighting at a time.
    #[must_use]
    pub fn lighting(&self, time_ns: u64) -> Lighting {
        let sun = (self.sun_patches > 0.0).then_some(SunPatches {
            strength: self.sun_patches as f32,
            direction: [0.6, 0.35, 0.7],
            size_m: [0.9, 1.4],
            spacing_m: 3.1,
        });
        let neutral = Lighting::default();
        Lighting { exposure: neutral.exposure * self.gain(time_ns) as f32, sun, ..neutral }
    }

    /// Adds independent, normally distributed noise to every byte of a rendered image. It takes one
    /// draw from `rng` per image, whatever the image size, so the rest of a simulation does not
    /// depend on the resolution.
    pub fn add_sensor_noise(&self, rng: &mut impl Rng, rgb: &mut [u8]) {
        let seed = rng.next_u64();
        if self.sensor_noise <= 0.0 {
            return;
        }
        let table = NormalTable::new();
        let sigma = self.sensor_noise as f32;
        // Each block of bytes has its own generator, so the result does not depend on the number of
        // threads.
        rgb.par_chunks_mut(NOISE_BLOCK).enumerate().for_each(|(block, bytes)| {
            let mut rng = Pcg64Mcg::seed_from_u64(seed.wrapping_add(block as u64));
            for five in bytes.chunks_mut(5) {
                for (byte, noise) in five.iter_mut().zip(table.five(&mut rng)) {
                    // `as` truncates non-negative values and saturates below 0 and above 255, so
                    // adding 0.5 rounds.
                    *byte = (f32::from(*byte) + sigma * noise + 0.5) as u8;
                }
            }
        });
    }
}

const NOISE_BLOCK: usize = 16_000;

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn by_default_there_is_only_a_little_sensor_noise() {
        let nuisances = Nuisances::default();
        assert_eq!(nuisances.lighting(12 * SECOND_NS), Lighting::default());
        assert_eq!((nuisances.people, nuisances.shutter_s, nuisances.sensor_noise), (0, 0.0, 1.5));
        nuisances.check().unwrap();
    }

    #[test]
    fn exposure_drifts_within_its_bound_and_uses_most_of_it() {
        let nuisances = Nuisances { exposure_drift_stops: 0.5, ..Nuisances::none() };
        let gains: Vec<f64> = (0..4000).map(|i| nuisances.gain(i * SECOND_NS / 20)).collect();
        let (low, high) = gains.iter().fold((f64::MAX, 0.0_f64), |(l, h), &g| (l.min(g), h.max(g)));
        assert!((gains[0] - 1.0).abs() < 1e-12);
        assert!(low >= (-0.5_f64).exp2() && high <= 0.5_f64.exp2());
        assert!(high / low > 1.7, "{low} to {high}");
        // The gain changes little from one frame to the next.
        assert!(gains.windows(2).all(|g| (g[1] / g[0] - 1.0).abs() < 0.02));
    }

    #[test]
    fn lamps_flicker_at_their_frequency() {
        let nuisances = Nuisances { flicker: 0.2, flicker_hz: 100.0, ..Nuisances::none() };
        for i in 0..50 {
            let time_ns = i * 1_234_567;
            let period_ns = SECOND_NS / 100;
            assert!((nuisances.gain(time_ns) - nuisances.gain(time_ns + period_ns)).abs() < 1e-9);
            // Half a period later the sign is reversed.
            assert!(
                (nuisances.gain(time_ns) + nuisances.gain(time_ns + period_ns / 2) - 2.0).abs()
                    < 1e-9
            );
        }
        assert!((nuisances.gain(SECOND_NS / 400) - 1.2).abs() < 1e-9);
    }

    #[test]
    fn sensor_noise_has_its_spread_no_bias_and_no_pattern() {
        let nuisances = Nuisances { sensor_noise: 3.0, ..Nuisances::none() };
        let mut rgb = vec![128_u8; 640 * 192 * 3];
        nuisances.add_sensor_noise(&mut Pcg64Mcg::seed_from_u64(1), &mut rgb);
        let errors: Vec<f64> = rgb.iter().map(|&b| f64::from(b) - 128.0).collect();
        let count = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / count;
        let variance = errors.iter().map(|e| e * e).sum::<f64>() / count;
        assert!(mean.abs() < 0.03, "{mean}");
        // Rounding to bytes adds a twelfth.
        assert!((variance - 9.0 - 1.0 / 12.0).abs() < 0.1, "{variance}");
        for lag in [1, 3, 5, 640 * 3, NOISE_BLOCK] {
            let product: f64 = errors.iter().zip(&errors[lag..]).map(|(a, b)| a * b).sum();
            assert!((product / count / variance).abs() < 0.01, "lag {lag}");
        }
    }

    #[test]
    fn black_and_white_stay_in_range() {
        let nuisances = Nuisances { sensor_noise: 20.0, ..Nuisances::none() };
        let mut rgb = [[0_u8; 300], [255; 300]].concat();
        nuisances.add_sensor_noise(&mut Pcg64Mcg::seed_from_u64(1), &mut rgb);
        assert!(rgb[..300].iter().all(|&b| b < 120) && rgb[300..].iter().all(|&b| b > 135));
    }

    #[test]
    fn the_same_seed_gives_the_same_noise_on_any_number_of_threads() {
        let one = noisy_image(4, 1);
        assert!(noisy_image(4, 2) == one && noisy_image(4, 4) == one && noisy_image(5, 1) != one);
    }

    fn noisy_image(seed: u64, threads: usize) -> Vec<u8> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut rgb = vec![100_u8; 100_000];
        pool.install(|| {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            Nuisances::default().add_sensor_noise(&mut rng, &mut rgb);
        });
        rgb
    }

    #[test]
    fn impossible_values_are_refused_with_their_range() {
        for (nuisances, field) in [
            (Nuisances { sensor_noise: f64::NAN, ..Nuisances::none() }, "sensor_noise"),
            (Nuisances { flicker: 1.5, ..Nuisances::none() }, "flicker"),
            (
                Nuisances { exposure_drift_period_s: 0.0, ..Nuisances::none() },
                "exposure_drift_period_s",
            ),
            (Nuisances { people: 1000, ..Nuisances::none() }, "people"),
            (Nuisances { pets: 9, ..Nuisances::none() }, "pets"),
        ] {
            let error = nuisances.check().unwrap_err();
            assert_eq!(error.field, field);
            assert!(error.to_string().contains("must be from"), "{error}");
        }
    }
}
