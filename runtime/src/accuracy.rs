//! Depth metrics against ground truth as in the literature (Eigen et al. 2014): per frame, then the mean over frames. The
//! robot's decisions do not use them.

use hal::DepthMap;
use serde::{Deserialize, Serialize};

use crate::perception::DepthEstimate;

/// Minimum ground truth that is evaluated, metres.
const MIN_TRUTH_M: f32 = 0.1;
/// Maximum ground truth that is evaluated, metres.
const MAX_TRUTH_M: f32 = 20.0;

/// Metrics of one set of pixels of one frame, or their mean over frames.
///
/// `delta1`, `delta2`, `delta3` are the shares of pixels with max(p/t, t/p) below 1.25, 1.25^2, 1.25^3 after the
/// prediction was multiplied by median(truth) / median(prediction), as papers on monocular depth report it. The
/// `_unscaled` values and `abs_rel`, `rmse_m` use the prediction in metres, as the robot does.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Metrics {
    /// Share of the pixels with ground truth that are evaluated. A frame without depth counts as 0.
    pub share: f64,
    /// Share of all pixels with ground truth whose depth is within 1.25 of it, metric. Unlike in `delta1_unscaled`, missing
    /// depth counts as wrong, so that sources with depth at different pixels can be compared.
    pub right: f64,
    /// Median-scaled share below 1.25.
    pub delta1: f64,
    /// Median-scaled share below 1.25^2.
    pub delta2: f64,
    /// Median-scaled share below 1.25^3.
    pub delta3: f64,
    /// Metric share below 1.25.
    pub delta1_unscaled: f64,
    /// Metric share below 1.25^2.
    pub delta2_unscaled: f64,
    /// Metric share below 1.25^3.
    pub delta3_unscaled: f64,
    /// Mean of |p - t| / t, metric.
    pub abs_rel: f64,
    /// Mean of |p - t| / t, median-scaled.
    pub abs_rel_scaled: f64,
    /// Root of the mean of (p - t)^2, metric, metres.
    pub rmse_m: f64,
    /// Root of the mean of (p - t)^2, median-scaled, metres.
    pub rmse_m_scaled: f64,
}

impl Metrics {
    fn add(&mut self, mut other: Self) {
        for (sum, value) in self.fields_mut().into_iter().zip(other.fields_mut()) {
            *sum += *value;
        }
    }

    fn fields_mut(&mut self) -> [&mut f64; 12] {
        [
            &mut self.share,
            &mut self.right,
            &mut self.delta1,
            &mut self.delta2,
            &mut self.delta3,
            &mut self.delta1_unscaled,
            &mut self.delta2_unscaled,
            &mut self.delta3_unscaled,
            &mut self.abs_rel,
            &mut self.abs_rel_scaled,
            &mut self.rmse_m,
            &mut self.rmse_m_scaled,
        ]
    }
}

/// The metrics of one source of depth. `None` without any evaluated pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct AccuracyRows {
    /// Every pixel with depth and ground truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub all: Option<Metrics>,
    /// The more confident half of them. Pixels with the same confidence as the last of that half are included, so that a source
    /// with constant confidence gets the metrics of `all`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub confident: Option<Metrics>,
}

/// A depth map and its ground truth have different sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "depth is {got_width}x{got_height} but its ground truth is {want_width}x{want_height}; resample one of them"
)]
pub struct SizeMismatch {
    got_width: usize,
    got_height: usize,
    want_width: usize,
    want_height: usize,
}

/// Mean over frames of per-frame metrics.
#[derive(Debug, Clone, Default)]
pub struct Accuracy {
    all: Sum,
    confident: Sum,
    scratch: Scratch,
}

impl Accuracy {
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one frame. `None` is a frame without depth: it lowers `share` and `right` only. A frame without any ground truth in
    /// range is ignored.
    ///
    /// # Errors
    /// [`SizeMismatch`]; the frame is then ignored.
    pub fn add(
        &mut self,
        estimate: Option<&DepthEstimate>,
        truth: &DepthMap,
    ) -> Result<(), SizeMismatch> {
        let pixels = &mut self.scratch;
        let with_truth = match estimate {
            Some(estimate) => {
                same_size(&estimate.depth, truth)?;
                pixels.collect(&estimate.depth, &estimate.confidence, truth, |_| true)
            }
            None => {
                pixels.clear();
                truth.values().iter().filter(|t| in_range(**t)).count()
            }
        };
        self.count(with_truth);
        Ok(())
    }

    /// Adds the pixels of one frame at which `other` has depth, too: compares two sources of depth on the same pixels.
    ///
    /// # Errors
    /// [`SizeMismatch`]; the frame is then ignored.
    pub fn add_where(
        &mut self,
        estimate: &DepthEstimate,
        other: &DepthMap,
        truth: &DepthMap,
    ) -> Result<(), SizeMismatch> {
        same_size(&estimate.depth, truth)?;
        same_size(other, truth)?;
        let with_truth = self
            .scratch
            .collect(&estimate.depth, &estimate.confidence, truth, |at| other.values()[at] > 0.0);
        self.count(with_truth);
        Ok(())
    }

    fn count(&mut self, with_truth: usize) {
        if with_truth == 0 {
            return;
        }
        let pixels = &mut self.scratch;
        self.all.add(pixels.metrics(with_truth));
        pixels.keep_confident_half();
        self.confident.add(pixels.metrics(with_truth));
    }

    /// The means over all frames so far.
    #[must_use]
    pub fn rows(&self) -> AccuracyRows {
        AccuracyRows { all: self.all.mean(), confident: self.confident.mean() }
    }
}

/// A baseline: one depth for the whole image, the median of its *ground truth*. No robot knows that number, and yet it gets a
/// high score in shallow scenes.
#[derive(Debug, Clone, Default)]
pub struct ConstantBaseline {
    all: Sum,
    scratch: Scratch,
}

impl ConstantBaseline {
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one frame, as [`Accuracy::add`].
    pub fn add(&mut self, truth: &DepthMap) {
        let pixels = &mut self.scratch;
        pixels.clear();
        pixels.truth.extend(truth.values().iter().copied().filter(|t| in_range(*t)));
        if let Some(median_m) = median(&pixels.truth, &mut pixels.sorted) {
            pixels.predicted.resize(pixels.truth.len(), median_m);
            self.all.add(pixels.metrics(pixels.truth.len()));
        }
    }

    /// The means over all frames so far.
    #[must_use]
    pub fn rows(&self) -> AccuracyRows {
        AccuracyRows { all: self.all.mean(), confident: None }
    }
}

#[derive(Debug, Clone, Default)]
struct Sum {
    frames: u64,
    /// Frames with at least one evaluated pixel; the others have `share` and `right` and no other value.
    measured: u64,
    total: Metrics,
}

impl Sum {
    fn add(&mut self, image: Option<Metrics>) {
        self.frames += 1;
        if let Some(metrics) = image {
            self.measured += 1;
            self.total.add(metrics);
        }
    }

    fn mean(&self) -> Option<Metrics> {
        if self.measured == 0 {
            return None;
        }
        let mut mean = self.total;
        for value in mean.fields_mut() {
            *value /= self.measured as f64;
        }
        mean.share = self.total.share / self.frames as f64;
        mean.right = self.total.right / self.frames as f64;
        Some(mean)
    }
}

/// Pixels that have both a prediction and ground truth, in parallel arrays.
#[derive(Debug, Clone, Default)]
struct Scratch {
    predicted: Vec<f32>,
    truth: Vec<f32>,
    confidence: Vec<f32>,
    sorted: Vec<u32>,
}

impl Scratch {
    fn clear(&mut self) {
        self.predicted.clear();
        self.truth.clear();
        self.confidence.clear();
    }

    /// Collects the pixels with ground truth in range and a prediction for whose index `include` is true. Returns the number
    /// of pixels with ground truth in range.
    fn collect(
        &mut self,
        depth: &DepthMap,
        confidence: &[f32],
        truth: &DepthMap,
        include: impl Fn(usize) -> bool,
    ) -> usize {
        self.clear();
        let mut with_truth = 0;
        for (at, ((&p, &t), &c)) in
            depth.values().iter().zip(truth.values()).zip(confidence).enumerate()
        {
            if in_range(t) {
                with_truth += 1;
                if p > 0.0 && include(at) {
                    self.predicted.push(p);
                    self.truth.push(t);
                    self.confidence.push(c);
                }
            }
        }
        with_truth
    }

    fn keep_confident_half(&mut self) {
        let count = self.confidence.len();
        if count == 0 {
            return;
        }
        let least = upper_median(&self.confidence, &mut self.sorted);
        let mut kept = 0;
        for index in 0..count {
            if self.confidence[index] >= least {
                self.predicted[kept] = self.predicted[index];
                self.truth[kept] = self.truth[index];
                kept += 1;
            }
        }
        self.predicted.truncate(kept);
        self.truth.truncate(kept);
    }

    fn metrics(&mut self, with_truth: usize) -> Option<Metrics> {
        let median_truth = median(&self.truth, &mut self.sorted)?;
        let median_predicted = median(&self.predicted, &mut self.sorted)?;
        let metric = Errors::of(&self.predicted, &self.truth, 1.0);
        let scaled = Errors::of(&self.predicted, &self.truth, median_truth / median_predicted);
        let share = self.truth.len() as f64 / with_truth as f64;
        Some(Metrics {
            share,
            right: share * metric.delta[0],
            delta1: scaled.delta[0],
            delta2: scaled.delta[1],
            delta3: scaled.delta[2],
            delta1_unscaled: metric.delta[0],
            delta2_unscaled: metric.delta[1],
            delta3_unscaled: metric.delta[2],
            abs_rel: metric.abs_rel,
            abs_rel_scaled: scaled.abs_rel,
            rmse_m: metric.rmse_m,
            rmse_m_scaled: scaled.rmse_m,
        })
    }
}

struct Errors {
    delta: [f64; 3],
    abs_rel: f64,
    rmse_m: f64,
}

impl Errors {
    fn of(predicted: &[f32], truth: &[f32], scale: f32) -> Self {
        // Short runs are summed in f32 lanes, which the compiler can vectorise, their totals in f64.
        const RUN: usize = 256;
        let mut delta = [0_u64; 3];
        let mut relative = 0.0_f64;
        let mut square = 0.0_f64;
        for (predicted, truth) in predicted.chunks(RUN).zip(truth.chunks(RUN)) {
            let mut hits = [0_u32; 3];
            let mut run_relative = [0.0_f32; 8];
            let mut run_square = [0.0_f32; 8];
            for (lane, (&p, &t)) in predicted.iter().zip(truth).enumerate() {
                let p = p * scale;
                let low = p.min(t);
                let high = p.max(t);
                hits[0] += u32::from(high < 1.25 * low);
                hits[1] += u32::from(high < 1.5625 * low);
                hits[2] += u32::from(high < 1.953_125 * low);
                run_relative[lane % 8] += (high - low) / t;
                run_square[lane % 8] += (high - low) * (high - low);
            }
            for (total, run) in delta.iter_mut().zip(hits) {
                *total += u64::from(run);
            }
            relative += run_relative.iter().map(|v| f64::from(*v)).sum::<f64>();
            square += run_square.iter().map(|v| f64::from(*v)).sum::<f64>();
        }
        let count = truth.len() as f64;
        Self {
            delta: delta.map(|hits| hits as f64 / count),
            abs_rel: relative / count,
            rmse_m: (square / count).sqrt(),
        }
    }
}

fn in_range(truth_m: f32) -> bool {
    (MIN_TRUTH_M..=MAX_TRUTH_M).contains(&truth_m)
}

fn same_size(depth: &DepthMap, truth: &DepthMap) -> Result<(), SizeMismatch> {
    if (depth.width(), depth.height()) == (truth.width(), truth.height()) {
        return Ok(());
    }
    Err(SizeMismatch {
        got_width: depth.width(),
        got_height: depth.height(),
        want_width: truth.width(),
        want_height: truth.height(),
    })
}

/// Positive floats have the same order as their bit patterns, and selection is faster with integers.
fn load_bits(values: &[f32], bits: &mut Vec<u32>) {
    bits.clear();
    bits.extend(values.iter().map(|value| value.to_bits()));
}

/// The middle of the values, or the mean of the two middle ones. `values` are not negative.
fn median(values: &[f32], scratch: &mut Vec<u32>) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    load_bits(values, scratch);
    let (below, &mut upper, _) = scratch.select_nth_unstable(values.len() / 2);
    let upper = f32::from_bits(upper);
    let even = values.len().is_multiple_of(2);
    let lower = below.iter().max().filter(|_| even).map_or(upper, |bits| f32::from_bits(*bits));
    Some(lower + (upper - lower) / 2.0)
}

/// The smallest value of the upper half, which includes the middle value of an odd number. `values` are not negative and not
/// empty.
fn upper_median(values: &[f32], scratch: &mut Vec<u32>) -> f32 {
    load_bits(values, scratch);
    f32::from_bits(*scratch.select_nth_unstable(values.len() / 2).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn row(values: &[f32]) -> DepthMap {
        DepthMap::from_vec(values.len(), 1, values.to_vec()).unwrap()
    }

    fn estimate(values: &[f32], confidence: &[f32]) -> DepthEstimate {
        DepthEstimate { depth: row(values), confidence: confidence.to_vec() }
    }

    fn rows_of(values: &[f32], confidence: &[f32], truth: &[f32]) -> AccuracyRows {
        let mut accuracy = Accuracy::new();
        accuracy.add(Some(&estimate(values, confidence)), &row(truth)).unwrap();
        accuracy.rows()
    }

    #[test]
    fn a_perfect_prediction_has_no_error() {
        let all = rows_of(&[1.0, 2.0, 3.0], &[1.0, 0.5, 0.2], &[1.0, 2.0, 3.0]).all.unwrap();
        assert_eq!((all.share, all.delta1, all.delta1_unscaled), (1.0, 1.0, 1.0));
        assert_eq!(
            (all.abs_rel, all.rmse_m, all.abs_rel_scaled, all.rmse_m_scaled),
            (0.0, 0.0, 0.0, 0.0)
        );
    }

    #[test]
    fn a_prediction_of_twice_the_depth_is_right_only_after_scaling() {
        let all = rows_of(&[2.0, 4.0, 6.0], &[1.0; 3], &[1.0, 2.0, 3.0]).all.unwrap();
        assert_eq!((all.delta1, all.delta1_unscaled, all.delta3_unscaled), (1.0, 0.0, 0.0));
        assert_eq!((all.abs_rel, all.abs_rel_scaled), (1.0, 0.0));
        assert!((all.rmse_m - (14.0_f64 / 3.0).sqrt()).abs() < 1e-6);
    }

    #[test]
    fn pixels_without_truth_or_outside_the_range_do_not_count() {
        let all = rows_of(&[1.0, 9.0, 9.0, 9.0, 0.0], &[1.0; 5], &[1.0, 0.0, 0.05, 20.5, 2.0])
            .all
            .unwrap();
        assert_eq!((all.share, all.delta1_unscaled), (0.5, 1.0));
    }

    #[test]
    fn the_confident_half_is_chosen_by_confidence_alone() {
        let rows = rows_of(&[5.0, 2.0, 5.0, 2.0], &[0.1, 0.9, 0.2, 0.8], &[2.0; 4]);
        assert_eq!(rows.all.unwrap().delta1_unscaled, 0.5);
        let confident = rows.confident.unwrap();
        assert_eq!((confident.share, confident.delta1_unscaled), (0.5, 1.0));
    }

    #[test]
    fn equal_confidence_includes_all_pixels() {
        let rows = rows_of(&[5.0, 2.0, 5.0, 2.0], &[0.7; 4], &[2.0; 4]);
        assert_eq!(rows.confident, rows.all);
    }

    #[test]
    fn an_image_without_depth_lowers_the_share_and_what_is_right_of_all() {
        let mut accuracy = Accuracy::new();
        accuracy.add(Some(&estimate(&[2.0, 2.0], &[1.0, 0.5])), &row(&[2.0, 2.0])).unwrap();
        accuracy.add(None, &row(&[2.0, 2.0])).unwrap();
        let all = accuracy.rows().all.unwrap();
        assert_eq!((all.share, all.delta1, all.right), (0.5, 1.0, 0.5));
    }

    #[test]
    fn missing_depth_counts_as_wrong_among_all_pixels() {
        let all = rows_of(&[2.0, 3.0, 0.0, 0.0], &[1.0; 4], &[2.0; 4]).all.unwrap();
        assert_eq!((all.delta1_unscaled, all.right), (0.5, 0.25));
    }

    #[test]
    fn two_sources_are_compared_on_the_pixels_that_both_have() {
        let mut accuracy = Accuracy::new();
        let network = estimate(&[2.0, 9.0, 2.0, 9.0], &[1.0; 4]);
        accuracy.add_where(&network, &row(&[5.0, 5.0, 5.0, 0.0]), &row(&[2.0; 4])).unwrap();
        let all = accuracy.rows().all.unwrap();
        assert_eq!((all.share, all.right), (0.75, 0.5));
        assert!((all.delta1_unscaled - 2.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn the_mean_is_over_frames_not_over_pixels() {
        let mut accuracy = Accuracy::new();
        accuracy.add(Some(&estimate(&[2.0], &[1.0])), &row(&[2.0])).unwrap();
        accuracy.add(Some(&estimate(&[9.0, 9.0, 9.0], &[1.0; 3])), &row(&[2.0; 3])).unwrap();
        assert_eq!(accuracy.rows().all.unwrap().delta1_unscaled, 0.5);
    }

    #[test]
    fn the_constant_is_the_median_of_the_truth() {
        let mut constant = ConstantBaseline::new();
        constant.add(&row(&[1.0, 2.0, 2.2, 10.0, 0.0]));
        let all = constant.rows().all.unwrap();
        assert_eq!((all.share, all.delta1, all.delta1_unscaled), (1.0, 0.5, 0.5));
    }

    #[test]
    fn rows_without_a_value_are_absent_from_json() {
        let mut constant = ConstantBaseline::new();
        assert_eq!(serde_json::to_string(&constant.rows()).unwrap(), "{}");
        constant.add(&row(&[1.0]));
        let json = serde_json::to_value(constant.rows()).unwrap();
        assert!(json.get("confident").is_none());
        assert_eq!(json["all"]["delta1"], 1.0);
    }

    #[test]
    fn another_size_is_refused() {
        let error = Accuracy::new()
            .add(Some(&DepthEstimate::none(2, 1)), &DepthMap::none(1, 2))
            .unwrap_err();
        assert!(error.to_string().contains("2x1") && error.to_string().contains("1x2"));
    }

    fn sorted_median(values: impl Iterator<Item = f64>) -> f64 {
        let mut values: Vec<f64> = values.collect();
        values.sort_by(f64::total_cmp);
        (values[(values.len() - 1) / 2] + values[values.len() / 2]) / 2.0
    }

    /// Share of the (prediction, truth) pairs with max(p/t, t/p) below `limit` after scaling.
    fn share_below(pairs: &[(f64, f64)], scale: f64, limit: f64) -> f64 {
        let below =
            pairs.iter().filter(|(p, t)| (p * scale / t).max(t / (p * scale)) < limit).count();
        below as f64 / pairs.len() as f64
    }

    proptest! {
        #[test]
        fn metrics_equal_their_definitions(
            pixels in prop::collection::vec((0.0..30.0_f32, 0.0..25.0_f32, 0.0..1.0_f32), 1..700),
        ) {
            let (p, (t, c)): (Vec<_>, (Vec<_>, Vec<_>)) = pixels.iter().map(|(p, t, c)| (*p, (*t, *c))).unzip();
            let rows = rows_of(&p, &c, &t);
            let pairs: Vec<(f64, f64)> = p.iter().zip(&t).filter(|(p, t)| **p > 0.0 && in_range(**t))
                .map(|(p, t)| (f64::from(*p), f64::from(*t))).collect();
            prop_assume!(!pairs.is_empty());
            let scale = sorted_median(pairs.iter().map(|x| x.1)) / sorted_median(pairs.iter().map(|x| x.0));
            let n = pairs.len() as f64;
            let abs_rel = pairs.iter().map(|(p, t)| (p * scale - t).abs() / t).sum::<f64>() / n;
            let all = rows.all.unwrap();
            // One pixel may fall on the other side of the limit by rounding.
            prop_assert!((all.delta1 - share_below(&pairs, scale, 1.25)).abs() < 1.5 / n);
            prop_assert!((all.delta3_unscaled - share_below(&pairs, 1.0, 1.25_f64.powi(3))).abs() < 1.5 / n);
            prop_assert!((all.abs_rel_scaled / abs_rel.max(1e-6) - 1.0).abs() < 1e-3 || abs_rel < 1e-6);
            let half = rows.confident.unwrap();
            prop_assert!(half.share >= all.share / 2.0 && half.share <= all.share);
        }
    }
}
