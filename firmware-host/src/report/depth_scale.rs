//! The colour scale of all depths of one run.

use super::colors::{self, Rgb};
use super::depth_sample::SheetRow;

const NO_DEPTH: [Rgb; 2] = [[198, 200, 205], [236, 237, 240]];

/// Depths that may be labelled on the colour bar, metres.
const TICKS_M: [f32; 14] =
    [0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0];

/// The near end of the scale is at most this, metres: the robot comes this close to most things, also in a run whose selected
/// frames do not show it.
const NEAR_M: f32 = 0.6;

/// A logarithmic colour scale: equal ratios of depth are equal steps of colour.
#[derive(Debug, Clone, Copy)]
pub struct DepthScale {
    near_m: f32,
    far_m: f32,
}

impl DepthScale {
    /// A scale from the 1st percentile, or less, to the 99th of the ground truth or, without it, of the estimated depths.
    pub fn of<'a>(rows: impl Iterator<Item = &'a SheetRow> + Clone) -> Self {
        let truth = rows.clone().filter_map(|row| row.truth.as_deref());
        let estimated = rows
            .flat_map(|row| [&row.coarse, &row.dense, &row.network])
            .flatten()
            .map(|depth| &depth.depth_m[..]);
        let mut depths = valid(truth);
        if depths.is_empty() {
            depths = valid(estimated);
        }
        depths.sort_unstable_by(f32::total_cmp);
        let near_m = depths.get(depths.len() / 100).copied().unwrap_or(NEAR_M).min(NEAR_M);
        let far_m = depths.get(depths.len() * 99 / 100).copied().unwrap_or(10.0);
        // An image of a single wall still needs a range.
        Self { near_m, far_m: far_m.max(1.2 * near_m) }
    }

    /// Position on the scale: 0 at the near end, 1 at the far end.
    fn share(&self, depth_m: f32) -> f32 {
        (depth_m / self.near_m).ln() / (self.far_m / self.near_m).ln()
    }

    /// The labels of the colour bar with their positions. Labels that would touch the one before
    /// are left out.
    pub(super) fn ticks(&self) -> Vec<(f32, String)> {
        let mut ticks: Vec<(f32, String)> = Vec::new();
        for tick_m in TICKS_M {
            let share = self.share(tick_m);
            let fits = ticks.last().is_none_or(|(last, _)| share - last > 0.1);
            if fits && (0.0..=1.0).contains(&share) {
                ticks.push((share, format!("{tick_m}")));
            }
        }
        ticks
    }

    /// Colour of a depth; `None` for a depth of 0, which means that there is none.
    pub(super) fn color_of(&self, depth_m: f32) -> Option<Rgb> {
        (depth_m > 0.0).then(|| colors::depth(f64::from(self.share(depth_m))))
    }
}

fn valid<'a>(depths: impl Iterator<Item = &'a [f32]>) -> Vec<f32> {
    depths.flatten().copied().filter(|depth| *depth > 0.0).collect()
}

/// Light grey stripes for pixels without a value, which cannot be confused with a colour of the scale.
pub(super) fn hatch(x: i64, y: i64) -> Rgb {
    NO_DEPTH[usize::from((x + y).rem_euclid(8) < 2)]
}

#[cfg(test)]
mod tests {
    use super::super::depth_sample::SampledDepth;
    use super::*;

    fn row(truth: Option<Vec<f32>>, estimated_m: Option<f32>) -> SheetRow {
        let coarse = estimated_m.map(|depth_m| SampledDepth {
            depth_m: vec![depth_m; 64],
            confidence: vec![0.8; 64],
            share: 1.0,
            delta1: None,
            abs_rel: None,
        });
        SheetRow {
            frame: 0,
            width: 8,
            height: 8,
            rgb: vec![[0; 3]; 64],
            coarse,
            dense: None,
            network: None,
            truth,
        }
    }

    #[test]
    fn missing_depth_is_never_a_colour_of_the_scale() {
        for step in 0..=1000 {
            let color = colors::depth(f64::from(step) / 1000.0);
            for grey in NO_DEPTH {
                let differs = grey.iter().zip(color).any(|(a, b)| a.abs_diff(b) > 60);
                assert!(differs, "{color:?}");
            }
        }
    }

    #[test]
    fn equal_ratios_are_equal_steps() {
        let scale = DepthScale { near_m: 0.5, far_m: 8.0 };
        assert!((scale.share(1.0) - 0.25).abs() < 1e-6 && (scale.share(2.0) - 0.5).abs() < 1e-6);
        assert_eq!(scale.color_of(100.0), scale.color_of(8.0), "beyond the far end");
        assert_eq!(scale.color_of(0.0), None);
    }

    #[test]
    fn tick_labels_do_not_touch() {
        for (near_m, far_m) in [(0.9, 2.6), (0.1, 20.0), (3.0, 3.6)] {
            let ticks = DepthScale { near_m, far_m }.ticks();
            assert!(
                !ticks.is_empty() && ticks.windows(2).all(|pair| pair[1].0 - pair[0].0 > 0.1),
                "{ticks:?}"
            );
        }
        assert!(DepthScale { near_m: 0.9, far_m: 2.6 }.ticks().len() >= 3);
    }

    #[test]
    fn the_scale_follows_the_truth_and_a_single_wall_still_has_one() {
        let ramp = (0..64).map(|index| 1.0 + index as f32 * 0.1).collect();
        let scale = DepthScale::of([row(Some(ramp), Some(20.0))].iter());
        assert!(
            (scale.near_m - NEAR_M).abs() < 1e-6 && (scale.far_m - 7.3).abs() < 0.2,
            "{scale:?}"
        );
        let scale = DepthScale::of([row(None, Some(2.0))].iter());
        assert!(scale.share(2.0).is_finite() && scale.far_m > scale.near_m);
        assert!(DepthScale::of([row(None, None)].iter()).share(1.0).is_finite());
    }
}
