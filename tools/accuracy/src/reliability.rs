//! Calibration of the confidence: of the pixels with a confidence of 0.8, 80 % should be right.

use std::path::Path;

use firmware_host::report::atomic::ReportError;
use firmware_host::report::canvas::{Canvas, Font};
use hal::DepthMap;
use runtime::perception::DepthEstimate;

const BINS: usize = 10;
const SIDE: i64 = 400;
const MARGIN: i64 = 70;
const INK: [u8; 3] = [40, 44, 52];
const FAINT: [u8; 3] = [200, 204, 210];
const BAR: [u8; 3] = [90, 140, 200];

/// Histogram of pixels by confidence, with the share of right pixels in each bin.
#[derive(Debug, Clone, Copy, Default)]
pub struct Reliability {
    bins: [Bin; BINS],
}

#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    pixels: f64,
    confidence: f64,
    right: f64,
}

impl Reliability {
    /// Adds the pixels of one frame.
    pub fn add(&mut self, estimate: &DepthEstimate, truth: &DepthMap) {
        let pixels = estimate.depth.values().iter().zip(&estimate.confidence).zip(truth.values());
        for ((&depth, &confidence), &truth) in
            pixels.filter(|((depth, _), truth)| **depth > 0.0 && **truth > 0.1)
        {
            let bin = &mut self.bins[((confidence * BINS as f32) as usize).min(BINS - 1)];
            bin.pixels += 1.0;
            bin.confidence += f64::from(confidence);
            bin.right += f64::from(u8::from(depth.max(truth) < 1.25 * depth.min(truth)));
        }
    }

    /// Adds another histogram, normalised so that every histogram counts the same.
    pub fn add_normalised(&mut self, other: &Self) {
        let total: f64 = other.bins.iter().map(|bin| bin.pixels).sum();
        for (bin, other) in self.bins.iter_mut().zip(&other.bins).filter(|_| total > 0.0) {
            bin.pixels += other.pixels / total;
            bin.confidence += other.confidence / total;
            bin.right += other.right / total;
        }
    }

    /// Expected calibration error (Naeini et al. 2015): mean difference between the confidence and the share of right pixels.
    /// In a sum of histograms, errors of opposite sign cancel.
    #[must_use]
    pub fn error(&self) -> f64 {
        let total: f64 = self.bins.iter().map(|bin| bin.pixels).sum();
        self.bins.iter().map(|bin| (bin.confidence - bin.right).abs()).sum::<f64>()
            / total.max(f64::MIN_POSITIVE)
    }

    /// Draws the share of right pixels and the number of pixels over confidence.
    ///
    /// # Errors
    /// When the image cannot be written.
    pub fn draw(&self, title: &str, path: &Path) -> Result<(), ReportError> {
        let page = (SIDE + 2 * MARGIN) as u32;
        let mut canvas = Canvas::new(page, page, [255; 3]);
        canvas.text(MARGIN, 16, title, Font::Strong, INK);
        canvas.text(
            MARGIN,
            40,
            &format!("pooled calibration error {:.3}", self.error()),
            Font::Label,
            INK,
        );
        let most = self.bins.iter().map(|bin| bin.pixels).fold(f64::MIN_POSITIVE, f64::max);
        for (index, bin) in self.bins.iter().enumerate() {
            let height = (bin.pixels / most * SIDE as f64 * 0.3) as i64;
            let x = MARGIN + index as i64 * SIDE / BINS as i64;
            canvas.fill(x + 4, MARGIN + SIDE - height, SIDE / BINS as i64 - 8, height, FAINT);
        }
        canvas.frame(MARGIN, MARGIN, SIDE, SIDE, INK);
        canvas.line(position(0.0, 0.0), position(1.0, 1.0), 1.5, FAINT, 1.0);
        let known: Vec<[f64; 2]> = self
            .bins
            .iter()
            .filter(|bin| bin.pixels > 0.002 * most)
            .map(|bin| position(bin.confidence / bin.pixels, bin.right / bin.pixels))
            .collect();
        known.windows(2).for_each(|ends| canvas.line(ends[0], ends[1], 2.5, BAR, 1.0));
        known.iter().for_each(|point| canvas.disc(*point, 5.0, BAR));
        for tick in [0.0, 0.5, 1.0] {
            let [x, y] = position(tick, tick);
            canvas.text_centered(x as i64, MARGIN + SIDE + 8, &format!("{tick}"), Font::Label, INK);
            canvas.text(MARGIN - 34, y as i64 - 8, &format!("{tick}"), Font::Label, INK);
        }
        canvas.text_centered(
            MARGIN + SIDE / 2,
            MARGIN + SIDE + 30,
            "confidence (bars: number of pixels)",
            Font::Label,
            INK,
        );
        canvas.text(MARGIN + 8, MARGIN + 8, "share that is right", Font::Label, INK);
        canvas.write_png(path)
    }
}

/// Position in the diagram of a confidence and a share of right pixels.
fn position(confidence: f64, right: f64) -> [f64; 2] {
    [MARGIN as f64 + confidence * SIDE as f64, (MARGIN + SIDE) as f64 - right * SIDE as f64]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reliability(confidence: f32, right: usize) -> Reliability {
        let depth_m = (0..10).map(|at| if at < right { 2.0 } else { 4.0 });
        let estimate = DepthEstimate {
            depth: DepthMap::from_vec(10, 1, depth_m.collect()).unwrap(),
            confidence: vec![confidence; 10],
        };
        let mut reliability = Reliability::default();
        reliability.add(&estimate, &DepthMap::from_vec(10, 1, vec![2.0; 10]).unwrap());
        reliability
    }

    #[test]
    fn a_calibrated_confidence_has_no_error() {
        assert!(reliability(0.8, 8).error() < 1e-6);
    }

    #[test]
    fn the_error_is_the_difference_between_confidence_and_right_pixels() {
        assert!((reliability(0.8, 5).error() - 0.3).abs() < 1e-6);
        let mut both = Reliability::default();
        both.add_normalised(&reliability(0.8, 5));
        both.add_normalised(&reliability(0.3, 3));
        assert!((both.error() - 0.15).abs() < 1e-6);
    }
}
