//! Evaluates one method on one sequence.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use firmware_host::report::depth_sample::{FrameDepths, SheetRow, SheetSampler};
use firmware_host::report::depth_scale::DepthScale;
use firmware_host::report::depth_sheet::{DEPTH_FILE, DepthSheet};
use hal::ImageView;
use runtime::accuracy::{Accuracy, ConstantBaseline, Metrics};

use crate::disturbance::Disturbance;
use crate::engine::Engine;
use crate::reliability::Reliability;
use crate::sequence::Sequence;

/// One row of the table.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// The sequence and its disturbance.
    pub name: String,
    pub engine: String,
    /// Metrics of all pixels with depth.
    pub all: Metrics,
    /// Metrics of the more confident half of them.
    pub half: Metrics,
    /// delta1 of a constant depth, the median of the ground truth.
    pub constant: f64,
    /// Median time of one frame, seconds.
    pub median_s: f64,
    /// Calibration error of the confidence; in a mean row, the mean over the sequences.
    pub calibration: f64,
    /// Right pixels by confidence; in a mean row, pooled over the sequences.
    pub reliability: Reliability,
}

impl Outcome {
    /// The table's header. `all`, `half`, `scaled` and `constant` are delta1, `share` is the share of the pixels with ground
    /// truth, `calib` the calibration error.
    #[must_use]
    pub fn head() -> String {
        format!(
            "| {:<44} | {:<10} | {:>5} | {:>6} | {:>5} | {:>5} | {:>6} | {:>5} | {:>5} | {:>8} | {:>5} | {:>7} |\n|{}|",
            "sequence",
            "engine",
            "all",
            "scaled",
            "share",
            "half",
            "scaled",
            "share",
            "right",
            "constant",
            "calib",
            "ms",
            "---|".repeat(11) + "---",
        )
    }

    #[must_use]
    pub fn line(&self) -> String {
        let all = &self.all;
        let half = &self.half;
        format!(
            "| {:<44} | {:<10} | {:.3} | {:>6.3} | {:.3} | {:.3} | {:>6.3} | {:.3} | {:.3} | {:>8.3} | {:.3} | {:>7.2} |",
            self.name,
            self.engine,
            all.delta1_unscaled,
            all.delta1,
            all.share,
            half.delta1_unscaled,
            half.delta1,
            half.share,
            all.right,
            self.constant,
            self.calibration,
            1e3 * self.median_s,
        )
    }

    /// The mean of the rows with depth.
    #[must_use]
    pub fn mean(all: &[Self]) -> Self {
        let with_depth: Vec<&Self> = all.iter().filter(|row| row.all.share > 0.0).collect();
        let mut reliability = Reliability::default();
        for row in &with_depth {
            reliability.add_normalised(&row.reliability);
        }
        Self {
            name: "mean of those with depth".to_owned(),
            engine: all.first().map_or_else(String::new, |first| first.engine.clone()),
            all: mean_metrics(&with_depth, |row| &row.all),
            half: mean_metrics(&with_depth, |row| &row.half),
            constant: mean(&with_depth, |row| row.constant),
            median_s: mean(&with_depth, |row| row.median_s),
            calibration: mean(&with_depth, |row| row.calibration),
            reliability,
        }
    }

    /// The calibration error of a mean row in words: as the mean over the sequences, and pooled.
    #[must_use]
    pub fn calibration_line(&self) -> String {
        format!(
            "{}: calibration error {:.3} (mean over the sequences), {:.3} (pooled over the pixels of all sequences, where errors of \
             opposite sign cancel)",
            self.engine,
            self.calibration,
            self.reliability.error()
        )
    }
}

fn mean(rows: &[&Outcome], value: fn(&Outcome) -> f64) -> f64 {
    rows.iter().map(|row| value(row)).sum::<f64>() / rows.len() as f64
}

/// The mean of the metrics that the table shows.
fn mean_metrics(rows: &[&Outcome], metrics: fn(&Outcome) -> &Metrics) -> Metrics {
    let mut mean = Metrics::default();
    for metrics in rows.iter().map(|row| metrics(row)) {
        mean.share += metrics.share / rows.len() as f64;
        mean.right += metrics.right / rows.len() as f64;
        mean.delta1 += metrics.delta1 / rows.len() as f64;
        mean.delta1_unscaled += metrics.delta1_unscaled / rows.len() as f64;
    }
    mean
}

/// Runs a method on all frames of a sequence and evaluates every `every`th; `sheet` is a folder for images of the depth.
///
/// # Errors
/// When frames and ground truth have different sizes, the method fails, or the sheet cannot be written.
pub fn measure(
    sequence: &Sequence,
    disturbance: Disturbance,
    engine: &mut dyn Engine,
    every: usize,
    sheet: Option<&Path>,
) -> Result<Outcome> {
    let mut accuracy = Accuracy::new();
    let mut constant = ConstantBaseline::new();
    let mut reliability = Reliability::default();
    let mut seconds = Vec::new();
    let mut sampler = SheetSampler::default();
    for (index, view) in sequence.views.iter().enumerate() {
        let (rgb, pose) = disturbance.apply(index, view);
        let frame = ImageView::rgb8(sequence.camera.width, sequence.camera.height, &rgb)?;
        let began = Instant::now();
        let evaluated = index.is_multiple_of(every);
        let found = engine.process(frame, &pose, view, evaluated)?;
        if !evaluated {
            continue;
        }
        seconds.push(began.elapsed().as_secs_f64());
        let Some(truth) = &view.truth else { continue };
        accuracy.add(found.as_ref(), truth)?;
        constant.add(truth);
        if let Some(found) = &found {
            reliability.add(found, truth);
        }
        let depths = usize::from(found.is_some());
        sampler.offer(index as u64, depths, || {
            let depths = FrameDepths {
                coarse: found.as_ref(),
                truth: Some(truth),
                ..FrameDepths::default()
            };
            SheetRow::capture(index as u64, &frame, &depths)
        });
    }
    seconds.sort_by(f64::total_cmp);
    let name = [sequence.name.as_str(), disturbance.name()].join(" ").trim().to_owned();
    if let Some(folder) = sheet {
        let folder = folder.join(sequence.name.replace(|c: char| !c.is_alphanumeric(), "_"));
        std::fs::create_dir_all(&folder)?;
        let rows = sampler.into_rows();
        let scale = DepthScale::of(rows.iter());
        DepthSheet { title: &name, rows: &rows, scale }.write(&folder)?;
        anyhow::ensure!(
            folder.join(DEPTH_FILE).exists() || accuracy.rows().all.is_none(),
            "the depth sheet of {name} was not written"
        );
    }
    let rows = accuracy.rows();
    Ok(Outcome {
        name,
        engine: engine.name(),
        all: rows.all.unwrap_or_default(),
        half: rows.confident.unwrap_or_default(),
        constant: constant.rows().all.map_or(0.0, |metrics| metrics.delta1),
        median_s: seconds.get(seconds.len() / 2).copied().unwrap_or_default(),
        calibration: reliability.error(),
        reliability,
    })
}
