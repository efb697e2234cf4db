//! Accuracy and time of the coarse engine on a recorded dataset:
//! `cargo run -p firmware-host --example coarse_accuracy -- DIR [settings as JSON]`.
use std::path::Path;
use std::time::Instant;

use firmware_host::dataset::{Dataset, Sample};
use hal::ImageView;
use runtime::accuracy::{Accuracy, ConstantBaseline, Metrics};
use runtime::perception::{CoarseConfig, CoarseDepth};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().unwrap_or_default();
    let dataset = Dataset::open(Path::new(&folder), 640, 192)?;
    let samples = dataset.samples().collect::<Result<Vec<Sample>, _>>()?;
    let settings: Vec<String> = arguments.collect();
    for settings in if settings.is_empty() { vec!["{}".to_owned()] } else { settings } {
        let config: CoarseConfig = serde_json::from_str(&settings)?;
        measure(&samples, config, &settings)?;
    }
    Ok(())
}

fn measure(samples: &[Sample], config: CoarseConfig, settings: &str) -> anyhow::Result<()> {
    let Some(first) = samples.first() else { return Ok(()) };
    let mut engine = CoarseDepth::new(config, first.camera)?;
    let (mut coarse, mut constant) = (Accuracy::new(), ConstantBaseline::new());
    let mut times_ms = Vec::new();
    let mut without = 0;
    for sample in samples {
        let begin = Instant::now();
        let estimate = engine.estimate(ImageView::rgb8(640, 192, &sample.rgb)?, &sample.t_world_camera);
        if estimate.is_ok() {
            times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        } else {
            without += 1;
        }
        if let Some(truth) = &sample.truth {
            coarse.add(estimate.ok(), truth)?;
            constant.add(truth);
        }
    }
    times_ms.sort_by(f64::total_cmp);
    println!(
        "{settings}: {without} of {} without depth, ms min {:.1} median {:.1}",
        samples.len(),
        times_ms.first().copied().unwrap_or_default(),
        times_ms.get(times_ms.len() / 2).copied().unwrap_or_default()
    );
    let rows = coarse.rows();
    for (name, row) in [("all", rows.all), ("confident", rows.confident), ("constant", constant.rows().all)] {
        if let Some(Metrics { share, delta1, delta1_unscaled, abs_rel, rmse_m, .. }) = row {
            println!(
                "  {name:10} share {share:.3} d1 {delta1:.3} d1_unscaled {delta1_unscaled:.3} abs_rel {abs_rel:.3} rmse {rmse_m:.3}"
            );
        }
    }
    Ok(())
}
