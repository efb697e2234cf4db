//! Prints the accuracy table.
#![forbid(unsafe_code)]

use std::path::PathBuf;
use std::sync::Arc;

use accuracy::disturbance::Disturbance;
use accuracy::sequence::{Motion, Sequence, recorded, simulated};
use anyhow::Result;
use clap::Parser;
use firmware_host::config::Config;
use hal::ImageView;
use runtime::accuracy::{Accuracy, ConstantBaseline};
use runtime::perception::CoarseDepth;
use simulator::{OpenOptions, World};

/// Measures depth on sequences with ground truth.
#[derive(Parser)]
struct Options {
    /// Scenes to drive through: `builtin:` homes or files.
    #[arg(long = "scene")]
    scenes: Vec<String>,
    /// Recorded sequences.
    #[arg(long = "dataset")]
    datasets: Vec<PathBuf>,
    /// Pictures of each simulated sequence.
    #[arg(long, default_value_t = 150)]
    frames: u64,
    /// Configurations to compare; the default one where none is given.
    #[arg(long = "config")]
    configs: Vec<PathBuf>,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let mut sequences = Vec::new();
    for folder in &options.datasets {
        sequences.push(recorded(folder)?);
    }
    for scene in &options.scenes {
        let world = Arc::new(World::open(scene, &OpenOptions::default())?);
        for motion in Motion::ALL {
            sequences.push(simulated(&world, motion, options.frames, 1)?);
        }
    }
    let mut configs = vec![];
    for path in &options.configs {
        configs.push((path.display().to_string(), Config::load(path)?));
    }
    if configs.is_empty() {
        configs.push(("default".to_owned(), Config::default()));
    }
    for (name, config) in &configs {
        println!("== {name}");
        for sequence in &sequences {
            for disturbance in Disturbance::ALL {
                measure(sequence, disturbance, config)?;
            }
        }
    }
    Ok(())
}

fn measure(sequence: &Sequence, disturbance: Disturbance, config: &Config) -> Result<()> {
    let mut engine = CoarseDepth::new(config.coarse.clone(), sequence.camera)?;
    let (mut accuracy, mut constant) = (Accuracy::new(), ConstantBaseline::new());
    let mut seconds = Vec::new();
    for (index, view) in sequence.views.iter().enumerate() {
        let (rgb, pose) = disturbance.of(index, view);
        let frame = ImageView::rgb8(sequence.camera.width, sequence.camera.height, &rgb)?;
        let began = std::time::Instant::now();
        let estimate = engine.estimate(frame, &pose).ok();
        seconds.push(began.elapsed().as_secs_f64());
        if let Some(truth) = &view.truth {
            accuracy.add(estimate, truth)?;
            constant.add(truth);
        }
    }
    seconds.sort_by(f64::total_cmp);
    let rows = accuracy.rows();
    let (all, half) = (rows.all.unwrap_or_default(), rows.confident.unwrap_or_default());
    println!(
        "{:32} {:20} all {:.3} ({:.2}) scaled {:.3}  half {:.3} ({:.2}) scaled {:.3}  const {:.3}  {:.1} ms",
        sequence.name,
        disturbance.name(),
        all.delta1_unscaled,
        all.share,
        all.delta1,
        half.delta1_unscaled,
        half.share,
        half.delta1,
        constant.rows().all.map_or(0.0, |m| m.delta1),
        1e3 * seconds[seconds.len() / 2],
    );
    Ok(())
}
