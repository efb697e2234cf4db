//! Times of scans in a log, which were noted when a program got around to it.
//!
//! A scanner's motor rotates evenly, so that its scans are evenly spaced; what differs from that is the delay of the program. At 1 m/s,
//! 30 ms of delay are 3 cm of motion.

/// Scans on each side over which delays are averaged: some seconds, in which a motor's speed hardly changes.
const WINDOW: usize = 25;
/// A scan that was noted later than this share of a period after its neighbours' rhythm follows a pause, not a delay.
const LARGEST_SHARE: f64 = 0.75;

/// Share of a delay by which the expected rhythm follows it.
const FOLLOW: f64 = 0.1;

/// The times of evenly spaced scans. `times_s` are in order, seconds.
pub(super) fn regular(times_s: &[f64]) -> Vec<f64> {
    let mut steps_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let middle = steps_s.len() / 2;
    if steps_s.is_empty() {
        return times_s.to_vec();
    }
    let (_, period_s, _) = steps_s.select_nth_unstable_by(middle, f64::total_cmp);
    let period_s = *period_s;
    let mut rotation = 0.0;
    let mut delays_s = vec![0.0];
    let mut rotations = vec![0.0];
    // Two neighbours may be noted late and early by more than half a period together, but none is that far from the rhythm.
    let mut rhythm_s = times_s[0];
    for time_s in &times_s[1..] {
        let passed = ((time_s - rhythm_s) / period_s).round().max(1.0);
        rhythm_s += passed * period_s;
        rhythm_s += FOLLOW * (time_s - rhythm_s);
        rotation += passed;
        rotations.push(rotation);
        delays_s.push(time_s - times_s[0] - rotation * period_s);
    }
    let mut regular = Vec::with_capacity(times_s.len());
    for (index, time_s) in times_s.iter().enumerate() {
        let delay_s = mean_delay(&rotations, &delays_s, index);
        let even_s = times_s[0] + rotations[index] * period_s + delay_s;
        let is_delay = (even_s - time_s).abs() < LARGEST_SHARE * period_s;
        regular.push(if is_delay { even_s } else { *time_s });
    }
    regular
}

/// The delay of a scan by the line through those around it: the period is not known exactly, so that delays grow evenly.
fn mean_delay(rotations: &[f64], delays_s: &[f64], index: usize) -> f64 {
    let around = index.saturating_sub(WINDOW)..(index + WINDOW + 1).min(delays_s.len());
    let count = around.len() as f64;
    let mut sums = [0.0; 4];
    for other in around {
        let from = rotations[other] - rotations[index];
        sums[0] += from;
        sums[1] += from * from;
        sums[2] += delays_s[other];
        sums[3] += from * delays_s[other];
    }
    let [x, xx, y, xy] = sums.map(|sum| sum / count);
    let variance = xx - x * x;
    let slope = if variance > 0.0 { (xy - x * y) / variance } else { 0.0 };
    y - slope * x
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn delays_are_taken_out_of_evenly_spaced_scans_and_pauses_stay() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut even: Vec<f64> = (0..400).map(|index| 0.1003 * f64::from(index)).collect();
        // Five scans are missing.
        even.drain(200..205);
        let noted: Vec<f64> =
            even.iter().map(|time_s| time_s + rng.random_range(-0.03..0.03)).collect();
        let found = regular(&noted);
        for index in WINDOW..even.len() - WINDOW {
            assert!((found[index] - even[index]).abs() < 0.01, "{index}");
        }
    }

    #[test]
    fn even_times_stay_as_they_are() {
        let even: Vec<f64> = (0..50).map(|index| 7.0 + 0.25 * f64::from(index)).collect();
        for (found, expected) in regular(&even).iter().zip(&even) {
            assert!((found - expected).abs() < 1e-9);
        }
        assert_eq!(regular(&[3.0]), [3.0]);
    }
}
