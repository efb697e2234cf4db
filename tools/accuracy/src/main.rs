//! Prints the accuracy table.
#![forbid(unsafe_code)]

use std::path::PathBuf;
use std::sync::Arc;

use accuracy::disturbance::Disturbance;
use accuracy::fit::Samples;
use accuracy::sequence::{Motion, Sequence, recorded, simulated};
use anyhow::Result;
use clap::Parser;
use firmware_host::config::Config;
use hal::ImageView;
use runtime::accuracy::{Accuracy, ConstantBaseline};
use runtime::perception::trust::{belief_features, vote_features};
use runtime::perception::{Belief, CoarseConfig, CoarseDepth, Vote};
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
    /// Only these motions: forward, turning, random, active, rotation.
    #[arg(long, value_delimiter = ',')]
    motions: Vec<String>,
    /// Without disturbances.
    #[arg(long)]
    undisturbed: bool,
    /// Fits the confidence instead: prints the numbers for `runtime/src/perception/trust.rs`.
    #[arg(long)]
    fit: bool,
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
        let wanted = |motion: &Motion| options.motions.is_empty() || options.motions.iter().any(|m| m == motion.name());
        for motion in Motion::ALL.into_iter().filter(wanted) {
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
    if options.fit {
        return fit(&sequences, &configs[0].1);
    }
    for (name, config) in &configs {
        println!("== {name}");
        let (mut sum, mut count) = ([0.0; 4], 0.0);
        for sequence in &sequences {
            for disturbance in Disturbance::ALL.into_iter().take(if options.undisturbed { 1 } else { 3 }) {
                let row = measure(sequence, disturbance, config)?;
                sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
                count += 1.0;
            }
        }
        println!("mean: all, share, half, ms {:.3?}", sum.map(|sum| sum / count));
    }
    Ok(())
}

/// Right is what delta1 calls right.
fn is_right(inverse_depth: f32, truth_m: f32) -> bool {
    let ratio = inverse_depth * truth_m;
    ratio > 0.8 && ratio < 1.25
}

/// First what one picture's vote is worth, then, with that, what is remembered.
fn fit(sequences: &[Sequence], config: &Config) -> Result<()> {
    let mut coarse = config.coarse.clone();
    coarse.vote_weights = gather(sequences, &coarse, |vote, _| {
        (vote.parallax_px > 0.0).then(|| (vote_features(vote), vote.inverse_depth))
    })?;
    println!("vote_weights = {:.2?}", coarse.vote_weights);
    coarse.belief_weights = gather(sequences, &coarse, |_, belief| {
        (belief.evidence > 0.0).then(|| (belief_features(belief), belief.inverse_depth))
    })?;
    println!("belief_weights = {:.2?}", coarse.belief_weights);
    Ok(())
}

fn gather<const N: usize>(
    sequences: &[Sequence],
    coarse: &CoarseConfig,
    sample: impl Fn(&Vote, &Belief) -> Option<([f32; N], f32)>,
) -> Result<[f32; N]> {
    let mut all = Samples::<N>::default();
    for sequence in sequences {
        for disturbance in [Disturbance::None, Disturbance::Pose] {
            let mut samples = Samples::default();
            let mut engine = CoarseDepth::new(coarse.clone(), sequence.camera)?;
            for (index, view) in sequence.views.iter().enumerate() {
                let (rgb, pose) = disturbance.of(index, view);
                let frame = ImageView::rgb8(sequence.camera.width, sequence.camera.height, &rgb)?;
                let Some(truth) = view.truth.as_ref().filter(|_| engine.estimate(frame, &pose).is_ok()) else {
                    continue;
                };
                let columns = sequence.camera.width / 4;
                // Neighbours say the same: every seventh is enough.
                for (cell, (vote, belief)) in engine.cells().enumerate().skip(index % 7).step_by(7) {
                    let (row, column) = (cell / columns * 4 + 1, cell % columns * 4 + 1);
                    let truth_m = truth.values()[row * sequence.camera.width + column];
                    if let Some((features, inverse_depth)) = sample(vote, belief).filter(|_| truth_m > 0.0) {
                        samples.add(features, is_right(inverse_depth, truth_m));
                    }
                }
            }
            all.add_sequence(samples);
        }
    }
    Ok(all.fit()?.map(|weight| weight as f32))
}

fn measure(sequence: &Sequence, disturbance: Disturbance, config: &Config) -> Result<[f64; 4]> {
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
    Ok([all.delta1_unscaled, all.share, half.delta1_unscaled, 1e3 * seconds[seconds.len() / 2]])
}
