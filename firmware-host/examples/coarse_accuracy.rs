//! Accuracy and time of the coarse engine on a recorded dataset:
//! `cargo run -p firmware-host --example coarse_accuracy -- DIR [settings as JSON]`.
use std::path::Path;
use std::time::Instant;

use firmware_host::dataset::{Dataset, Sample};
use hal::ImageView;
use runtime::accuracy::{Accuracy, ConstantBaseline, Metrics};
use runtime::perception::{CoarseConfig, CoarseDepth, DepthEstimate};

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
    let begin_cpu = cpu_ms();
    let stride: usize = std::env::var("STRIDE").ok().and_then(|v| v.parse().ok()).unwrap_or(1);
    let sheet = std::env::var("SHEET").ok();
    for (index, sample) in samples.iter().enumerate().step_by(stride) {
        let begin = Instant::now();
        let estimate = engine.estimate(ImageView::rgb8(640, 192, &sample.rgb)?, &sample.t_world_camera);
        if estimate.is_ok() {
            times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        } else {
            without += 1;
        }
        if let (Some(sheet), Ok(estimate), Some(truth), true) = (&sheet, &estimate, &sample.truth, index % 6 == 0) {
            draw(&format!("{sheet}{index:04}.png"), sample, estimate, truth)?;
        }
        if let (Some(truth), true) = (&sample.truth, std::env::var("EACH").is_ok()) {
            let mut one = Accuracy::new();
            one.add(estimate.as_ref().ok().copied(), truth)?;
            if let (Some(all), Some(half)) = (one.rows().all, one.rows().confident) {
                println!(
                    "    {index}: all {:.2} {:.2} half {:.2} {:.2}",
                    all.delta1, all.delta1_unscaled, half.delta1, half.delta1_unscaled
                );
            }
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
    println!("  cpu ms/frame {:.1}", cpu_ms() / times_ms.len() as f64 - begin_cpu / times_ms.len() as f64);
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

fn draw(path: &str, sample: &Sample, estimate: &DepthEstimate, truth: &hal::DepthMap) -> anyhow::Result<()> {
    let mut image = image::RgbImage::new(1280, 192 * 3);
    for v in 0..192_u32 {
        for u in 0..640_u32 {
            let i = (v * 640 + u) as usize;
            let p = &sample.rgb[3 * i..];
            image.put_pixel(u, v, image::Rgb([p[0], p[1], p[2]]));
            let (t, d, c) = (truth.values()[i], estimate.depth.values()[i], estimate.confidence[i]);
            let shade = |d: f32| {
                if d > 0.0 { image::Rgb([(255.0 * (0.5 / d).min(1.0)) as u8; 3]) } else { image::Rgb([60, 0, 60]) }
            };
            image.put_pixel(u + 640, v, shade(t));
            image.put_pixel(u + 640, v + 192, shade(d));
            image.put_pixel(u, v + 192, image::Rgb([(c * 255.0) as u8; 3]));
            let ratio = if t > 0.0 && d > 0.0 { (d / t).ln().abs() / 1.25_f32.ln() } else { -1.0 };
            let error = if ratio < 0.0 {
                [0, 0, 0]
            } else if ratio < 1.0 {
                [0, (255.0 - 150.0 * ratio) as u8, 0]
            } else {
                [255, (255.0 / ratio) as u8 / 2, 0]
            };
            image.put_pixel(u, v + 384, image::Rgb(error));
        }
    }
    image.save(path)?;
    Ok(())
}

/// User time of this process, ms.
fn cpu_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    stat.split(' ').nth(13).and_then(|v| v.parse::<f64>().ok()).unwrap_or_default() * 10.0
}
