//! One engine on one sequence.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use firmware_host::report::depth_sample::{SheetRow, SheetSampler};
use firmware_host::report::depth_sheet::{DEPTH_FILE, DepthSheet};
use hal::ImageView;
use runtime::accuracy::{Accuracy, ConstantBaseline, Metrics};

use crate::disturbance::Disturbance;
use crate::engine::Engine;
use crate::reliability::Reliability;
use crate::sequence::Sequence;

/// One line of the table.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// The sequence and what disturbs it.
    pub name: String,
    /// Who looked.
    pub engine: String,
    /// All pixels with depth.
    pub all: Metrics,
    /// Their most confident half.
    pub half: Metrics,
    /// delta1 of the median of the ground truth.
    pub constant: f64,
    /// Median time of one frame, seconds.
    pub median_s: f64,
    /// Whether the confidence means what it says.
    pub reliability: Reliability,
}

impl Outcome {
    /// The table's head. delta1 everywhere; `share` is the share of the pixels with ground truth.
    #[must_use]
    pub fn head() -> String {
        format!(
            "| {:<44} | {:<10} | {:>5} | {:>6} | {:>5} | {:>5} | {:>6} | {:>5} | {:>8} | {:>5} | {:>7} |\n|{}|",
            "sequence",
            "engine",
            "all",
            "scaled",
            "share",
            "half",
            "scaled",
            "share",
            "constant",
            "calib",
            "ms",
            "---|".repeat(10) + "---",
        )
    }

    /// One line of the table.
    #[must_use]
    pub fn line(&self) -> String {
        let all = &self.all;
        let half = &self.half;
        format!(
            "| {:<44} | {:<10} | {:.3} | {:>6.3} | {:.3} | {:.3} | {:>6.3} | {:.3} | {:>8.3} | {:.3} | {:>7.2} |",
            self.name,
            self.engine,
            all.delta1_unscaled,
            all.delta1,
            all.share,
            half.delta1_unscaled,
            half.delta1,
            half.share,
            self.constant,
            self.reliability.error(),
            1e3 * self.median_s,
        )
    }

    /// The mean of lines that have depth.
    #[must_use]
    pub fn mean(all: &[Self]) -> Self {
        let seen: Vec<&Self> = all.iter().filter(|outcome| outcome.all.share > 0.0).collect();
        let mean = |value: fn(&Self) -> f64| {
            seen.iter().map(|outcome| value(outcome)).sum::<f64>() / seen.len() as f64
        };
        let mut reliability = Reliability::default();
        seen.iter().for_each(|outcome| reliability.add_normalised(&outcome.reliability));
        let metrics = |of: fn(&Self) -> &Metrics| {
            let mean = |value: fn(&Metrics) -> f64| {
                seen.iter().map(|outcome| value(of(outcome))).sum::<f64>() / seen.len() as f64
            };
            let share = mean(|m| m.share);
            let delta1 = mean(|m| m.delta1);
            let delta1_unscaled = mean(|m| m.delta1_unscaled);
            Metrics { share, delta1, delta1_unscaled, ..Metrics::default() }
        };
        Self {
            name: "mean of those with depth".to_owned(),
            engine: all.first().map_or_else(String::new, |first| first.engine.clone()),
            all: metrics(|outcome| &outcome.all),
            half: metrics(|outcome| &outcome.half),
            constant: mean(|outcome| outcome.constant),
            median_s: mean(|outcome| outcome.median_s),
            reliability,
        }
    }
}

/// Lets an engine look at every frame and judges every `every`th; `sheet` is a folder for a frame of what it saw.
///
/// # Errors
/// When frames and truth do not fit, the engine cannot work, or the sheet cannot be written.
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
        let (rgb, pose) = disturbance.of(index, view);
        let frame = ImageView::rgb8(sequence.camera.width, sequence.camera.height, &rgb)?;
        let began = Instant::now();
        let wanted = index.is_multiple_of(every);
        let found = engine.look(frame, &pose, wanted)?;
        if !wanted {
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
            SheetRow::capture(index as u64, &frame, found.as_ref(), None, Some(truth))
        });
    }
    seconds.sort_by(f64::total_cmp);
    let name = [sequence.name.as_str(), disturbance.name()].join(" ").trim().to_owned();
    if let Some(folder) = sheet {
        let folder = folder.join(sequence.name.replace(|c: char| !c.is_alphanumeric(), "_"));
        std::fs::create_dir_all(&folder)?;
        DepthSheet { title: &name, rows: &sampler.into_rows() }.write(&folder)?;
        anyhow::ensure!(
            folder.join(DEPTH_FILE).exists() || accuracy.rows().all.is_none(),
            "no sheet of {name}"
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
        reliability,
    })
}
