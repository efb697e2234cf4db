//! Selects a few frames, spread over a run of unknown length, and stores them at reduced size for
//! `depth.png`.

use hal::{DepthMap, ImageView, PixelFormat};
use runtime::{
    accuracy::{Accuracy, Metrics},
    perception::DepthEstimate,
    robot::Robot,
};

use super::colors::Rgb;

/// Maximum number of rows of a sheet. A long enough run gets at least half as many.
pub const SHEET_ROWS: usize = 8;

/// Images are reduced to at most this width, pixels.
const WIDTH: usize = 320;

/// One frame at reduced size.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetRow {
    /// Number of the frame in the run.
    pub frame: u64,
    pub width: usize,
    pub height: usize,
    /// The camera's image, row-major.
    pub rgb: Vec<Rgb>,
    /// Coarse depth, if this frame has any.
    pub coarse: Option<SampledDepth>,
    /// Dense depth, if this frame has any.
    pub dense: Option<SampledDepth>,
    /// Depth of the network, if this frame has any.
    pub network: Option<SampledDepth>,
    /// Ground truth, metres; 0 means no value.
    pub truth: Option<Vec<f32>>,
}

/// Estimated depth at reduced size, with its accuracy at full size.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledDepth {
    /// Row-major, metres; 0 means no depth.
    pub depth_m: Vec<f32>,
    /// Probability that each depth is right (within 25 %), 0 to 1, row-major.
    pub confidence: Vec<f32>,
    /// Share of all pixels that have a depth.
    pub share: f64,
    /// Share of pixels within a factor of 1.25 of the ground truth, unscaled.
    pub delta1: Option<f64>,
    /// Mean of |depth - truth| / truth.
    pub abs_rel: Option<f64>,
}

/// The depths of one frame at full size.
#[derive(Debug, Clone, Copy, Default)]
pub struct FrameDepths<'a> {
    pub coarse: Option<&'a DepthEstimate>,
    pub dense: Option<&'a DepthEstimate>,
    pub network: Option<&'a DepthEstimate>,
    pub truth: Option<&'a DepthMap>,
}

impl<'a> FrameDepths<'a> {
    /// What the robot estimated in its last tick.
    #[must_use]
    pub fn of(robot: &'a Robot) -> Self {
        Self {
            coarse: robot.coarse_depth(),
            dense: robot.dense_depth(),
            network: robot.network_depth(),
            truth: None,
        }
    }

    /// How many kinds of depth were measured in this frame. Dense depth does not count: nearly every frame has it.
    #[must_use]
    pub fn count(&self) -> usize {
        usize::from(self.coarse.is_some()) + usize::from(self.network.is_some())
    }
}

impl SheetRow {
    /// Reduces one frame. `None` if the image is not RGB8 or a depth has another size.
    #[must_use]
    pub fn capture(frame: u64, image: &ImageView<'_>, depths: &FrameDepths<'_>) -> Option<Self> {
        let FrameDepths { coarse, dense, network, truth } = *depths;
        let width = image.width();
        let height = image.height();
        let depths = [
            coarse.map(|estimate| &estimate.depth),
            dense.map(|estimate| &estimate.depth),
            network.map(|estimate| &estimate.depth),
            truth,
        ];
        let fits =
            depths.iter().flatten().all(|depth| (depth.width(), depth.height()) == (width, height));
        if image.format() != PixelFormat::Rgb8 || !fits {
            return None;
        }
        let stride = width.div_ceil(WIDTH);
        let pixels: Vec<usize> = kept(width, height, stride).collect();
        Some(Self {
            frame,
            width: width.div_ceil(stride),
            height: height.div_ceil(stride),
            rgb: pixels.iter().map(|index| pixel(image.data(), *index)).collect(),
            coarse: coarse.and_then(|estimate| SampledDepth::of(estimate, truth, &pixels)),
            dense: dense.and_then(|estimate| SampledDepth::of(estimate, truth, &pixels)),
            network: network.and_then(|estimate| SampledDepth::of(estimate, truth, &pixels)),
            truth: truth.map(|truth| select(truth.values(), &pixels)),
        })
    }
}

impl SampledDepth {
    fn of(estimate: &DepthEstimate, truth: Option<&DepthMap>, pixels: &[usize]) -> Option<Self> {
        let values = estimate.depth.values();
        let share =
            values.iter().filter(|depth| **depth > 0.0).count() as f64 / values.len().max(1) as f64;
        let metrics = truth.and_then(|truth| judge(estimate, truth));
        (share > 0.0).then(|| Self {
            depth_m: select(values, pixels),
            confidence: select(&estimate.confidence, pixels),
            share,
            delta1: metrics.map(|metrics| metrics.delta1_unscaled),
            abs_rel: metrics.map(|metrics| metrics.abs_rel),
        })
    }
}

fn judge(estimate: &DepthEstimate, truth: &DepthMap) -> Option<Metrics> {
    let mut accuracy = Accuracy::new();
    accuracy.add(Some(estimate), truth).ok()?;
    accuracy.rows().all.filter(|metrics| metrics.share > 0.0)
}

fn select(values: &[f32], pixels: &[usize]) -> Vec<f32> {
    pixels.iter().map(|index| values[*index]).collect()
}

/// Indices of the pixels of the reduced image: every `stride`-th one, because a mean of two depths
/// would be the depth of nothing.
fn kept(width: usize, height: usize, stride: usize) -> impl Iterator<Item = usize> {
    let rows = (0..height).step_by(stride);
    rows.flat_map(move |row| (0..width).step_by(stride).map(move |column| row * width + column))
}

fn pixel(data: &[u8], index: usize) -> Rgb {
    let at = 3 * index;
    data.get(at..at + 3).map_or([0; 3], |rgb| [rgb[0], rgb[1], rgb[2]])
}

/// Spreads the rows of a sheet over a run of unknown length.
///
/// The run is divided into equal slots. Each slot keeps the first of its frames with the most depth
/// sources. If there are too many slots, pairs of slots are merged.
#[derive(Debug, Clone)]
pub struct SheetSampler {
    slot_frames: u64,
    kept: Vec<(usize, SheetRow)>,
}

impl Default for SheetSampler {
    fn default() -> Self {
        Self { slot_frames: 1, kept: Vec::new() }
    }
}

impl SheetSampler {
    /// Offers a frame for which `depths` sources have a depth. `capture` is called only if the
    /// frame is kept. Frames must come in increasing order.
    pub fn offer(&mut self, frame: u64, depths: usize, capture: impl FnOnce() -> Option<SheetRow>) {
        let slot = frame / self.slot_frames;
        let rival = self
            .kept
            .last()
            .filter(|(_, row)| row.frame / self.slot_frames == slot)
            .map(|(depths, _)| *depths);
        if rival.is_some_and(|rival| rival >= depths) {
            return;
        }
        let Some(row) = capture() else { return };
        if rival.is_some() {
            self.kept.pop();
        }
        self.kept.push((depths, row));
        while self.kept.len() > SHEET_ROWS {
            self.slot_frames *= 2;
            self.thin_out();
        }
    }

    /// The selected rows, in the order of the run.
    #[must_use]
    pub fn into_rows(self) -> Vec<SheetRow> {
        self.kept.into_iter().map(|(_, row)| row).collect()
    }

    /// Keeps one row per slot: the first one with the most depths.
    fn thin_out(&mut self) {
        let slot_frames = self.slot_frames;
        self.kept.dedup_by(|later, earlier| {
            let same_slot = later.1.frame / slot_frames == earlier.1.frame / slot_frames;
            if same_slot && later.0 > earlier.0 {
                std::mem::swap(later, earlier);
            }
            same_slot
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(width: usize, height: usize, depth_m: f32) -> DepthEstimate {
        let depth = DepthMap::from_vec(width, height, vec![depth_m; width * height]).unwrap();
        DepthEstimate { depth, confidence: vec![1.0; width * height] }
    }

    fn of_coarse(coarse: &DepthEstimate) -> FrameDepths<'_> {
        FrameDepths { coarse: Some(coarse), ..FrameDepths::default() }
    }

    fn row(frame: u64, with_depth: bool) -> Option<SheetRow> {
        let rgb = [7; 4 * 2 * 3];
        let image = ImageView::rgb8(4, 2, &rgb).unwrap();
        let coarse = with_depth.then(|| estimate(4, 2, 2.0));
        let depths = FrameDepths { coarse: coarse.as_ref(), ..FrameDepths::default() };
        SheetRow::capture(frame, &image, &depths)
    }

    fn sampled(frames: u64, depths: impl Fn(u64) -> usize) -> Vec<SheetRow> {
        let mut sampler = SheetSampler::default();
        (0..frames).for_each(|frame| {
            sampler.offer(frame, depths(frame), || row(frame, depths(frame) > 0));
        });
        sampler.into_rows()
    }

    #[test]
    fn rows_are_spread_over_runs_of_any_length() {
        for frames in [1u64, 3, 8, 9, 100, 360, 3000, 30_000] {
            let kept: Vec<u64> = sampled(frames, |_| 1).iter().map(|row| row.frame).collect();
            let enough = frames.min(SHEET_ROWS as u64 / 2) as usize;
            assert!((enough..=SHEET_ROWS).contains(&kept.len()), "{frames}: {kept:?}");
            assert!(
                kept.windows(2).all(|pair| pair[1] - pair[0] <= frames.div_ceil(4)),
                "{frames}: {kept:?}"
            );
        }
    }

    #[test]
    fn a_slot_prefers_the_frame_with_the_most_depths() {
        let rows = sampled(1000, |frame| usize::from(frame % 50 == 17) + usize::from(frame > 2));
        assert!(rows.len() >= 4);
        assert!(
            rows.iter().all(|row| row.frame % 50 == 17),
            "{:?}",
            rows.iter().map(|row| row.frame).collect::<Vec<_>>()
        );
    }

    #[test]
    fn a_run_without_any_depth_still_shows_its_frames() {
        let rows = sampled(50, |_| 0);
        assert!(rows.len() >= 4 && rows[0].coarse.is_none());
    }

    #[test]
    fn wide_images_are_reduced_and_small_ones_are_not() {
        let rgb = vec![9; 640 * 192 * 3];
        let image = ImageView::rgb8(640, 192, &rgb).unwrap();
        let wide = SheetRow::capture(5, &image, &of_coarse(&estimate(640, 192, 3.0))).unwrap();
        assert_eq!((wide.width, wide.height, wide.rgb.len()), (320, 96, 320 * 96));
        assert_eq!(wide.coarse.unwrap().depth_m, vec![3.0; 320 * 96]);
        assert_eq!(row(0, true).unwrap().width, 4);
    }

    #[test]
    fn accuracy_is_computed_at_full_size() {
        let rgb = [7; 4 * 2 * 3];
        let image = ImageView::rgb8(4, 2, &rgb).unwrap();
        let truth = DepthMap::from_vec(4, 2, vec![2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 4.0, 4.0]).unwrap();
        let row = SheetRow::capture(
            0,
            &image,
            &FrameDepths { truth: Some(&truth), ..of_coarse(&estimate(4, 2, 2.0)) },
        )
        .unwrap();
        let coarse = row.coarse.unwrap();
        assert!(
            (coarse.delta1.unwrap() - 0.75).abs() < 1e-6
                && (coarse.abs_rel.unwrap() - 0.125).abs() < 1e-6
        );
    }

    #[test]
    fn a_depth_of_another_size_is_refused() {
        let rgb = [7; 4 * 2 * 3];
        let image = ImageView::rgb8(4, 2, &rgb).unwrap();
        assert!(SheetRow::capture(0, &image, &of_coarse(&estimate(4, 3, 2.0))).is_none());
        let gray = ImageView::new(4, 2, PixelFormat::Gray8, &rgb[..8]).unwrap();
        assert!(SheetRow::capture(0, &gray, &FrameDepths::default()).is_none());
    }
}
